"""Do the moving transforms cover the scans, and do they say what the odometry says?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.frame_graph import FrameGraph
from slamsim.check.planar_track import planar_track, track_at
from slamsim.geometry import between, wrap_angle
from slamsim.recording import RawOdometry, Recording, TransformEdge
from slamsim.types import BoolArray, FloatArray, IntArray

MAX_COVER_GAP_NS = 500_000_000
"""Interpolating a transform over more than half a second no longer says where a robot was."""
MAX_UNCOVERED_SHARE = 0.02
"""A recording may begin or end a little before its transforms do."""
MAX_DISAGREEMENT_M = 0.1
MAX_DISAGREEMENT_RAD = 0.06
"""Over four seconds of driving: more than the stamps of two honest publishers may differ by."""
_COMPARED_NS = 4_000_000_000


def check_coverage(recording: Recording, graph: FrameGraph) -> Iterator[Finding]:
    """Whether each moving transform between odom and the laser has a sample on both sides."""
    for scans in recording.scans:
        for edge in graph.moving_above(scans.frame_ids):
            if len(scans) == 0:
                continue
            share = 1.0 - float(_covered(scans.stamps_ns, np.sort(edge.stamps_ns)).mean())
            estimate = Estimate(100.0 * share, 0.0, "%")
            if share > MAX_UNCOVERED_SHARE and share * len(scans) > 5:
                yield Finding(
                    "tf.coverage",
                    f"{edge.name} at {scans.topic}",
                    "bad",
                    f"{100.0 * share:.1f} % of the scans have no transform within "
                    f"{MAX_COVER_GAP_NS * 1e-9:g} s on both sides",
                    "tf_coverage",
                    "Publish the transform at 10 Hz or more, on the clock of the scans, and "
                    "record it from before the first scan.",
                    estimate,
                    100.0 * MAX_UNCOVERED_SHARE,
                )
            else:
                words = f"{100.0 * (1.0 - share):.1f} % of the scans lie between two transforms"
                subject = f"{edge.name} at {scans.topic}"
                yield Finding("tf.coverage", subject, "ok", words, estimate=estimate)


def _covered(query_ns: IntArray, stamps_ns: IntArray) -> BoolArray:
    right = np.searchsorted(stamps_ns, query_ns, side="left")
    exact = stamps_ns[np.minimum(right, stamps_ns.size - 1)] == query_ns
    inside = (right > 0) & (right < stamps_ns.size)
    gap_ns = stamps_ns[np.minimum(right, stamps_ns.size - 1)] - stamps_ns[np.maximum(right - 1, 0)]
    return np.asarray(exact | (inside & (gap_ns <= MAX_COVER_GAP_NS)))


def check_agreement(recording: Recording) -> Iterator[Finding]:
    """odom -> base as a transform against the same as an odometry message."""
    for odometry in recording.odometries:
        for edge in recording.transforms:
            same = edge.parent in odometry.frame_ids and edge.child in odometry.child_frame_ids
            if same and not edge.is_static:
                yield from _contradiction(odometry, edge)


def _contradiction(odometry: RawOdometry, edge: TransformEdge) -> Iterator[Finding]:
    found = disagreement(odometry, edge)
    subject = f"{edge.name} against {odometry.topic}"
    if found is None:
        words = "transform and odometry have less than four seconds in common"
        yield Finding("tf.odometry", subject, "cannot tell", words)
        return
    elapsed_s, off_m, off_rad = found
    at_m, at_rad = float(np.quantile(off_m, 0.95)), float(np.quantile(off_rad, 0.95))
    words = (
        f"over four seconds of driving they differ by {1e3 * at_m:.3g} mm and "
        f"{np.degrees(at_rad):.3g} deg (95 % of the time less)"
    )
    if at_m <= MAX_DISAGREEMENT_M and at_rad <= MAX_DISAGREEMENT_RAD:
        estimate = Estimate(at_m, 0.0, "m")
        yield Finding("tf.odometry", subject, "ok", words, estimate=estimate)
        return
    curve = Curve("difference over 4 s", elapsed_s, off_m, "line")
    plot = Plot(subject, "time (s)", "difference (m)", (curve,), (MAX_DISAGREEMENT_M,))
    yield Finding(
        "tf.odometry",
        subject,
        "bad",
        words,
        "tf_contradicts_odometry",
        f"Let the node that makes {odometry.topic} publish the transform as well, and nobody else.",
        Estimate(at_m, 0.0, "m"),
        MAX_DISAGREEMENT_M,
        (Mend("add_odometry_transform", odometry.topic),),
        (plot,),
    )


def disagreement(
    one: RawOdometry, other: RawOdometry | TransformEdge
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """(seconds, metres, radians) by which motions over four seconds differ, at the
    stamps of the first; None without four seconds in common."""
    ours_ns, ours = planar_track(one.stamps_ns, one.positions_m, one.quats_xyzw)
    theirs_ns, theirs = planar_track(other.stamps_ns, other.positions_m, other.quats_xyzw)
    if ours_ns.size < 2 or theirs_ns.size < 2:
        return None
    there = [
        _covered(ours_ns + later_ns, stamps_ns)
        for stamps_ns in (ours_ns, theirs_ns)
        for later_ns in (0, _COMPARED_NS)
    ]
    begin_ns = ours_ns[np.all(there, axis=0)]
    if begin_ns.size == 0:
        return None
    steps = [
        between(track_at(ns, poses, begin_ns), track_at(ns, poses, begin_ns + _COMPARED_NS))
        for ns, poses in ((ours_ns, ours), (theirs_ns, theirs))
    ]
    off = steps[0] - steps[1]
    seconds = (begin_ns - begin_ns[0]) * 1e-9
    return seconds, np.hypot(off[:, 0], off[:, 1]), np.abs(wrap_angle(off[:, 2]))
