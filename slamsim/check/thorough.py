"""What the motion of the lidar by its scans alone says of all sensors."""

from __future__ import annotations

from slamsim.check.findings import Finding
from slamsim.check.joint import check_calibration
from slamsim.check.motion.inputs import gather
from slamsim.check.questions.laser.laser import check_laser, laser_motions
from slamsim.recording import Recording


def check_motion(recording: Recording) -> list[Finding]:
    """Every answer that needs scans compared with one another."""
    motions = laser_motions(recording)
    findings: list[Finding] = []
    if motions is not None:
        findings += check_laser(motions, gather(recording, motions), recording.format)
    return findings + check_calibration(recording, motions)
