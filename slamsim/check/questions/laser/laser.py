"""Checks of the laser by its scans: rotation with the robot, direction, beam times."""

from __future__ import annotations

from collections.abc import Sequence

from slamsim.check.calibration.explanation import Explanation
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.motion.inputs import Inputs
from slamsim.check.question import QuestionGroup, unanswered
from slamsim.check.questions.laser.rotation import ROTATION, check_rotation
from slamsim.check.questions.laser.shape import (
    ANGLE_STEP,
    ANGLE_UNIT,
    RANGE_OFFSET,
    SWEEP,
    check_angles,
    check_range_offset,
    check_sweep,
)
from slamsim.recording import RecordingFormat
from slamsim.slam.laser.scan_motion import ScanMotions


def check_laser(
    motions: ScanMotions,
    inputs: Inputs,
    recorded_as: RecordingFormat,
    explained: Explanation | None = None,
) -> list[Finding]:
    """Rotation, angles, sweep and offset of the ranges; inputs, explained: of the recording."""
    if not motions.windows:
        words = f"the scans tell nothing of their motion: {motions.weak}"
        return [unanswered(ROTATION, motions.topic, words)]
    rotation = check_rotation(inputs)
    shape = [*check_angles(motions, explained), check_sweep(motions, recorded_as)]
    if rotation.fault == "laser_world_fixed":
        # A beam that does not turn with the laser has no fixed place among the others.
        reason = "rays fixed to the world hide it"
        shape = [one.inconclusive(reason) if one.verdict == "fault" else one for one in shape]
    return [rotation, *shape, check_range_offset(motions)]


def _asked(evidence: RecordingEvidence) -> Sequence[Finding]:
    motions = evidence.motions
    if motions is None:
        return []
    return check_laser(motions, evidence.inputs, evidence.recording.format, evidence.explanation)


GROUP = QuestionGroup(
    "motion", 100, (ROTATION, ANGLE_UNIT, ANGLE_STEP, SWEEP, RANGE_OFFSET), _asked, thorough=True
)
