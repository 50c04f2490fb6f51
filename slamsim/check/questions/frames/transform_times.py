"""Do the moving transforms cover the scans and agree with the odometry?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.disagreement import (
    IN_COMMON,
    LIMIT_M,
    MAX_COVER_GAP_NS,
    covered,
    disagreement,
)
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.core.types import FloatArray
from slamsim.recording import RawOdometry, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair

MAX_UNCOVERED_SHARE = 0.02
"""A recording may begin or end a little before its transforms do."""


MIN_UNCOVERED = 5
"""Fewer scans than this are those before the first transform."""

LEAN_LIMIT_DEG, MAX_LEANING_SHARE = 3.0, 0.01
"""Two estimates of how a robot leans on a ramp differ by less; and of single messages."""

TF_CONTRADICTS = FaultKind(
    "tf_contradicts_odometry", "the transform tree and the odometry disagree"
)
COVERAGE = Question(
    "tf.coverage",
    "every scan lies between two transforms",
    (FaultKind("tf_coverage", "no transform covers the instants of the scans"),),
    limit=100.0 * MAX_UNCOVERED_SHARE,
    unit="%",
    consequence="a SLAM drops the scans that no transform covers",
    limit_of_ok=False,
)
AGREEMENT = Question(
    "tf.odometry",
    "the transforms say what the odometry says",
    (TF_CONTRADICTS,),
    limit=LIMIT_M,
    unit="m",
    consequence="consumers of the topic and of the transforms see two different drives",
    excitation_wanted=IN_COMMON,
    repairs=("add_odometry_transform",),
    limit_of_ok=False,
)


UPRIGHT = Question(
    "tf.upright",
    "the transform leans as far as the odometry",
    (TF_CONTRADICTS,),
    limit=LEAN_LIMIT_DEG,
    unit="deg",
    consequence="scans are placed as if the robot leant over: walls come too near",
    limit_of_ok=False,
)


def check_coverage(recording: Recording, graph: FrameGraph) -> Iterator[Finding]:
    """Whether each moving transform between odom and the laser has a sample on both sides."""
    for scans in recording.scans:
        for edge in graph.moving_above(scans.frame_ids):
            if len(scans) == 0:
                continue
            share = 1.0 - float(covered(scans.stamps_ns, np.sort(edge.stamps_ns)).mean())
            yield judge(
                COVERAGE,
                f"{edge.name} at {scans.topic}",
                {
                    "ok": f"{100.0 * (1.0 - share):.1f} % of the scans lie between two transforms",
                    "fault": f"{100.0 * share:.1f} % of the scans have no transform within "
                    f"{MAX_COVER_GAP_NS * 1e-9:g} s on both sides",
                },
                Measurement(100.0 * share, 0.0, "%"),
                limit=100.0 * max(MAX_UNCOVERED_SHARE, MIN_UNCOVERED / len(scans)),
                advice="Publish the transform at 10 Hz or more, on the clock of the scans, and "
                "record it from before the first scan.",
            )


def check_agreement(recording: Recording) -> Iterator[Finding]:
    """odom -> base as a transform against the same as an odometry message.

    Of several odometries the transform repeats one: whether they agree is another question.
    """
    for edge in recording.transforms:
        beside = [one for one in recording.odometries if joins_frames_of(one, edge)]
        for compare in (_contradiction, _leaning):
            findings = [compare(odometry, edge) for odometry in beside]
            agree = [one for one in findings if one.verdict == "ok"]
            yield from agree or findings


def joins_frames_of(odometry: RawOdometry, edge: TransformEdge) -> bool:
    """Whether a moving transform is between the frames of an odometry."""
    same = edge.parent in odometry.frame_ids and edge.child in odometry.child_frame_ids
    return same and not edge.is_static


def _contradiction(odometry: RawOdometry, edge: TransformEdge) -> Finding:
    found = disagreement(odometry, edge)
    subject = f"{edge.name} against {odometry.topic}"
    if found is None:
        words = f"transform and odometry have less than {IN_COMMON}"
        return unanswered(AGREEMENT, subject, words)
    return found.judged(
        AGREEMENT,
        subject,
        f"Let the node that makes {odometry.topic} publish the transform as well, alone.",
        (Repair("add_odometry_transform", odometry.topic),),
    )


def _leaning(odometry: RawOdometry, edge: TransformEdge) -> Finding:
    """By how much the transform leans otherwise, in all but a share of its messages."""
    subject = f"{edge.name} against {odometry.topic}"
    order = np.argsort(odometry.stamps_ns, kind="stable")
    leans_deg = np.interp(
        edge.stamps_ns, odometry.stamps_ns[order], _lean_deg(odometry.quats_xyzw[order])
    )
    apart_deg = np.abs(_lean_deg(edge.quats_xyzw) - leans_deg)
    apart_deg = apart_deg[np.isfinite(apart_deg)]
    if not apart_deg.size:
        return unanswered(UPRIGHT, subject, "no orientation of either is a number")
    most_deg = float(np.quantile(apart_deg, 1.0 - MAX_LEANING_SHARE))
    return judge(
        UPRIGHT,
        subject,
        f"the base leans by up to {apart_deg.max():.2g} deg more or less than by the odometry, in "
        f"{100.0 * float((apart_deg > LEAN_LIMIT_DEG).mean()):.3g} % of the transforms too far",
        Measurement(most_deg, 0.0, "deg"),
        advice="Look for a node that fills in the rotation about x and y.",
    )


def _lean_deg(quats_xyzw: FloatArray) -> FloatArray:
    """(n,) angle between the z axes of both frames, of quaternions (n, 4) that need not be unit."""
    with np.errstate(all="ignore"):
        x, y, _, _ = (quats_xyzw / np.linalg.norm(quats_xyzw, axis=1, keepdims=True)).T
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))
