"""Findings of UMBmark: odometry errors, their causes, and the effect of calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np

from slamsim.config.scenarios.robots import UmbmarkConfig
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Row, Series, Source, Value
from slamsim.scenarios.rows import number
from slamsim.scenarios.scripted import SQUARE_SIDE_M, SQUARES, UNITY_CORNERS_DEG
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
            f"E_max of {source}",
            source,
            figures.largest_error_m * np.cos(circle),
            figures.largest_error_m * np.sin(circle),
            "line",
            dashed=True,
        )
        for source, figures in SQUARES.items()
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
        summary=_summary(robots, calibrated),
        numbers=_numbers(robots, calibrated),
        verdicts=(
            *robot_verdicts(robots, config.robot),
            *calibration_verdicts([c for c in calibrated if c.true is not None]),
            friction_verdict(corners),
        ),
        tables=(errors_table(robots), calibration_table(calibrated), corner_table(corners)),
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


def _summary(robots: Sequence[DrivenSquares], calibrated: Sequence[CorrectionResult]) -> str:
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


_NAMES: dict[Source, str] = {"reality": "real robot", "unity": "Unity", "gazebo": "Gazebo"}


def errors_table(robots: Sequence[DrivenSquares]) -> ResultTable:
    """E_max, spread and corners of all, ours and others'."""
    rows = [*map(_studys_row, SQUARES), *map(_our_row, robots)]
    header = (
        "who",
        "side [m]",
        "E_max [m]",
        "spread [m]",
        "corner [deg]",
        "by odometry [deg]",
        "E_max of each set [m]",
    )
    note = (
        "E_max: distance of the farther centre of gravity; spread: largest distance of two end "
        "errors of one direction; means of all sets. The study gives Unity's corner, and says that "
        "the real robot's is nearly the same."
    )
    return ResultTable("Errors of odometry", header, tuple(rows), note)


def _studys_row(source: Source) -> tuple[str, ...]:
    found = SQUARES[source]
    spread = "" if found.spread_m is None else f"{found.spread_m:g}"
    corner = "" if found.corner_deg is None else f"{found.corner_deg:g}"
    return (
        _NAMES[source],
        f"{SQUARE_SIDE_M:g}",
        f"{found.largest_error_m:.2f}",
        spread,
        corner,
        "",
        "",
    )


def _our_row(one: DrivenSquares) -> tuple[str, ...]:
    each = " ".join(f"{found.largest_m():.2f}" for found in one.found)
    return (
        f"slamsim, {one.robot}",
        f"{one.side_m:g}",
        f"{one.largest_m:.2f}",
        f"{one.spread_m:.2f}",
        f"{one.corner_deg:.1f}",
        f"{one.odometry_corner_deg:.1f}",
        each if len(one.found) > 1 else "",
    )


def calibration_table(calibrated: Sequence[CorrectionResult]) -> ResultTable:
    """E_d and E_b by both methods, and what they make of fresh squares."""
    rows: list[tuple[str, ...]] = []
    for one in calibrated:
        if one.true is not None:
            rows.append((one.robot, "truth", *_ratios(one.true), "", "", ""))
        rows.append(_calibration_row(one, "none", WheelCorrection(), one.before))
        if one.formulas is not None and one.after_formulas is not None:
            rows.append(
                _calibration_row(one, "Borenstein & Feng", one.formulas, one.after_formulas)
            )
        rows.append(_calibration_row(one, "least squares", one.fitted, one.after))
    header = ("robot", "calibration", "E_d", "E_b", "E_max [m]", "times smaller", "chance [m]")
    note = (
        "Calibrated on one set of squares, judged on others with other random numbers. Chance: "
        "what the scatter from run to run leaves in the means of so few squares, of the set and "
        "of the others; no calibration takes it away. The formulas of 1996 hold for corners of "
        "90 degrees and small errors."
    )
    return ResultTable("Calibration", header, tuple(rows), note)


def _ratios(calibration: WheelCorrection) -> tuple[str, str]:
    return f"{calibration.diameter_ratio:.4f}", f"{calibration.track_ratio:.4f}"


def _calibration_row(
    one: CorrectionResult, name: str, calibration: WheelCorrection, after: Clusters
) -> tuple[str, ...]:
    left_m = after.largest_m()
    return (
        one.robot,
        name,
        *_ratios(calibration),
        f"{left_m:.3f}",
        f"{one.before.largest_m() / max(left_m, 1e-9):.1f}",
        f"{one.chance_m:.3f}",
    )


def corner_table(corners: Sequence[Row]) -> ResultTable:
    """One corner on tyres of several frictions."""
    rows = tuple(
        (
            f"{row['friction']:g}",
            "dragged" if row["dragged"] else "rolling",
            f"{row['corner_deg']:.1f}",
            f"{row['odometry_corner_deg']:.1f}",
            f"{UNITY_CORNERS_DEG[friction]:g}" if friction in UNITY_CORNERS_DEG else "",
        )
        for row in corners
        for friction in [number(row, "friction")]
    )
    header = ("friction", "supports", "corner [deg]", "by odometry [deg]", "Unity [deg]")
    return ResultTable("One corner of 90 degrees", header, rows)
