"""How far a free fall is from theory at which time step.

PyBullet integrates with the semi-implicit Euler method: the speed first, then the place with the
new speed. From rest the place after n steps is g dt^2 n (n + 1) / 2, which is g t dt / 2 more
than g t^2 / 2; the speed has no error, and the energy falls by m g times the place's error.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, IntegratorConfig, all_solvers
from slamsim.core.types import GRAVITY_M_S2
from slamsim.scenarios.base import BodyMotion, Outcome, Scenario, Trial, Value
from slamsim.scenarios.film import POSES_PER_S, filmed
from slamsim.scenarios.physics.integrator_findings import integrator_findings
from slamsim.sim.bodies import (
    BodySurroundings,
    BurstApart,
    FreeBodies,
    Sphere,
    State,
    engine_settings,
    free_bodies,
)

NOTHING = BodySurroundings(np.zeros((0, 3)), friction=0.0)
"""A fall without a floor."""


def _trials(config: IntegratorConfig, seed: int) -> Sequence[Trial]:
    """A fall for each time step; then the other solvers. Nothing in it is random."""
    steps_s = config.steps.values_s()
    shown_s = steps_s[len(steps_s) // 2]
    standard = [(STANDARD, step_s) for step_s in steps_s]
    others = [(name, step_s) for name in config.other_solvers for step_s in config.other_steps_s]
    return [
        Trial(
            f"{name} {step_s:g} s",
            partial(fall, config, name, step_s, (name, step_s) == (STANDARD, shown_s)),
            2e-6 * config.duration_s / step_s,
        )
        for name, step_s in standard + others
    ]


SCENARIO = Scenario[IntegratorConfig](
    "Integrator: a free fall beside theory",
    lambda config: engine_settings(config.solver),
    _trials,
    lambda config, outcomes: integrator_findings(config, [outcome.values for outcome in outcomes]),
)
"""Scenario 3 of the study."""


def fall(config: IntegratorConfig, name: str, step_s: float, shown: bool = False) -> Outcome:
    """One fall from rest, to the last whole step within its duration."""
    solver = all_solvers(config)[name]
    steps = int(config.duration_s / step_s + 1e-9)
    values: dict[str, Value] = {"solver": name, "step_s": step_s, "end_s": steps * step_s}
    ball = Sphere(config.sphere_radius_m)
    with free_bodies(
        ball, config.sphere_mass_kg, np.zeros((1, 3)), NOTHING, step_s, solver
    ) as falling:
        try:
            seen = _watched(falling, steps, max(1, round(1 / POSES_PER_S / step_s)), shown)
        except BurstApart as burst:
            return Outcome({**values, **_compared(None, 0.0, 0.0), "reason": str(burst)})
        state = seen[-1][1]
        energy_j = falling.energy_j(state)
    compared = _compared(state, steps * step_s, energy_j)
    return Outcome({**values, **compared, "reason": ""}, _motions(ball, step_s, seen, shown))


def _watched(falling: FreeBodies, steps: int, every: int, shown: bool) -> list[tuple[int, State]]:
    """States by the number of steps: the first and the last, and every so many if shown."""
    looks = [*range(0, steps, every if shown else steps), steps]
    seen = [(0, falling.state())]
    for before, now in pairwise(looks):
        falling.advance(now - before)
        seen.append((now, falling.state()))
    return seen


def _compared(state: State | None, end_s: float, energy_j: float) -> dict[str, Value]:
    """Errors of place, speed and energy against a fall without drag from z = 0, at ``end_s``."""
    if state is None:
        return dict.fromkeys(("fall_m", "error_m", "speed_error_m_s", "energy_error_j"))
    fall_m = -float(state.centres_m[0, 2])
    return {
        "fall_m": fall_m,
        "error_m": fall_m - GRAVITY_M_S2 * end_s**2 / 2,
        "speed_error_m_s": -float(state.speeds_m_s[0, 2]) - GRAVITY_M_S2 * end_s,
        "energy_error_j": energy_j,
    }


def _motions(
    ball: Sphere, step_s: float, seen: Sequence[tuple[int, State]], shown: bool
) -> tuple[BodyMotion, ...]:
    if not shown:
        return ()
    stamps_s = np.array([number * step_s for number, _ in seen])
    centres_m = np.array([state.centres_m for _, state in seen])
    quats_xyzw = np.array([state.quats_xyzw for _, state in seen])
    return filmed(["sphere"], ball, stamps_s, centres_m, quats_xyzw)
