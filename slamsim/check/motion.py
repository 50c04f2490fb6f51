"""What the motion of the lidar by its scans alone says of all sensors."""

from __future__ import annotations

from slamsim.check.findings import Finding
from slamsim.check.joint import check_calibration
from slamsim.check.scan_motion import scan_motions
from slamsim.recording import Recording


def check_motion(recording: Recording) -> list[Finding]:
    """Every answer that needs scans compared with one another; of several lidars the busiest."""
    scans = max(recording.scans, key=len, default=None)
    motions = None if scans is None else scan_motions(scans)

    return check_calibration(recording, motions)
