"""What the penetrations at all time steps and of all solvers say together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, CollisionConfig, all_solvers
from slamsim.scenarios.base import Chart, Findings, ResultTable, Row, Series, Verdict
from slamsim.scenarios.rows import largest_below, number, trend

KINDS = {"planes": "sphere and plane", "spheres": "sphere and sphere"}
MEAN_BOUNDS_M = (0.001, 0.005)
MOST_BOUNDS_M = (0.01, 0.05)
"""Penetrations for which the largest step is told."""
LISTED_OFF_M = 1e-4
"""The engine's list and the geometry of the poses agree to this: it rounds nothing, but may drop
a contact that opened."""
ENERGY_GAIN = 1e-3
"""Share of the energy at the start that the fall may gain."""


def collision_findings(config: CollisionConfig, rows: Sequence[Row]) -> Findings:
    """Numbers, verdicts, tables and figures. Rows may be missing."""
    known = [row for row in rows if not row["reason"]]
    of_study = [
        row
        for row in known
        if row["solver"] == STANDARD and row["step_s"] in config.steps.values_s()
    ]
    return Findings(
        summary=_summary(of_study),
        numbers=_numbers(of_study),
        verdicts=(
            *(_grows(of_study, kind, which) for kind in KINDS for which in ("mean", "most")),
            _least_is_zero(of_study),
            _list_agrees(known),
            _no_energy_gained(of_study),
        ),
        tables=(_table_of_steps(of_study), _table_of_solvers(config, rows)),
        charts=(
            *(_boxes(of_study, kind) for kind in KINDS),
            _chart_of_solvers(config, known),
            _chart_of_work(config, known),
        ),
    )


def _summary(rows: Sequence[Row]) -> str:
    if not rows:
        return "No fall came to an end."
    first, last = rows[0], rows[-1]
    return (
        f"The deepest penetration at a time step grows from {_mm(first, 'spheres_mean_m')} mm on "
        f"average between spheres ({_mm(first, 'planes_mean_m')} mm in a plane) at "
        f"{first['step_s']:g} s to {_mm(last, 'spheres_mean_m')} mm "
        f"({_mm(last, 'planes_mean_m')} mm) at {last['step_s']:g} s."
    )


def _numbers(rows: Sequence[Row]) -> Row:
    numbers: dict[str, float] = {}
    for row in (*rows[:1], *rows[-1:]):
        step = f"{1000 * number(row, 'step_s'):g}_ms"
        for kind in KINDS:
            numbers[f"{kind}_mean_at_{step}_m"] = number(row, f"{kind}_mean_m")
            numbers[f"{kind}_most_at_{step}_m"] = number(row, f"{kind}_most_m")
    return numbers


def _grows(rows: Sequence[Row], kind: str, which: str) -> Verdict:
    word = {"mean": "mean", "most": "maximum"}[which]
    statement = f"The {word} penetration of {KINDS[kind]} grows with the time step"
    found = trend(
        [number(row, "step_s") for row in rows],
        [number(row, f"{kind}_{which}_m") for row in rows],
    )
    if found is None:
        return Verdict(statement, "study", None, "too few time steps")
    numbers = (
        f"{_mm(rows[0], f'{kind}_{which}_m')} mm at {rows[0]['step_s']:g} s, "
        f"{_mm(rows[-1], f'{kind}_{which}_m')} mm at {rows[-1]['step_s']:g} s; {found}"
    )
    return Verdict(statement, "study", found.grows(), numbers)


def _least_is_zero(rows: Sequence[Row]) -> Verdict:
    statement = "The least penetration is 0"
    if not rows:
        return Verdict(statement, "study", None, "no fall came to an end")
    least_m = max(number(row, f"{kind}_least_m") for row in rows for kind in KINDS)
    return Verdict(statement, "study", least_m == 0.0, f"{1000 * least_m:.3g} mm at most")


def _list_agrees(rows: Sequence[Row]) -> Verdict:
    statement = "The engine's list of contacts has the penetrations of the poses"
    off_m = [number(row, "listed_off_m") for row in rows if row["listed_off_m"] is not None]
    if not off_m:
        return Verdict(statement, "theory", None, "nothing to compare")
    return Verdict(
        statement, "theory", max(off_m) < LISTED_OFF_M, f"off by {1000 * max(off_m):.2g} mm at most"
    )


def _no_energy_gained(rows: Sequence[Row]) -> Verdict:
    statement = "The spheres never have more energy than at the start"
    if not rows:
        return Verdict(statement, "theory", None, "no fall came to an end")
    gain = max(number(row, "energy_gain_share") for row in rows)
    return Verdict(statement, "theory", gain < ENERGY_GAIN, f"{100 * gain:.2g} % more at most")


def _table_of_steps(rows: Sequence[Row]) -> ResultTable:
    values = ("least", "quarter", "median", "three_quarters", "most", "mean")
    return ResultTable(
        "Largest penetration at a time step (mm)",
        (
            "step (s)",
            *(
                f"{short} {word}"
                for short in ("plane", "sphere")
                for word in ("least", "25 %", "median", "75 %", "most", "mean")
            ),
        ),
        tuple(
            (
                f"{row['step_s']:g}",
                *(_mm(row, f"{kind}_{value}_m") for kind in KINDS for value in values),
            )
            for row in rows
        ),
    )


def _table_of_solvers(config: CollisionConfig, rows: Sequence[Row]) -> ResultTable:
    def line(name: str) -> tuple[str, ...]:
        own = [
            row for row in rows if row["solver"] == name and row["step_s"] in config.other_steps_s
        ]
        steps_s = [number(row, "step_s") for row in own]
        bounds = [("mean", bound_m) for bound_m in MEAN_BOUNDS_M]
        bounds += [("most", bound_m) for bound_m in MOST_BOUNDS_M]
        cells = [name.replace("_", " ")]
        for which, bound_m in bounds:
            for kind in KINDS:
                errors_m = [cast("float | None", row[f"{kind}_{which}_m"]) for row in own]
                found = largest_below(steps_s, errors_m, bound_m)
                cells.append("none" if found is None else f"{found:g}")
        return tuple(cells)

    return ResultTable(
        "Which time step for which penetration: the largest (s)",
        (
            "solver",
            *(
                f"{short} {which} < {1000 * bound_m:g} mm"
                for which, bounds in (("mean", MEAN_BOUNDS_M), ("most", MOST_BOUNDS_M))
                for bound_m in bounds
                for short in ("plane", "sphere")
            ),
        ),
        tuple(line(name) for name in all_solvers(config)),
        f"Of {', '.join(f'{step_s:g}' for step_s in sorted(config.other_steps_s))} s. The largest "
        "is that of a blow: up to the speed of the blow times the step.",
    )


def _boxes(rows: Sequence[Row], kind: str) -> Chart:
    at = ("least", "quarter", "median", "three_quarters", "most")
    steps_s = np.array([number(row, "step_s") for row in rows])
    means_mm = np.array([1000 * number(row, f"{kind}_mean_m") for row in rows])
    spread = [[1000 * number(row, f"{kind}_{value}_m") for value in at] for row in rows]
    return Chart(
        f"Largest penetration at each time step: {KINDS[kind]}",
        "time step (s)",
        "penetration (mm)",
        (
            Series(
                "least, quartiles, most",
                "slamsim",
                steps_s,
                means_mm,
                kind="boxes",
                spread=np.array(spread).reshape(-1, len(at)),
            ),
            Series("mean", "slamsim", steps_s, means_mm, kind="line+points"),
        ),
    )


def _chart_of_solvers(config: CollisionConfig, rows: Sequence[Row]) -> Chart:
    return Chart(
        "Mean penetration of every solver: sphere and sphere",
        "time step (s)",
        "mean of the largest penetration (mm)",
        _series(config, rows, work=False),
        logarithmic=(True, True),
    )


def _chart_of_work(config: CollisionConfig, rows: Sequence[Row]) -> Chart:
    return Chart(
        "What less penetration costs",
        "sweeps of the solver per simulated second",
        "mean of the largest penetration of spheres (mm)",
        _series(config, rows, work=True),
        logarithmic=(True, True),
    )


def _series(config: CollisionConfig, rows: Sequence[Row], *, work: bool) -> tuple[Series, ...]:
    series = []
    for name, solver in all_solvers(config).items():
        sweeps = solver.iterations * solver.substeps
        points = sorted(
            (
                sweeps / number(row, "step_s") if work else number(row, "step_s"),
                1000 * number(row, "spheres_mean_m"),
            )
            for row in rows
            if row["solver"] == name and number(row, "spheres_mean_m") > 0.0
        )
        x, y = np.array(points, dtype=np.float64).reshape(-1, 2).T
        series.append(Series(name.replace("_", " "), "slamsim", x, y, kind="line+points"))
    return tuple(series)


def _mm(row: Row, key: str) -> str:
    return f"{1000 * number(row, key):.2f}"
