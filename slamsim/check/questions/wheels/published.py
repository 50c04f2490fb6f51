"""What published odometry shows by itself and beside another: numbers that are no pose, and two
odometries that tell different drives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.disagreement import IN_COMMON, LIMIT_M, disagreement
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.core.types import BoolArray
from slamsim.recording import RawOdometry
from slamsim.recording.cleaning.streams import finite_poses, has_unit_length
from slamsim.recording.repairs.base import Repair

REPLACED_SHARE = 0.5
"""Where more of the poses are broken than this, dropping them leaves no odometry."""


VALUES = Question(
    "odometry.values",
    "every pose is finite, every rotation of unit length",
    (
        FaultKind(
            "odometry_invalid",
            "the odometry holds numbers that are no pose",
            (
                anywhere(
                    *("odometry_contradicts_wheels", "odometry_frozen", "odometry_jump"),
                    *("wheel_slip", "tf_contradicts_odometry", "odometries_contradict"),
                    "odometry_no_turn",  # of quaternions that are too short
                ),
            ),
        ),
    ),
    limit=0.0,
    unit="%",
    consequence="one NaN stays in a filter for ever",
    repairs=("normalise_rotations", "drop_broken_poses", "odometry_from_ticks"),
)
OTHERS = Question(
    "odometry.others",
    "all odometries of one body tell one drive",
    (FaultKind("odometries_contradict", "two odometries tell different drives"),),
    limit=LIMIT_M,
    unit="m",
    consequence="what a SLAM makes of the recording depends on which one it reads",
    excitation_wanted=IN_COMMON,
    limit_of_ok=False,
)


def check_published(evidence: RecordingEvidence) -> list[Finding]:
    """Sound numbers in every odometry, and one story from all of them."""
    recording = evidence.recording
    return [
        *(_values(odometry, bool(recording.ticks)) for odometry in recording.odometries),
        *_contradictions(recording.odometries),
    ]


GROUP = QuestionGroup("odometry", 60, (VALUES, OTHERS), check_published)


def _values(odometry: RawOdometry, has_ticks: bool) -> Finding:
    finite = finite_poses(odometry)
    unit = has_unit_length(odometry.quats_xyzw)
    broken = int((~(finite & unit)).sum())
    share = broken / max(len(odometry), 1)
    return judge(
        VALUES,
        odometry.topic,
        {
            "ok": "every pose is finite, every rotation of unit length",
            "fault": f"{broken} of {len(odometry)} messages hold numbers that are no pose: "
            f"{int((~finite).sum())} not finite, {int((~unit).sum())} with a quaternion that is "
            "not of unit length",
        },
        Measurement(100.0 * share, 0.0, "%"),
        advice="Start the quaternion at w = 1, keep it of unit length, and publish nothing where "
        "nothing is known: one NaN stays in a filter for ever.",
        repairs=_repairs(odometry, finite, share, has_ticks),
    )


def _repairs(
    odometry: RawOdometry, finite: BoolArray, share: float, has_ticks: bool
) -> tuple[Repair, ...]:
    length = np.linalg.norm(odometry.quats_xyzw, axis=1)
    if (finite & np.isfinite(length) & (length > 0.0)).all():
        return (Repair("normalise_rotations", odometry.topic),)
    if share < REPLACED_SHARE:
        return (Repair("drop_broken_poses", odometry.topic),)
    return (Repair("odometry_from_ticks", odometry.topic),) if has_ticks else ()


def _contradictions(odometries: tuple[RawOdometry, ...]) -> Iterator[Finding]:
    """Odometries of one body must show the same motion as the first, from wherever they count."""
    first: dict[str, RawOdometry] = {}
    for other in odometries:
        one = next((first[body] for body in other.child_frame_ids if body in first), None)
        first = {**dict.fromkeys(other.child_frame_ids, other), **first}
        if one is not None:
            yield _agreement(one, other)


def _agreement(one: RawOdometry, other: RawOdometry) -> Finding:
    subject = f"{one.topic} against {other.topic}"
    found = disagreement(one, other)
    if found is None:
        return unanswered(OTHERS, subject, f"they have less than {IN_COMMON}")
    advice = "Find out which of them is right before either is used: compare both with the scans."
    return found.judged(OTHERS, subject, advice)
