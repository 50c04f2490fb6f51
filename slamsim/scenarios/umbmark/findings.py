"""Findings of UMBmark: odometry errors, their causes, and the effect of calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np

from slamsim.config.scenarios.umbmark import UmbmarkConfig
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.base import Chart, Findings, Outcome, Series, Value
from slamsim.scenarios.study_drives import SQUARES
from slamsim.scenarios.umbmark.method import (
    Clusters,
    CorrectionResult,
    DrivenSquares,
    Square,
    WheelCorrection,
    classical,
    clusters,
    fitted,
)
from slamsim.scenarios.umbmark.tables import calibration_sheet, corner_sheet, errors_sheet
from slamsim.scenarios.umbmark.verdicts import (
    calibration_verdicts,
    friction_verdict,
    robot_verdicts,
)

_LABELS = ("error in x [m]", "error in y [m]")


def errors_chart(robots: Sequence[tuple[str, Clusters]]) -> Chart:
    """End errors of each robot with their centres; E_max of others as circles."""
    circle = np.linspace(0.0, 2.0 * np.pi, 97)
    series = [
        Series(
            f"E_max of {who}",
            who,
            figures.largest_error_m * np.cos(circle),
            figures.largest_error_m * np.sin(circle),
            "line",
            dashed=True,
        )
        for who, figures in SQUARES.items()
    ]
    for name, found in robots:
        series += _points(name, found)
    note = (
        "True end less the end by odometry, seen from the start. Circles: as far as the farther "
        "centre of gravity lies in the study; where on the circle it does not tell."
    )
    return Chart("End errors of the squares", *_LABELS, tuple(series), equal=True, note=note)


def corrected_chart(robot: str, before: Clusters, after: Clusters) -> Chart:
    """The fresh squares of one robot before and after calibration."""
    series = (*_points("before", before), *_points("after", after))
    title = f"Fresh squares before and after calibration: {robot}"
    return Chart(title, *_LABELS, series, equal=True)


def _points(name: str, found: Clusters) -> list[Series]:
    made = []
    ways = (("clockwise", found.clockwise_m), ("counter-clockwise", found.counter_clockwise_m))
    for way, errors_m in ways:
        made.append(Series(f"{name}, {way}", "slamsim", errors_m[:, 0], errors_m[:, 1], "points"))
    centres_m = found.centres_m()
    spokes = np.concatenate([[[0.0, 0.0], c, [np.nan, np.nan]] for c in centres_m])
    x, y = spokes.T
    made.append(Series(f"{name}, centres of gravity", "slamsim", x, y, "line+points"))
    return made


KNOWN = "known faults"


def squares_found(config: UmbmarkConfig, outcomes: Sequence[Outcome]) -> Findings:
    """The findings of all robots that drove both ways round."""
    tried = _tried([outcome for outcome in outcomes if "way" in outcome.values])
    robots = [one for one in tried if one.robot != KNOWN]
    calibrated = [_calibrated(one, config) for one in tried if len(one.sets) > 1]
    corners = [outcome.values for outcome in outcomes if "friction" in outcome.values]
    smallest = [(one.robot, one.found[0]) for one in robots if one.side_m == config.sides_m[0]]
    return Findings(
        lead=_lead(robots, calibrated),
        numbers=_numbers(robots, calibrated),
        verdicts=(
            *robot_verdicts(robots, config.robot),
            *calibration_verdicts([c for c in calibrated if c.true is not None]),
            friction_verdict(corners),
        ),
        sheets=(errors_sheet(robots), calibration_sheet(calibrated), corner_sheet(corners)),
        charts=(
            errors_chart(smallest),
            *(corrected_chart(c.robot, c.before, c.after) for c in calibrated),
        ),
    )


def _tried(outcomes: Sequence[Outcome]) -> list[DrivenSquares]:
    groups: dict[tuple[Value, Value], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault((outcome.values["robot"], outcome.values["side_m"]), []).append(outcome)
    made = []
    for (robot, side_m), group in groups.items():
        sets = _sets(group)
        if sets:
            made.append(
                DrivenSquares(
                    str(robot),
                    cast(float, side_m),
                    sets,
                    tuple(clusters(squares) for squares in sets),
                    _mean(group, "corner_deg"),
                    _mean(group, "odometry_corner_deg"),
                )
            )
    return made


def _sets(outcomes: Sequence[Outcome]) -> tuple[tuple[Square, ...], ...]:
    """Those that have squares of both directions."""
    sets: dict[Value, list[Square]] = {}
    for outcome in outcomes:
        left = outcome.values["way"] == "counter-clockwise"
        arrays = outcome.arrays
        square = Square(left, arrays["rolled_m"], arrays["end_m"], float(arrays["track_m"]))
        sets.setdefault(outcome.values["set"], []).append(square)
    both = (some for some in sets.values() if len({s.counter_clockwise for s in some}) > 1)
    return tuple(tuple(some) for some in both)


def _mean(outcomes: Sequence[Outcome], key: str) -> float:
    return float(np.mean([cast(float, outcome.values[key]) for outcome in outcomes]))


def _calibrated(tried: DrivenSquares, config: UmbmarkConfig) -> CorrectionResult:
    first, *others = tried.sets
    fresh = [square for some in others for square in some]
    found = fitted(first)
    try:
        formulas = classical(tried.found[0], tried.side_m, first[0].track_m)
    except SlamsimError:
        formulas = None
    known = WheelCorrection(config.known_diameter_ratio, config.known_track_ratio)
    return CorrectionResult(
        tried.robot,
        known if tried.robot == KNOWN else None,
        formulas,
        found,
        clusters(fresh),
        None if formulas is None else clusters(fresh, formulas),
        clusters(fresh, found),
        math.hypot(clusters(first, found).floor_m(), clusters(fresh, found).floor_m()),
    )


def _lead(robots: Sequence[DrivenSquares], calibrated: Sequence[CorrectionResult]) -> str:
    told = [
        f"odometry of {one.robot} is off by {one.largest_m:.2f} m after squares of {one.side_m:g} m"
        for one in robots
    ]
    better = [
        f"calibration makes the systematic error of a robot of known faults {c.improvement:.0f} "
        "times smaller"
        for c in calibrated
        if c.true is not None
    ]
    text = "; ".join([*told, *better]) or "no robot drove squares in both directions"
    return f"{text[:1].upper()}{text[1:]}."


def _numbers(
    robots: Sequence[DrivenSquares], calibrated: Sequence[CorrectionResult]
) -> dict[str, Value]:
    numbers: dict[str, Value] = {}
    for one in robots:
        key = f"{one.robot}_{one.side_m:g}m"
        numbers[f"{key}_e_max_m"], numbers[f"{key}_spread_m"] = one.largest_m, one.spread_m
        numbers[f"{key}_corner_deg"] = one.corner_deg
        numbers[f"{key}_odometry_corner_deg"] = one.odometry_corner_deg
    for c in calibrated:
        key = c.robot.replace(" ", "_")
        numbers[f"{key}_diameter_ratio"] = c.fitted.diameter_ratio
        numbers[f"{key}_track_ratio"] = c.fitted.track_ratio
        numbers[f"{key}_improvement"] = c.improvement
    return numbers
