"""Lengths in another unit than metres: ranges and wheels against each other, and against a room."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.distance_unit import WrongUnit
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge
from slamsim.check.questions.ranges.units import RANGE_UNIT
from slamsim.recording.repairs.base import Repair

WHEEL_UNIT = FaultKind(
    "wheel_unit",
    "the wheels or the odometry count in another unit than metres",
    (anywhere("odometry_jump", "wheel_slip", "odometry_contradicts_wheels"),),
)
RANGES = Question(
    "ranges.distance",
    "ranges are metres, as the wheels' path and the size of a room tell",
    (RANGE_UNIT,),
    unit="m/m",
    consequence="the map is larger or smaller than the world",
    excitation_wanted="ten metres of straight driving",
    repairs=("scale_ranges",),
)
WHEELS = Question(
    "wheels.distance",
    "wheels count metres, as the scans and the size of a robot tell",
    (WHEEL_UNIT,),
    unit="m/m",
    consequence="the odometry goes many times too far or too short",
    excitation_wanted="ten metres of straight driving",
    repairs=("scale_lengths",),
)


def check_unit(evidence: RecordingEvidence) -> list[Finding]:
    """The finding, if there is anything to be found."""
    unit = evidence.wrong_unit
    if unit is None:
        return []
    ratio, sigma = unit.ratio
    of_ranges, known = unit.side == "ranges", bool(np.isfinite(ratio))
    compared = (
        f"scans go {ratio:.4g} of the way that the wheels go"
        if known
        else "read as metres they make no room"
    )
    whose = "ranges" if of_ranges else "lengths by the wheels"
    return [
        judge(
            RANGES if of_ranges else WHEELS,
            unit.topic,
            f"{whose} are {unit.name}: {compared}",
            Measurement(ratio, sigma, "m/m") if known else None,
            verdict="fault",
            advice=f"Multiply {_what(unit)} by {unit.metres:g}.",
            repairs=(_repair(unit),),
        )
    ]


GROUP = QuestionGroup("motion", 120, (RANGES, WHEELS), check_unit, thorough=True)


def _what(unit: WrongUnit) -> str:
    if unit.side == "ranges":
        return "every range and the declared limits" if unit.limits_too else "every range"
    return "the radius of the wheels" if unit.radius_alone else "all lengths of the odometry"


def _repair(unit: WrongUnit) -> Repair:
    if unit.side == "ranges":
        limits = "scale" if unit.limits_too else "keep"
        return Repair("scale_ranges", unit.topic, {"factor": unit.metres, "limits": limits})
    track = 1.0 if unit.radius_alone else unit.metres
    return Repair(
        "scale_lengths", unit.topic, {"radius_factor": unit.metres, "track_factor": track}
    )
