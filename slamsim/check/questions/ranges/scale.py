"""Ranges too long or too short by a share: the path by scans against that by wheels."""

from __future__ import annotations

from slamsim.check.calibration.explanation import LIMITS, Explanation
from slamsim.check.calibration.joint import Calibration
from slamsim.check.evidence import of_sizes
from slamsim.check.findings import Finding
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.check.wording import signed_words
from slamsim.recording.repairs.base import Repair

SCALE = Question(
    "ranges.scale",
    "ranges are as long as the path of the wheels says",
    (FaultKind("range_scale", "ranges are too long or too short by a share"),),
    limit=100.0 * LIMITS["ranges"],
    unit="%",
    consequence="the map is larger or smaller than the world by this share",
    excitation_wanted="ten metres of straight driving and a few full turns, or, where wheels are "
    "the doubt, a length in the map measured by hand",
    repairs=("scale_ranges",),
)


def check_range_scale(calibration: Calibration, explained: Explanation) -> list[Finding]:
    """Wheels of a wrong size change turns as well as paths; ranges change paths alone."""
    compared = calibration.scans_count and calibration.comparable
    if calibration.model.wheels is None or not compared:
        return []
    topic, too_long = calibration.inputs.steps.topic, explained.too_large["ranges"]
    if too_long is None:
        words = "nothing tells it apart from wheels of another size"
        return [unanswered(SCALE, topic, words)]
    factor = 1.0 / (1.0 + too_long.value / 100.0)
    return [
        judge(
            SCALE,
            topic,
            f"ranges are {signed_words(too_long.value, '%', 'too long', 'too short')}",
            too_long,
            advice=f"Multiply every range by {factor:.5g}, or the odometry's lengths by "
            f"{1.0 / factor:.5g}: scans and wheels alone do not tell which.",
            repairs=(Repair("scale_ranges", topic, {"factor": factor}),),
        )
    ]


GROUP = QuestionGroup("motion", 165, (SCALE,), of_sizes(check_range_scale), thorough=True)
