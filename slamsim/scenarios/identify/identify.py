"""From figures measured on a robot to a robot that behaves like it: ``slamsim identify``.

The fit is made in closed form, where an experiment takes milliseconds. The robot that it finds
then drives the same experiments in the physics engine; by what that differs from the closed form
on the same random numbers, the closed form is corrected, and the fit is made again, until it no
longer moves (space mapping: Bandler et al. 1994).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slamsim.config.measurements import MeasurementsConfig
from slamsim.config.robot import RobotConfig
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import Row
from slamsim.scenarios.identify.fit import (
    Experiment,
    Foreseen,
    RobotFit,
    first_fits,
    foreseen,
    most_likely,
)
from slamsim.scenarios.identify.model import figure_values
from slamsim.scenarios.identify.robot import robot_at, simulated, weighed

STARTS = 6
CHECKED = 2
"""Repetitions of the experiment that are driven in the physics engine at each step."""
STEPS = 4
STILL_SIGMAS = 0.05
"""A fit that moves by less than this many prior sigmas has come to rest."""

Listener = Callable[[str, float], None]
"""Called with what is done now, and the share of it that is done."""


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What came of it.

    fits: points that explain the figures, the most likely one first; robot is made of that.
    simulated, nominal: (f,) figures of that robot, and of the robot as drawn, in the physics
    engine; nan for the ramp. left_out: for each scenario what the others foresee. rows: each run
    of the robot in the engine.
    """

    experiment: Experiment
    fits: tuple[RobotFit, ...]
    robot: RobotConfig
    simulated: FloatArray
    nominal: FloatArray
    left_out: dict[str, Foreseen]
    rows: tuple[Row, ...]

    @property
    def fit(self) -> RobotFit:
        return self.fits[0]


def identify(
    config: MeasurementsConfig,
    *,
    jobs: int | None = None,
    listen: Listener = lambda stage, share: None,
) -> Identified:
    """The robot behind the figures. jobs: processes of the physics engine; all cores if None.

    Raises SlamsimError for a robot that cannot be built or that fails in the physics engine.
    """
    experiment = Experiment(config, weighed(config.robot))
    listen("fit", 0.0)
    fits = first_fits(experiment, STARTS)
    draws = _checked_draws(experiment)
    name, moved_sigmas = f"{config.name}_identified", np.inf
    for step in range(STEPS + 1):
        robot = robot_at(experiment.space.values(fits[0].z), config.robot, name)
        found, rows = _in_engine(experiment, robot, draws, f"check {step + 1}", listen, jobs)
        if step == STEPS or moved_sigmas < STILL_SIGMAS:
            break
        expected = experiment.with_draws(draws).predict(fits[0].z).values
        experiment = experiment.with_offsets(np.where(np.isnan(found), 0.0, found - expected))
        before = fits[0].z
        fits = most_likely(experiment, [fit.z for fit in fits])
        moved_sigmas = float(np.abs(fits[0].z - before).max())
    nominal, _ = _in_engine(
        experiment, config.robot, np.zeros_like(draws[:1]), "as drawn", listen, jobs
    )
    listen("leave one out", 0.0)
    return Identified(experiment, fits, robot, found, nominal, _left_out(experiment, fits), rows)


def _checked_draws(experiment: Experiment) -> FloatArray:
    """(m, runs, 4) of the experiments that are driven; the basic drive without variation, for its
    mean hardly depends on it."""
    draws = experiment.draws[:CHECKED].copy()
    draws[:, : experiment.config.basic_drive.runs] = 0.0
    return draws


def _in_engine(
    experiment: Experiment,
    robot: RobotConfig,
    draws: FloatArray,
    stage: str,
    listen: Listener,
    jobs: int | None,
) -> tuple[FloatArray, tuple[Row, ...]]:
    """(f,) the figures of a robot in the physics engine, nan for the ramp, and its runs."""
    runs, rows = simulated(
        experiment.config,
        robot,
        draws,
        lambda _, done, total: listen(stage, done / total),
        jobs,
    )
    values = [
        np.nan if figure.scenario == "ramp" else float(figure_values(figure, runs).mean())
        for figure in experiment.figures
    ]
    return np.array(values), rows


def _left_out(experiment: Experiment, fits: tuple[RobotFit, ...]) -> dict[str, Foreseen]:
    """For each scenario what the figures of all others have it be.

    In closed form: what the engine corrects was found where all figures lead to.
    """
    experiment = experiment.with_offsets(np.zeros_like(experiment.offsets))
    scenarios = np.array([figure.scenario for figure in experiment.figures])
    starts = [*(fit.z for fit in fits), np.zeros(len(experiment.space))]
    return {
        str(name): foreseen(experiment, most_likely(experiment, starts, scenarios != name)[0])
        for name in dict.fromkeys(scenarios.tolist())
    }
