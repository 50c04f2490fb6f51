"""Maximum a posteriori fit of robot parameters to measured figures, with uncertainties.

Priors are normal in the logarithms of the parameters; a figure is normal about what the model
expects of it, with what was read wrongly and what few repeats leave to chance. The most likely
point is found by least squares with the chance of the last point, a few times (Gauss-Newton,
iteratively reweighted); its curvature is the posterior covariance (Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from slamsim.config.measurements import FigureConfig, MeasurementsConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, FloatArray
from slamsim.scenarios.identify.model import (
    VARYING,
    Body,
    ParameterSpace,
    Runs,
    driven,
    figure_values,
    ramp_value,
    space_with,
    wheels_of,
)
from slamsim.scenarios.scripted import square_commands, straight_commands

REPETITIONS = 24
"""Times the whole experiment is computed: its mean is what is expected, its scatter the chance."""
REWEIGHTED = 4
STEP = 1e-3
"""Of the derivatives, in prior sigmas."""
FARTHEST_SIGMAS = 6.0
"""Bounds of the fit in prior sigmas: the prior excludes what lies beyond."""
FORESEEN = 100
SAME_POINT_SIGMAS = 0.5
SCRUBBING = (0.0, 0.3, 0.6, 1.0)
"""Shares of the scrubbing of the supports as they were drawn, from which fits begin too: it has
several minima."""


@dataclass(frozen=True, slots=True, eq=False)
class FigurePrediction:
    """values, chance: (f,) each figure as expected, and how far one experiment is from that."""

    values: FloatArray
    chance: FloatArray


class Experiment:
    """What was done with the robot, in closed form.

    offsets: (f,) what is added to each figure: by how much the physics engine differs. draws: of
    standard normal numbers for (m, runs of the basic drive, then of both squares, 4).
    """

    def __init__(
        self, config: MeasurementsConfig, body: Body, draws: FloatArray | None = None
    ) -> None:
        self.config, self.body, self.figures = config, body, config.figures
        self.space: ParameterSpace = space_with(config.priors)
        self.offsets: FloatArray = np.zeros(len(config.figures))
        self.draws = drawn(config) if draws is None else draws

    def with_offsets(self, offsets: FloatArray) -> Experiment:
        """The same experiment with another correction."""
        made = Experiment(self.config, self.body, self.draws)
        made.offsets = offsets
        return made

    def with_draws(self, draws: FloatArray) -> Experiment:
        """The same model, other repetitions, without correction."""
        return Experiment(self.config, self.body, draws)

    def predict(self, z: FloatArray) -> FigurePrediction:
        """All figures, of a robot at z."""
        values, runs = self.space.values(z), self.runs(z)
        expected, chance = np.empty(len(self.figures)), np.zeros(len(self.figures))
        for i, figure in enumerate(self.figures):
            if figure.scenario == "ramp":
                expected[i] = ramp_value(figure, values, self.body, self.config.ramp)
            else:
                found = figure_values(figure, runs)
                expected[i], chance[i] = found.mean(), found.std(ddof=1) if len(found) > 1 else 0.0
        return FigurePrediction(expected + self.offsets, chance)

    def runs(self, z: FloatArray) -> Runs:
        """What the repetitions come to."""
        values, config = self.space.values(z), self.config
        straights, squares = config.basic_drive.runs, config.umbmark.runs
        track_m, m = config.robot.drive_wheels.track_m, len(self.draws)

        scrub = self.body.scrub_n_m2
        wheels = wheels_of(values, self.draws[:, :straights].reshape(-1, len(VARYING)), scrub)
        true = driven(wheels, straight_commands(config.basic_drive), track_m).true
        stops_m = true[:, 1::2, :2].reshape(m, straights, -1, 2)

        errors_m, corners_deg = [], []
        for first, left in ((straights, False), (straights + squares, True)):
            draws = self.draws[:, first : first + squares].reshape(-1, len(VARYING))
            commands = square_commands(config.umbmark, config.umbmark.side_m, left=left)
            motions = driven(wheels_of(values, draws, scrub), commands, track_m)
            errors_m.append(motions.true[:, -1, :2] - motions.odometry[:, -1, :2])
            yaw = motions.true[:, :, 2]
            corners_deg.append(np.degrees(np.abs(yaw[:, 3::4] - yaw[:, 2::4]).mean(axis=1)))
        return Runs(
            stops_m,
            np.stack([e.reshape(m, squares, 2) for e in errors_m], axis=1),
            np.stack([c.reshape(m, squares) for c in corners_deg], axis=1),
        )


def drawn(config: MeasurementsConfig, repetitions: int = REPETITIONS) -> FloatArray:
    """(m, runs, 4) how each run's robot differs: always the same numbers."""
    runs = config.basic_drive.runs + 2 * config.umbmark.runs
    draws = random_stream(0, "identify").standard_normal((repetitions, runs, len(VARYING)))
    return np.asarray(np.clip(draws, -3.0, 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class RobotFit:
    """z: (p,) most likely point, in prior sigmas. covariance: (p, p) about it, same units.

    cost: half the sum of squares, priors and figures. sigmas: (f,) reading and chance of each
    figure.
    """

    z: FloatArray
    covariance: FloatArray
    cost: float
    prediction: FigurePrediction
    sigmas: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """What a fit has figures be that it was not made from. means, sigmas: (f,), with all that
    the parameters, reading and chance leave open."""

    means: FloatArray
    sigmas: FloatArray


def foreseen(experiment: Experiment, fit: RobotFit) -> Foreseen:
    """By robots drawn from the posterior: figures are anything but linear so far from it."""
    stream = random_stream(0, "identify", "foreseen")
    drawn_z = stream.multivariate_normal(fit.z, fit.covariance, FORESEEN)
    limited = np.clip(drawn_z, -FARTHEST_SIGMAS, FARTHEST_SIGMAS)
    values = np.stack([experiment.predict(z).values for z in limited])
    return Foreseen(values.mean(axis=0), np.hypot(values.std(axis=0), fit.sigmas))


def sigmas_left(fit: RobotFit) -> FloatArray:
    """(p,) standard deviation of each parameter with the figures, over that without them."""
    return np.asarray(np.sqrt(np.diag(fit.covariance)))


def most_likely(
    experiment: Experiment, starts: Sequence[FloatArray], used: BoolArray | None = None
) -> tuple[RobotFit, ...]:
    """The points that starts lead to, best first, each once. used: (f,) which figures count."""
    counted = np.ones(len(experiment.figures), dtype=bool) if used is None else used
    found: list[RobotFit] = []
    for fit in sorted((_fit(experiment, z, counted) for z in starts), key=lambda fit: fit.cost):
        if all(np.abs(fit.z - other.z).max() > SAME_POINT_SIGMAS for other in found):
            found.append(fit)
    return tuple(found)


def first_fits(experiment: Experiment, count: int) -> tuple[RobotFit, ...]:
    """As ``most_likely``, from the middle of the priors and ``count`` - 1 points drawn from them.

    A robot that scrubbing holds straight does not tell in which direction its faults would turn
    it: from there the way downhill leads nowhere. So scrubbing grows little by little from nothing.
    """
    stream, size = random_stream(0, "identify", "starts"), len(experiment.space)
    starts = [np.zeros(size), *stream.standard_normal((count - 1, size))]
    for share in SCRUBBING:
        body = replace(experiment.body, scrub_n_m=share * experiment.body.scrub_n_m)
        fits = most_likely(Experiment(experiment.config, body, experiment.draws), starts)
        starts = [fit.z for fit in fits]
    return fits


def _fit(experiment: Experiment, z: FloatArray, used: BoolArray) -> RobotFit:
    figures = experiment.figures

    def misses(z: FloatArray) -> FloatArray:
        return np.concatenate([z, (_off(figures, experiment.predict(z)) / sigmas)[used]])

    def slopes(z: FloatArray) -> FloatArray:
        return _slopes(misses, z)

    for _ in range(REWEIGHTED):
        sigmas = _sigmas(figures, experiment.predict(z))
        z = np.clip(z, -0.99 * FARTHEST_SIGMAS, 0.99 * FARTHEST_SIGMAS)
        solution = least_squares(
            misses, z, slopes, bounds=(-FARTHEST_SIGMAS, FARTHEST_SIGMAS), xtol=1e-5, ftol=1e-6
        )
        z = solution.x
    slope = slopes(z)
    return RobotFit(
        z=z,
        covariance=np.asarray(np.linalg.inv(slope.T @ slope)),
        cost=float(solution.cost),
        prediction=experiment.predict(z),
        sigmas=sigmas,
    )


def _slopes(function: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    at = function(z)
    columns = [(function(z + STEP * unit) - at) / STEP for unit in np.eye(len(z))]
    return np.stack(columns, axis=1)


def _sigmas(figures: Sequence[FigureConfig], prediction: FigurePrediction) -> FloatArray:
    """(f,) reading and chance."""
    return np.hypot([figure.sigma for figure in figures], prediction.chance)


def _off(figures: Sequence[FigureConfig], prediction: FigurePrediction) -> FloatArray:
    """(f,) how far each figure is off; a bound that is kept is not off at all."""
    off = prediction.values - [figure.value for figure in figures]
    low = np.array([0.0 if figure.bound == "at_most" else -np.inf for figure in figures])
    high = np.array([0.0 if figure.bound == "at_least" else np.inf for figure in figures])
    return np.asarray(np.clip(off, low, high))
