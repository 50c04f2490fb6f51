"""Do the moving transforms cover the scans, and do they say what the odometry says?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.disagreement import (
    IN_COMMON,
    LIMIT_M,
    MAX_COVER_GAP_NS,
    covered,
    disagreement,
)
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.recording import RawOdometry, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph

MAX_UNCOVERED_SHARE = 0.02
"""A recording may begin or end a little before its transforms do."""


def check_coverage(recording: Recording, graph: FrameGraph) -> Iterator[Finding]:
    """Whether each moving transform between odom and the laser has a sample on both sides."""
    for scans in recording.scans:
        for edge in graph.moving_above(scans.frame_ids):
            if len(scans) == 0:
                continue
            share = 1.0 - float(covered(scans.stamps_ns, np.sort(edge.stamps_ns)).mean())
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
        words = f"transform and odometry have less than {IN_COMMON}"
        yield Finding("tf.odometry", subject, "cannot tell", words)
    elif not found.matters:
        yield Finding("tf.odometry", subject, "ok", found.words, estimate=found.estimate)
    else:
        yield Finding(
            *("tf.odometry", subject, "bad", found.words, "tf_contradicts_odometry"),
            f"Let the node that makes {odometry.topic} publish the transform as well, and nobody "
            "else.",
            *(found.estimate, LIMIT_M),
            (Mend("add_odometry_transform", odometry.topic),),
            (found.plot(subject),),
        )
