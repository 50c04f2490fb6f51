"""Tables of the report: lower bounds, and the error budget of SLAM."""

from __future__ import annotations

from slamsim.evaluate.budget import PARTS
from slamsim.evaluate.consistency import DEGREES_OF_FREEDOM
from slamsim.evaluate.trajectory import statistics
from slamsim.report.pages.html import Table, table
from slamsim.report.run_view import RunView


def precision_tables(view: RunView) -> str:
    """HTML, empty without truth."""
    return _limits(view) + _budget(view) + _consistency(view)


def _limits(view: RunView) -> str:
    bound, errors = view.scores.bound, view.scores.trajectory
    if bound is None or errors is None:
        return ""
    ate_m = statistics(errors.translation_m).rmse
    rows = [
        ("this run, ATE", _mm(ate_m), "", f"{ate_m / bound.ate_m:.3g} ×"),
        ("any SLAM, lower bound of the ATE", _mm(bound.ate_m), "", "1 ×"),
        (
            "in a known map, lower bound",
            _mm(bound.localisation_m),
            _mrad(bound.localisation_rad),
            "",
        ),
        ("from one scan in a known map", _mm(bound.scan_m), _mrad(bound.scan_rad), ""),
    ]
    note = (
        "Cramér-Rao bounds for the true walls, the true path, and sensors as configured; RMS, "
        "from one scan the median. Clean ranges only: "
        f"{100 * bound.lost_share:.2g} % of the beams get lost and {100 * bound.mixed_share:.2g} % "
        "see two surfaces, which makes all of this a little harder than the bounds know."
    )
    return table(Table(("limit", "position [mm]", "heading [mrad]", ""), rows), note)


def _budget(view: RunView) -> str:
    budget, errors = view.scores.budget, view.scores.trajectory
    if not budget or errors is None:
        return ""
    rows = [
        (
            PARTS[part],
            _mm(found.step_rmse_m),
            f"{found.step_rmse_mrad:.3g}",
            _mm(found.ate_rmse_m),
            f"{found.ate_rot_rmse_mrad:.3g}",
        )
        for part, found in budget.items()
    ]
    overall = statistics(errors.translation_m).rmse, statistics(errors.rotation_rad).rmse
    rows.append(("all scans, final", "", "", _mm(overall[0]), _mrad(overall[1])))
    if view.scores.map is not None and view.scores.map.wall_error_mean_m is not None:
        rows.append(("mapped walls, mean", "", "", _mm(view.scores.map.wall_error_mean_m), ""))
    note = (
        "RMS errors at the key frames after each part of the work: of the step from one to the "
        "next, and of the whole after one alignment. Walls are drawn in cells of "
        f"{1e3 * view.grid.resolution_m:.0f} mm."
    )
    header = ("after", "step [mm]", "step [mrad]", "ATE [mm]", "heading [mrad]")
    return table(Table(header, rows), note)


def _consistency(view: RunView) -> str:
    consistency = view.scores.consistency
    if consistency is None:
        return ""
    rows = [
        ("NEES, mean", f"{consistency.mean:.3g}", f"{DEGREES_OF_FREEDOM}"),
        ("key frames within their 95 % ellipse", f"{100 * consistency.inside_share:.1f} %", "95 %"),
    ]
    in_map = view.scores.in_map
    if in_map is not None:
        rows.append(("NEES within the map, mean", f"{in_map.mean:.3g}", f"{DEGREES_OF_FREEDOM}"))
    note = (
        "Normalised estimation error squared of key frames relative to the first, and relative to "
        "the map as a whole. Errors of neighbours, and all errors relative to the first, are "
        "alike: only the mean over many runs must be close to what is expected."
    )
    return table(Table(("claimed uncertainty", "found", "expected"), rows), note)


def _mm(value_m: float) -> str:
    return f"{1e3 * value_m:.3g}"


def _mrad(value_rad: float) -> str:
    return f"{1e3 * value_rad:.3g}"
