"""Readings that stand alone in a scan and are gone in the next: another lidar, sunlight, dust."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.scan_sample import ScanSample
from slamsim.recording.repairs.isolated import isolated_returns

MAX_STRAY_SHARE = 5e-3
MIN_BEAMS = 200
_WIDEST_STEP_RAD = float(np.radians(1.1))


def check_stray(topic: str, sample: ScanSample) -> Finding:
    """Beams that differ from two neighbours which agree; a pole does that as well, but stays."""
    fine = 0.0 < abs(sample.layout.angle_step_rad) <= _WIDEST_STEP_RAD
    if not fine or sample.ranges_m.shape[1] < 3:
        words = "beams so far apart that a pole and a stray reading look alike"
        return Finding("ranges.stray", topic, "cannot tell", words)
    known, stray = isolated_returns(
        sample.ranges_m, sample.following_m, sample.layout.angle_step_rad
    )
    if int(known.sum()) < MIN_BEAMS:
        words = "too few beams have two neighbours that agree"
        return Finding("ranges.stray", topic, "cannot tell", words)
    share = float(stray.sum() / known.sum())
    estimate = Estimate(100.0 * share, 0.0, "%")
    words = f"{100.0 * share:.2g} % of the beams stand alone in one scan and are gone in the next"
    if share <= MAX_STRAY_SHARE:
        return Finding("ranges.stray", topic, "ok", words, estimate=estimate)
    return Finding(
        "ranges.stray",
        topic,
        "bad",
        words,
        "scan_interference",
        "Look for another lidar, sunlight or a dirty window; filter single beams.",
        estimate,
        100.0 * MAX_STRAY_SHARE,
        (Mend("drop_stray_beams", topic),),
    )
