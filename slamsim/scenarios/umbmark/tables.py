"""The tables of UMBmark."""

from __future__ import annotations

from collections.abc import Sequence

from slamsim.scenarios.base import ResultTable, Row, Who
from slamsim.scenarios.rows import number
from slamsim.scenarios.study_drives import SQUARE_SIDE_M, SQUARES, UNITY_CORNERS_DEG
from slamsim.scenarios.umbmark.method import (
    Clusters,
    CorrectionResult,
    DrivenSquares,
    WheelCorrection,
)

_NAMES: dict[Who, str] = {"reality": "real robot", "unity": "Unity", "gazebo": "Gazebo"}


def errors_sheet(robots: Sequence[DrivenSquares]) -> ResultTable:
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


def _studys_row(who: Who) -> tuple[str, ...]:
    found = SQUARES[who]
    spread = "" if found.spread_m is None else f"{found.spread_m:g}"
    corner = "" if found.corner_deg is None else f"{found.corner_deg:g}"
    return _NAMES[who], f"{SQUARE_SIDE_M:g}", f"{found.largest_error_m:.2f}", spread, corner, "", ""


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


def calibration_sheet(calibrated: Sequence[CorrectionResult]) -> ResultTable:
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


def corner_sheet(corners: Sequence[Row]) -> ResultTable:
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
