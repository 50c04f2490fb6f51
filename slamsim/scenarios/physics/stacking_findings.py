"""What the stacks of all time steps and solvers say together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, StackingConfig, all_solvers
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Row, Series, Verdict
from slamsim.scenarios.rows import FEWEST, number, trend

AS_ONE = 0.25
"""The stack moves as one piece if neighbours' offsets make up less than this share of the top's."""
BY_OFFSETS = 0.5
"""It collapses by such offsets if they make up more than this."""
CHECKED = 0.01
"""What the floor bears and the energy may be off by, as a share."""
CURVES = 6
"""So many time steps are drawn over time."""


def stacking_findings(config: StackingConfig, outcomes: Sequence[Outcome]) -> Findings:
    """Numbers, verdicts, tables and figures. Outcomes may be missing."""
    rows = [outcome.values for outcome in outcomes]
    smallest = [row for row in rows if row["kind"] == "smallest"]
    standard = [row for row in smallest if row["solver"] == STANDARD]
    return Findings(
        summary=_summary(config, standard),
        numbers=_numbers(standard),
        verdicts=_verdicts(config, standard),
        tables=(_table_of_steps(config, standard), _table_of_solvers(config, rows)),
        charts=(
            _chart_of_steps(config, smallest),
            _chart_of_parts(standard),
            _chart_of_sway(outcomes),
            _chart_of_work(config, smallest),
        ),
    )


def _summary(config: StackingConfig, standard: Sequence[Row]) -> str:
    collapsed = [row for row in standard if row["boxes"] is not None]
    if not collapsed:
        return f"No stack of up to {config.max_boxes} boxes collapsed at any time step."
    first, last = collapsed[0], collapsed[-1]
    summary = (
        f"At {first['step_s']:g} s the smallest stack that collapses within "
        f"{config.duration_s:g} s has {first['boxes']} boxes, at {last['step_s']:g} s "
        f"{last['boxes']}."
    )
    missing = [row for row in standard if row["boxes"] is None]
    if missing:
        steps = ", ".join(f"{row['step_s']:g}" for row in missing)
        summary += f" None of up to {config.max_boxes} collapses at {steps} s."
    slid = _median(_known(standard, "slid"))
    if slid is not None:
        summary += (
            f" Offsets between neighbours are {100 * slid:.1f} % of the top's way to the side."
        )
    return summary


def _numbers(standard: Sequence[Row]) -> Row:
    return {
        "fewest_boxes": min(_known(standard, "boxes"), default=None),
        "slid_share": _median(_known(standard, "slid")),
        "tilted_share": _median(_known(standard, "tilted")),
        "bent_share": _median(_known(standard, "bent")),
        "straight_share": _median(_known(standard, "straight")),
        "growth_per_s": _median(_known(standard, "growth_per_s")),
        "boxes_over_step_exponent": _exponent(standard),
    }


def _exponent(standard: Sequence[Row]) -> float | None:
    """Of the power of the time step that the number of boxes follows."""
    known = [row for row in standard if row["boxes"] is not None]
    if len(known) < FEWEST:
        return None
    steps_s, boxes = _known(known, "step_s"), _known(known, "boxes")
    return float(np.polyfit(np.log(steps_s), np.log(boxes), 1)[0])


def _verdicts(config: StackingConfig, standard: Sequence[Row]) -> tuple[Verdict, ...]:
    slid = _median(_known(standard, "slid"))
    parts = "no stack was seen to leave the vertical"
    if slid is not None:
        growth = _median(_known(standard, "growth_per_s"))
        parts = (
            f"median over the time steps, as the top is half a box aside: "
            f"{100 * slid:.1f} % offsets between neighbours, "
            f"{100 * (_median(_known(standard, 'tilted')) or 0.0):.0f} % tilt of the whole stack, "
            f"{100 * (_median(_known(standard, 'bent')) or 0.0):.0f} % bending; a straight line "
            f"explains {100 * (_median(_known(standard, 'straight')) or 0.0):.0f} %; "
            f"it grows by {growth:.2f} per s"
        )
    return (
        _higher_with_smaller_steps(config, standard),
        Verdict(
            "The stack sways as one piece and breaks (Unity in the study)",
            "study",
            None if slid is None else slid < AS_ONE,
            parts,
        ),
        Verdict(
            "Small offsets between neighbours accumulate (Gazebo in the study)",
            "study",
            None if slid is None else slid > BY_OFFSETS,
            parts,
        ),
        _check(
            "The floor bears the weight of a standing stack",
            [share - 1.0 for share in _known(standard, "load_share")],
            "mean load from 1 s on off by {:.3f} % of the weight at most",
        ),
        _check(
            "A standing stack never has more energy than at the start",
            [max(gain, 0.0) for gain in _known(standard, "energy_gain_share")],
            "{:.4f} % more at most",
        ),
    )


def _higher_with_smaller_steps(config: StackingConfig, standard: Sequence[Row]) -> Verdict:
    """A step at which none collapsed counts as one box more than the search goes to."""
    steps_s = [number(row, "step_s") for row in standard]
    boxes = [cast(int, row["boxes"] or config.max_boxes + 1) for row in standard]
    found = trend(steps_s, boxes)
    numbers = "too few time steps" if found is None else f"boxes against step: {found}"
    holds = None if found is None else found.falls()
    return Verdict("Smaller time steps stack higher", "study", holds, numbers)


def _check(statement: str, off: Sequence[float], numbers: str) -> Verdict:
    if not off:
        return Verdict(statement, "theory", None, "no stack stood")
    worst = max(abs(share) for share in off)
    return Verdict(statement, "theory", worst < CHECKED, numbers.format(100 * worst))


def _table_of_steps(config: StackingConfig, standard: Sequence[Row]) -> ResultTable:
    shares = ("slid", "tilted", "bent", "straight")
    return ResultTable(
        "Smallest stack that collapses",
        ("step (s)", "boxes", "falls after (s)", "slid", "tilted", "bent", "straight", "swings"),
        tuple(
            (
                f"{row['step_s']:g}",
                f"> {config.max_boxes}" if row["boxes"] is None else f"{row['boxes']}",
                _told(row["collapsed_after_s"], "{:.1f}"),
                *(_told(row[share], "{:.3f}") for share in shares),
                _told(row["swings"], "{}"),
            )
            for row in standard
        ),
        "What the top's way to the side consists of when it is half a box: offsets between "
        "neighbours, tilt of the whole stack on its lowest box, bending; and how much of it a "
        "straight line through all boxes explains. Swings: how often it had crossed the vertical.",
    )


def _table_of_solvers(config: StackingConfig, rows: Sequence[Row]) -> ResultTable:
    steps_s = config.other_steps_s
    boxes = {
        (row["solver"], row["step_s"]): row["boxes"] for row in rows if row["kind"] == "smallest"
    }
    given = {row["solver"]: row["step_s"] for row in rows if row["kind"] == "given"}
    tried = config.steps.values_s()

    def line(name: str) -> Iterable[str]:
        yield name.replace("_", " ")
        step_s = given.get(name)
        if name in given and step_s is None:
            yield f"< {tried[0]:g}"
        else:
            yield _told(step_s, "≥ {:g}" if step_s == tried[-1] else "{:g}")
        for at_s in steps_s:
            found = boxes.get((name, at_s))
            capped = (name, at_s) in boxes and found is None
            yield f"> {config.max_boxes}" if capped else _told(found, "{}")

    return ResultTable(
        f"Which time step for a stack of {config.compared_boxes}",
        (
            "solver",
            f"largest step at which {config.compared_boxes} stand (s)",
            *(f"smallest that collapses at {step_s:g} s" for step_s in steps_s),
        ),
        tuple(tuple(line(name)) for name in all_solvers(config)),
        f"Of the time steps from {tried[0]:g} to {tried[-1]:g} s.",
    )


def _chart_of_steps(config: StackingConfig, smallest: Sequence[Row]) -> Chart:
    return Chart(
        "Smallest stack that collapses",
        "time step (s)",
        "boxes",
        tuple(
            _series(name, [row for row in smallest if row["solver"] == name], "step_s", "boxes")
            for name in all_solvers(config)
        ),
        note=f"No point where none of up to {config.max_boxes} boxes collapsed.",
    )


def _chart_of_parts(standard: Sequence[Row]) -> Chart:
    names = {
        "slid": "offsets between neighbours",
        "tilted": "tilt as one",
        "bent": "bending",
        "straight": "on a straight line",
    }
    return Chart(
        "What the top's way to the side consists of",
        "time step (s)",
        "share of the way",
        tuple(_series(label, standard, "step_s", key) for key, label in names.items()),
        note="At the moment when the top is half a box aside, for the smallest stack that falls.",
    )


def _chart_of_sway(outcomes: Sequence[Outcome]) -> Chart:
    known = [
        outcome
        for outcome in outcomes
        if outcome.values["solver"] == STANDARD and outcome.arrays.get("top_m", np.zeros(0)).any()
    ]
    chosen = known[:: max(1, -(-len(known) // CURVES))]
    return Chart(
        "How the top leaves the vertical",
        "time (s)",
        "way to the side (m)",
        tuple(
            Series(
                f"{outcome.values['boxes']} boxes at {outcome.values['step_s']:g} s",
                "slamsim",
                outcome.arrays["stamps_s"][outcome.arrays["top_m"] > 0.0],
                outcome.arrays["top_m"][outcome.arrays["top_m"] > 0.0],
            )
            for outcome in chosen
        ),
        logarithmic=(False, True),
    )


def _chart_of_work(config: StackingConfig, smallest: Sequence[Row]) -> Chart:
    series = []
    for name, solver in all_solvers(config).items():
        rows = [
            {
                **row,
                "work": solver.iterations * solver.substeps / number(row, "step_s"),
            }
            for row in smallest
            if row["solver"] == name
        ]
        series.append(_series(name, rows, "work", "boxes"))
    return Chart(
        "What a higher stack costs",
        "sweeps of the solver per simulated second",
        "boxes of the smallest stack that collapses",
        tuple(series),
        logarithmic=(True, True),
    )


def _series(name: str, rows: Sequence[Row], x: str, y: str) -> Series:
    known = sorted((number(row, x), number(row, y)) for row in rows if row[y] is not None)
    points = np.array(known, dtype=np.float64).reshape(-1, 2)
    return Series(name.replace("_", " "), "slamsim", points[:, 0], points[:, 1], kind="line+points")


def _known(rows: Sequence[Row], key: str) -> list[float]:
    return [number(row, key) for row in rows if row[key] is not None]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _told(value: object, form: str) -> str:
    return "–" if value is None else form.format(value)
