"""Scans that repeat the one before while the robot moves: a driver that is stuck."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.motion.moving import moving_at
from slamsim.check.questions.ranges.sample import ScanSample
from slamsim.recording import RawScans, Recording

MAX_REPEATED_SHARE = 2e-3
MIN_REPEATED = 3
_PERFECT_SHARE = 0.5
"""More repeats than this are a simulation without noise, not a driver that is stuck."""


def check_repeats(recording: Recording, scans: RawScans, sample: ScanSample) -> Finding:
    """Noise alone makes any two scans of a real lidar differ."""
    moving = moving_at(recording, scans.stamps_ns)
    if moving is None:
        share = float(sample.repeats.mean())
        told, count = sample.repeats, int(sample.repeats.sum())
        if share > _PERFECT_SHARE:
            words = "most scans repeat the one before, and nothing says whether the robot moved"
            return Finding("ranges.stuck", scans.topic, "cannot tell", words)
    else:
        told = sample.repeats & moving
        count = int(told.sum())
        share = count / max(int(moving.sum()), 1)
    estimate = Estimate(100.0 * share, 0.0, "%")
    if count >= MIN_REPEATED and share > MAX_REPEATED_SHARE:
        first_s = (int(scans.stamps_ns[np.argmax(told)]) - int(scans.stamps_ns[0])) * 1e-9
        return Finding(
            "ranges.stuck",
            scans.topic,
            "bad",
            f"{count} scans repeat the ranges of the one before bit for bit while the robot "
            f"moves, first after {first_s:.1f} s",
            "scan_stuck",
            "Look for a driver that publishes its last buffer again, or a republisher.",
            estimate,
            100.0 * MAX_REPEATED_SHARE,
            (Mend("drop_repeated_scans", scans.topic),),
        )
    words = "no scan repeats the one before while the robot moves"
    return Finding("ranges.stuck", scans.topic, "ok", words, estimate=estimate)
