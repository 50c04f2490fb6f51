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
from slamsim.recording import RawOdometry, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair

MAX_UNCOVERED_SHARE = 0.02
"""A recording may begin or end a little before its transforms do."""


MIN_UNCOVERED = 5
"""Fewer scans than this are those before the first transform."""

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
        findings = [
            _contradiction(odometry, edge)
            for odometry in recording.odometries
            if joins_frames_of(odometry, edge)
        ]
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
        f"Let the node that makes {odometry.topic} publish the transform as well, and nobody else.",
        (Repair("add_odometry_transform", odometry.topic),),
    )
