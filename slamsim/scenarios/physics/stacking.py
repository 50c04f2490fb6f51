"""How many boxes can be stacked at which time step, and how a stack collapses.

The boxes are put exactly on one another, as in the study. Such a stack does not stand for ever:
the solver treats its contacts one after the other, which is enough to bend it sideways, and
misplacing the boxes by up to a centimetre changes the answer by one box at most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, SolverConfig, StackingConfig, all_solvers
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.scenarios.base import BodyMotion, Outcome, Scenario, Trial, Value
from slamsim.scenarios.film import POSES_PER_S, filmed
from slamsim.scenarios.physics.stack_run import StackRun, leaving_of, run_stack, sway_of
from slamsim.scenarios.physics.stacking_findings import stacking_findings
from slamsim.sim.bodies import Box, engine_settings

IN_A_ROW = 2
"""So many neighbours must hold before the border is believed: near it the two kinds mix."""


def smallest_failing(fails: Callable[[int], bool], most: int) -> int | None:
    """The smallest number that fails with the ``IN_A_ROW`` numbers below it holding, or None.

    By halving from 1, which is taken to hold, to ``most``; if that holds the answer is None. Then
    downwards until so many hold in a row, for failing need not be monotone. ``fails`` is asked
    once for a number.
    """
    known: dict[int, bool] = {1: False}

    def failing(number: int) -> bool:
        if number not in known:
            known[number] = fails(number)
        return known[number]

    if not failing(most):
        return None
    holding, found = 1, most
    while found - holding > 1:
        middle = (holding + found) // 2
        if failing(middle):
            found = middle
        else:
            holding = middle
    below = found - 1
    while below > max(found - 1 - IN_A_ROW, 0):
        if failing(below):
            found = below
        below -= 1
    return found


def largest_passing(passes: Callable[[float], bool], ascending: Sequence[float]) -> float | None:
    """The largest value that passes with the next ``IN_A_ROW - 1`` below it, or None.

    From the largest down: at the ends of the list as many as there are must pass.
    """
    in_a_row = 0
    for at in reversed(range(len(ascending))):
        in_a_row = in_a_row + 1 if passes(ascending[at]) else 0
        if in_a_row == IN_A_ROW or (in_a_row and at == 0):
            return ascending[at + in_a_row - 1]
    return None


AFTERMATH_S = 3.0
"""The collapse that is shown is followed for so long."""
SETTLED_S = 1.0
"""From then on the floor's load is compared with the weight of the stack."""


