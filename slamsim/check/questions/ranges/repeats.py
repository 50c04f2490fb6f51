"""Scans that repeat the previous one while the robot moves: a driver that is stuck."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.moving import moving_at
from slamsim.check.question import FaultKind, Question, anywhere, judge, unanswered
from slamsim.check.scan_sample import ScanSample
from slamsim.recording import RawScans, Recording
from slamsim.recording.repairs.base import Repair

MAX_REPEATED_SHARE = 2e-3
MIN_REPEATED = 3
_PERFECT_SHARE = 0.5
"""More repeats than this are a simulation without noise, not a driver that is stuck."""


STUCK = Question(
    "ranges.stuck",
    "no scan repeats the one before while the robot moves",
    (
        FaultKind(
            "scan_stuck",
            "scans repeat unchanged while the robot moves",
            (anywhere(*BY_SCANS, "time_offset_wheels", "time_offset_imu"),),
        ),
    ),
    limit=100.0 * MAX_REPEATED_SHARE,
    unit="%",
    consequence="the map is smeared along the path that the robot drove meanwhile",
    excitation_wanted="odometry or an inertial unit that tells when the robot moved",
    repairs=("drop_repeated_scans",),
    limit_of_ok=False,
)


def check_repeats(recording: Recording, scans: RawScans, sample: ScanSample) -> Finding:
    """Noise alone makes any two scans of a real lidar differ."""
    moving = moving_at(recording, scans.stamps_ns)
    repeats = sample.repeats if moving is None else sample.repeats & moving
    count = int(repeats.sum())
    moved = len(scans) if moving is None else max(int(moving.sum()), 1)
    share = count / moved
    if moving is None and share > _PERFECT_SHARE:
        words = "most scans repeat the one before, and nothing says whether the robot moved"
        return unanswered(STUCK, scans.topic, words)
    first_s = (int(scans.stamps_ns[np.argmax(repeats)]) - int(scans.stamps_ns[0])) * 1e-9
    return judge(
        STUCK,
        scans.topic,
        {
            "ok": "no scan repeats the one before while the robot moves",
            "fault": f"{count} scans repeat the ranges of the one before bit for bit while the "
            f"robot moves, first after {first_s:.1f} s",
        },
        Measurement(100.0 * share, 0.0, "%"),
        limit=100.0 * max(MAX_REPEATED_SHARE, (MIN_REPEATED - 0.5) / moved),
        advice="Look for a driver that publishes its last buffer again, or a republisher.",
        repairs=(Repair("drop_repeated_scans", scans.topic),),
    )
