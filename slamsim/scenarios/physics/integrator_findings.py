"""What the falls at all time steps say together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, IntegratorConfig, SolverConfig, all_solvers
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.scenarios.base import Chart, Findings, ResultTable, Row, Series, Verdict
from slamsim.scenarios.rows import number, trend

NEAR = 0.01
"""A measured value agrees with the analytical one if it is off by less than this share."""
PROPORTIONAL = 1e-3
"""The error is proportional to the step if it is off the line through 0 by less than this share
of the largest error."""
EXACT = 1e-9
"""Share of a speed that rounding may change."""
BOUNDS_M = (0.01, 0.1, 1.0)
"""Errors for which the largest step is told."""


@dataclass(frozen=True, slots=True, eq=False)
class TrendLine:
    """Error over step of one solver, ascending. slope_m_s: through 0, of errors scaled to the
    whole duration; analytical_m_s: what it should be without drag. off: the largest distance from
    that line, as a share of the largest error."""

    steps_s: FloatArray
    errors_m: FloatArray
    slope_m_s: float
    analytical_m_s: float
    off: float

    def deviation(self) -> float:
        return self.slope_m_s / self.analytical_m_s - 1.0


def integrator_findings(config: IntegratorConfig, rows: Sequence[Row]) -> Findings:
    """Numbers, verdicts, tables and figures. Rows may be missing."""
    lines = {
        name: line
        for name, solver in all_solvers(config).items()
        if (line := _line(config, solver, [row for row in rows if row["solver"] == name]))
    }
    standard = [row for row in rows if row["solver"] == STANDARD and row["fall_m"] is not None]
    line = lines.get(STANDARD)
    return Findings(
        summary=_summary(config, line),
        numbers={
            "slope_m_s": line.slope_m_s if line else None,
            "analytical_slope_m_s": line.analytical_m_s if line else None,
            "slope_deviation": line.deviation() if line else None,
        },
        verdicts=(
            _proportional(line),
            _slope_as_in_theory(line),
            _substeps_count_as_steps(config, lines),
            _speed_exact(config, standard),
            _energy_as_in_theory(config, standard),
        ),
        tables=(_table(lines),),
        charts=(_chart_of_error(config, lines), _chart_of_all(lines)),
    )


def _line(config: IntegratorConfig, solver: SolverConfig, rows: Sequence[Row]) -> TrendLine | None:
    """A step that does not divide the duration ends early; its error is scaled to the whole."""
    known = sorted(
        (
            number(row, "step_s"),
            number(row, "error_m") * config.duration_s / number(row, "end_s"),
        )
        for row in rows
        if row["error_m"] is not None
    )
    if not known:
        return None
    steps_s, errors_m = np.array(known).T
    slope_m_s = float(steps_s @ errors_m / (steps_s @ steps_s))
    largest_m = float(np.abs(errors_m).max())
    off_m = float(np.abs(errors_m - slope_m_s * steps_s).max())
    analytical_m_s = GRAVITY_M_S2 * config.duration_s / 2 / solver.substeps
    off = off_m / largest_m if largest_m else 0.0
    return TrendLine(steps_s, errors_m, slope_m_s, analytical_m_s, off)


def _summary(config: IntegratorConfig, line: TrendLine | None) -> str:
    if line is None:
        return "No fall came to an end."
    return (
        f"After {config.duration_s:g} s the sphere is {line.slope_m_s:.4g} m too far for each "
        f"second of the time step; {line.analytical_m_s:.4g} m is what semi-implicit Euler gives."
    )


def _proportional(line: TrendLine | None) -> Verdict:
    statement = "The error is proportional to the time step"
    found = None if line is None else trend(line.steps_s.tolist(), line.errors_m.tolist())
    if line is None or found is None:
        return Verdict(statement, "study", None, "too few time steps")
    numbers = f"off the line through 0 by {100 * line.off:.2g} % of the largest error; {found}"
    return Verdict(statement, "study", found.grows() and line.off < PROPORTIONAL, numbers)


def _slope_as_in_theory(line: TrendLine | None) -> Verdict:
    statement = "The slope of error over step is within 1 % of g t / 2"
    if line is None:
        return Verdict(statement, "target", None, "no fall came to an end")
    numbers = (
        f"{line.slope_m_s:.4g} m/s measured, {line.analytical_m_s:.4g} m/s analytical: "
        f"{100 * line.deviation():+.2g} %"
    )
    return Verdict(statement, "target", abs(line.deviation()) < NEAR, numbers)


def _substeps_count_as_steps(config: IntegratorConfig, lines: dict[str, TrendLine]) -> Verdict:
    statement = "A step in n substeps has the error of a step n times smaller"
    told = [
        (solver.substeps, lines[name].deviation())
        for name, solver in all_solvers(config).items()
        if name in lines and solver.substeps > 1 and solver.damping == 0.0
    ]
    numbers = "; ".join(f"n = {n}: slope off by {100 * off:+.2g} %" for n, off in told)
    holds = all(abs(off) < NEAR for _, off in told) if told else None
    return Verdict(statement, "theory", holds, numbers or "no solver with substeps")


def _speed_exact(config: IntegratorConfig, standard: Sequence[Row]) -> Verdict:
    statement = "The speed has no error but rounding"
    if not standard or config.solver.damping:
        return Verdict(statement, "theory", None, "no fall without damping")
    worst_m_s = max(abs(number(row, "speed_error_m_s")) for row in standard)
    holds = worst_m_s < EXACT * GRAVITY_M_S2 * config.duration_s
    return Verdict(statement, "theory", holds, f"off by {worst_m_s:.1g} m/s at most")


def _energy_as_in_theory(config: IntegratorConfig, standard: Sequence[Row]) -> Verdict:
    """By the closed form of the method: the energy at the end is minus m g (g t dt / 2)."""
    statement = "The energy that the method loses is m g times the error of the place"
    if not standard or config.solver.damping:
        return Verdict(statement, "theory", None, "no fall without damping")
    weight_n = config.sphere_mass_kg * GRAVITY_M_S2
    shares = []
    for row in standard:
        end_s, step_s = number(row, "end_s"), number(row, "step_s")
        lost_j = weight_n * GRAVITY_M_S2 * end_s * step_s / config.solver.substeps / 2
        shares.append(abs(number(row, "energy_error_j") / -lost_j - 1.0))
    numbers = f"off by {100 * max(shares):.2g} % of m g (g t dt / 2) at most"
    return Verdict(statement, "theory", max(shares) < NEAR, numbers)


def _table(lines: dict[str, TrendLine]) -> ResultTable:
    def step_for(line: TrendLine, bound_m: float) -> str:
        if line.off < PROPORTIONAL and line.slope_m_s > 0:
            return f"{bound_m / line.slope_m_s:.2g}"
        return "none"

    return ResultTable(
        "Which time step for which error of the fall",
        (
            "solver",
            "error over step (m/s)",
            "analytical (m/s)",
            "error at the smallest step (m)",
            *(f"step for {bound_m:g} m (s)" for bound_m in BOUNDS_M),
        ),
        tuple(
            (
                name.replace("_", " "),
                f"{line.slope_m_s:.4f}" if line.off < PROPORTIONAL else "not proportional",
                f"{line.analytical_m_s:.4f}",
                f"{line.errors_m[0]:.4f}",
                *(step_for(line, bound_m) for bound_m in BOUNDS_M),
            )
            for name, line in lines.items()
        ),
        "By the line through 0, also where it is extended. Contacts play no part in a fall, so "
        "that sweeps and contact parameters change nothing. Damping, which PyBullet is shipped "
        "with, brakes a fall at any step; it brakes articulated bodies more, and their speed is "
        "held below 100 m/s.",
    )


def _chart_of_error(config: IntegratorConfig, lines: dict[str, TrendLine]) -> Chart:
    undamped = [name for name, solver in all_solvers(config).items() if not solver.damping]
    series = [
        Series(name.replace("_", " "), "slamsim", line.steps_s, line.errors_m, kind="line+points")
        for name, line in lines.items()
        if name in undamped
    ]
    if line := lines.get(STANDARD):
        series.append(
            Series(
                "g t dt / 2",
                "theory",
                line.steps_s,
                line.analytical_m_s * line.steps_s,
                dashed=True,
            )
        )
    return Chart(
        f"Error of the fall after {config.duration_s:g} s",
        "time step (s)",
        "error against g t² / 2 (m)",
        tuple(series),
        note="Without damping.",
    )


def _chart_of_all(lines: dict[str, TrendLine]) -> Chart:
    return Chart(
        "Size of the error for every solver",
        "time step (s)",
        "size of the error (m)",
        tuple(
            Series(
                name.replace("_", " "),
                "slamsim",
                line.steps_s[line.errors_m != 0.0],
                np.abs(line.errors_m[line.errors_m != 0.0]),
                kind="line+points",
            )
            for name, line in lines.items()
        ),
        logarithmic=(True, True),
    )