def _trials(config: StackingConfig, seed: int) -> Sequence[Trial]:
    """The smallest collapsing stack for each step; then other solvers, and a given stack."""
    steps_s = config.steps.values_s()
    shown_s = steps_s[len(steps_s) // 2]
    smallest = [
        Trial(
            f"step {step_s:g} s",
            partial(smallest_stack, config, STANDARD, step_s, seed, step_s == shown_s),
            _cost_s(config, config.solver, step_s),
        )
        for step_s in steps_s
    ]
    compared = [
        Trial(
            f"{name} {step_s:g} s",
            partial(smallest_stack, config, name, step_s, seed),
            _cost_s(config, solver, step_s),
        )
        for name, solver in config.other_solvers.items()
        for step_s in config.other_steps_s
    ]
    given = [
        Trial(
            f"{name}: stack of {config.compared_boxes}",
            partial(largest_step, config, name, seed),
            _cost_s(config, solver, 0.02),
        )
        for name, solver in all_solvers(config).items()
    ]
    return [*smallest, *compared, *given]


SCENARIO = Scenario[StackingConfig](
    "Stacking: how many boxes stand",
    lambda config: engine_settings(config.solver),
    _trials,
    stacking_findings,
)
"""Scenario 1 of the study."""


def smallest_stack(
    config: StackingConfig, name: str, step_s: float, seed: int, shown: bool = False
) -> Outcome:
    """The smallest stack that collapses at one time step, and how it does."""
    solver = all_solvers(config)[name]
    runs = dict[int, StackRun]()

    def collapses(boxes: int) -> bool:
        runs[boxes] = run_stack(config, boxes, step_s, solver, seed)
        return runs[boxes].collapsed_s is not None

    boxes = smallest_failing(collapses, config.max_boxes)
    standing = max((n for n in runs if runs[n].collapsed_s is None), default=None)
    values: dict[str, Value] = {
        "kind": "smallest",
        "solver": name,
        "step_s": step_s,
        "boxes": boxes,
        "tried": len(runs),
        "standing_boxes": standing,
        **_checked(config, None if standing is None else runs[standing], standing or 0),
        **_collapse(config, None if boxes is None else runs[boxes]),
    }
    motions: tuple[BodyMotion, ...] = ()
    if shown and boxes is not None:
        run = run_stack(config, boxes, step_s, solver, seed, 1.0 / POSES_PER_S, AFTERMATH_S)
        names = [f"box {k + 1}" for k in range(boxes)]
        motions = filmed(names, Box(config.box_size_m), run.stamps_s, run.centres_m, run.quats_xyzw)
    return Outcome(values, motions, {} if boxes is None else _arrays(config, runs[boxes]))


def largest_step(config: StackingConfig, name: str, seed: int) -> Outcome:
    """The largest time step at which a stack of ``config.compared_boxes`` stands."""
    solver = all_solvers(config)[name]

    def stands(step_s: float) -> bool:
        run = run_stack(config, config.compared_boxes, step_s, solver, seed)
        return run.collapsed_s is None

    step_s = largest_passing(stands, config.steps.values_s())
    return Outcome(
        {"kind": "given", "solver": name, "step_s": step_s, "boxes": config.compared_boxes}
    )


def _collapse(config: StackingConfig, run: StackRun | None) -> dict[str, Value]:
    """When and how the smallest stack collapsed; None where nothing can be said."""
    told: dict[str, Value] = dict.fromkeys(
        ("left_after_s", "slid", "tilted", "bent", "straight", "growth_per_s", "swings")
    )
    if run is None:
        return {"collapsed_after_s": None, "reason": "none collapsed", **told}
    sway = sway_of(run, config.box_size_m[2])
    leaving = leaving_of(run, sway, min(config.box_size_m[:2]))
    if leaving is not None:
        told = {
            "left_after_s": leaving.after_s,
            "slid": leaving.slid,
            "tilted": leaving.tilted,
            "bent": leaving.bent,
            "straight": leaving.straight,
            "growth_per_s": leaving.growth_per_s,
            "swings": leaving.swings,
        }
    reason = "burst apart" if run.burst else "fell"
    return {"collapsed_after_s": run.collapsed_s, "reason": reason, **told}


def _arrays(config: StackingConfig, run: StackRun) -> dict[str, FloatArray]:
    sway = sway_of(run, config.box_size_m[2])
    return {"stamps_s": sway.stamps_s, "top_m": sway.top_m}


def _checked(config: StackingConfig, run: StackRun | None, boxes: int) -> dict[str, Value]:
    """Load on the floor as a share of the weight, and energy gained as a share of that at first,
    of the tallest stack that stood."""
    if run is None:
        return {"load_share": None, "energy_gain_share": None}
    weight_n = config.box_mass_kg * GRAVITY_M_S2 * boxes
    load_n = run.load_n[run.stamps_s >= SETTLED_S]
    return {
        "load_share": float(np.mean(load_n) / weight_n),
        "energy_gain_share": float(np.max(run.energy_j) / run.energy_j[0] - 1.0),
    }


def _cost_s(config: StackingConfig, solver: SolverConfig, step_s: float) -> float:
    """Of a search, about: boxes and trials vary less than the work of a step."""
    sweeps = solver.iterations * solver.substeps / step_s
    return 5e-4 * sweeps * config.duration_s / 20.0
