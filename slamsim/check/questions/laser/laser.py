"""Checks of the laser by its scans: rotation with the robot, direction, beam times."""

from __future__ import annotations

from collections.abc import Sequence

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
from slamsim.recording import Recording
from slamsim.slam.laser.scan_motion import ScanMotions


def check_laser(motions: ScanMotions, inputs: Inputs, of: Recording) -> list[Finding]:
    """Rotation, sweep and offset of the ranges. of: what motions and inputs come from."""
    if not motions.windows:
        words = f"the scans tell nothing of their motion: {motions.weak}"
        return [unanswered(ROTATION, motions.topic, words)]
    rotation, sweep = check_rotation(inputs), check_sweep(motions, of.format)
    if rotation.fault == "laser_world_fixed" and sweep.verdict == "fault":
        # A beam that does not turn with the laser has no fixed place among the others.
        sweep = sweep.inconclusive("rays fixed to the world hide it")
    if not next(scans for scans in of.scans if scans.topic == motions.topic).in_order:
        sweep = sweep.inconclusive(
            "the order of the points is lost, so when each was measured is unknown"
        )
    return [rotation, sweep, check_range_offset(motions)]


def _asked(evidence: RecordingEvidence) -> Sequence[Finding]:
    motions = evidence.motions
    if motions is None:
        return []
    return check_laser(motions, evidence.inputs, evidence.recording)


def _angles(evidence: RecordingEvidence) -> Sequence[Finding]:
    motions = evidence.motions
    if motions is None or not motions.windows:
        return []
    return check_angles(motions, evidence.explanation, evidence.thinned)


GROUP = QuestionGroup("motion", 100, (ROTATION, SWEEP, RANGE_OFFSET), _asked, thorough=True)
ANGLES = QuestionGroup("motion", 105, (ANGLE_UNIT, ANGLE_STEP), _angles, thorough=True)
