"""Readings that stand alone in a scan and are gone in the next: another lidar, sunlight, dust."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.check.scan_sample import ScanSample
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.isolated import isolated_returns

MAX_ISOLATED_SHARE = 5e-3
MIN_BEAMS = 200
_WIDEST_STEP_RAD = float(np.radians(1.1))

ISOLATED = Question(
    "ranges.stray",
    "hardly any beam differs from its neighbours for one scan",
    (FaultKind("scan_interference", "stray short or long readings: another lidar or sunlight"),),
    limit=100.0 * MAX_ISOLATED_SHARE,
    unit="%",
    consequence="obstacles appear in free space",
    excitation_wanted="beams at most 1.1 degrees apart, on surfaces wider than three of them",
    repairs=("drop_stray_beams",),
    limit_of_ok=False,
)


def check_isolated_returns(topic: str, sample: ScanSample) -> Finding:
    """Beams that differ from two neighbours which agree; a pole does that as well, but stays."""
    fine = 0.0 < abs(sample.layout.angle_step_rad) <= _WIDEST_STEP_RAD
    if not fine or sample.ranges_m.shape[1] < 3:
        words = "beams so far apart that a pole and a stray reading look alike"
        return unanswered(ISOLATED, topic, words)
    known, isolated = isolated_returns(
        sample.ranges_m, sample.following_m, sample.layout.angle_step_rad
    )
    if int(known.sum()) < MIN_BEAMS:
        return unanswered(ISOLATED, topic, "too few beams have two neighbours that agree")
    share = float(isolated.sum() / known.sum())
    return judge(
        ISOLATED,
        topic,
        f"{100.0 * share:.2g} % of the beams stand alone in one scan and are gone in the next",
        Measurement(100.0 * share, 0.0, "%"),
        advice="Look for another lidar, sunlight or a dirty window; filter single beams.",
        repairs=(Repair("drop_stray_beams", topic),),
    )
