"""Robust least squares over blocks of data, with standard deviations by a jackknife over these.

Levenberg and Marquardt's steps; outliers count by Cauchy's weight. What no data tell stays where
it began, by a weak prior, and is as unsure as that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.numbers import solving
from slamsim.models.jackknife import jackknife, wider

MOST_STEPS = 40
SETTLED = 1e-5
"""Steps end where one is expected to lower the cost, in squared sigmas, by less."""
FIRST_DAMPING, MOST_DAMPING = 1e-6, 1e8
DOUBT_SQUARED = 4.0
"""Cauchy's weight is a half where the mean square of an observation's residuals is so much."""
FEWEST_BLOCKS = 6
"""Of fewer, a jackknife tells nothing (Student's t of four degrees of freedom)."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of each block: gained (b, p, p), gradients (b, p); cost of all of them.

    prior_sigmas: (p,) standard deviations of values about where they began; away: (p,) how far
    they are from there.
    """

    gained: FloatArray
    gradients: FloatArray
    data_cost: float
    prior_sigmas: FloatArray
    away: FloatArray

    @property
    def prior(self) -> FloatArray:
        """(p, p) information."""
        return np.diag(1.0 / np.square(self.prior_sigmas))

    @property
    def information(self) -> FloatArray:
        """(p, p) of all blocks and the prior."""
        return np.asarray(self.gained.sum(axis=0) + self.prior)

    @property
    def gradient(self) -> FloatArray:
        """(p,) of half the cost."""
        return np.asarray(self.gradients.sum(axis=0) + self.prior @ self.away)

    @property
    def cost(self) -> float:
        """Squared sigmas by which data and prior are missed."""
        return self.data_cost + float(self.away @ self.prior @ self.away)

    @property
    def covariance(self) -> FloatArray:
        """(p, p), whatever the noise is like, wide enough for intervals of 1.96 sigmas.

        Raises NoSolution where a block alone holds what the others do not.
        """
        by_blocks, moved = jackknife(self.information, self.gained, self.gradients)
        stretch = wider(moved)
        inverse = np.linalg.inv(self.information)
        by_prior = inverse @ self.prior @ inverse
        return np.asarray(np.outer(stretch, stretch) * by_blocks + by_prior)


@dataclass(frozen=True, slots=True, eq=False)
class GroupedSlopes:
    """Of n observations' residuals, each by values of all and by those of its group alone; the
    zeros by those of other groups would take a gigabyte for 1e5 sightings of 30 tags.

    shared: (n, k, q). own: (n, k, r). group: (n,) below groups. Values of all come first.
    """

    shared: FloatArray
    own: FloatArray
    group: IntArray
    groups: int

    def times(self, roots: FloatArray) -> GroupedSlopes:
        """Of residuals multiplied by roots (n, k, k)."""
        return replace(self, shared=roots @ self.shared, own=roots @ self.own)

    def of(self, those: BoolArray) -> FloatArray:
        """(m, k, q + r groups) of those m that are chosen (n,), with the zeros."""
        shared, own = self.shared[those], self.own[those]
        first, each = shared.shape[2], own.shape[2]
        slopes = np.zeros((*shared.shape[:2], first + each * self.groups))
        slopes[:, :, :first] = shared
        places = first + each * self.group[those, None] + np.arange(each)
        np.put_along_axis(slopes, places[:, None, :], own, axis=2)
        return slopes


class Problem(Protocol):
    """Values, and the equations of the data about them."""

    def equations(self) -> Equations:
        """About the current values."""
        ...

    def moved(self, step: FloatArray) -> Self:
        """The same after a step (p,)."""
        ...


AnyProblem = TypeVar("AnyProblem", bound=Problem)


def solve(problem: AnyProblem) -> tuple[AnyProblem, Equations]:
    """The problem at the nearest minimum, and its equations there. Raises NoSolution."""
    now, damping = problem.equations(), FIRST_DAMPING
    for _ in range(MOST_STEPS):
        information, gradient = now.information, now.gradient
        damped = information + damping * np.diag(np.diag(information))
        with solving("a calibration"):
            step = np.asarray(-np.linalg.solve(damped, gradient), dtype=np.float64)
        moved = problem.moved(step)
        then = moved.equations()
        if then.cost <= now.cost:
            problem, now, damping = moved, then, 0.1 * damping
            if -step @ gradient < SETTLED:
                break
        else:
            damping = max(1e3 * FIRST_DAMPING, 10.0 * damping)
            if damping > MOST_DAMPING:
                break
    return problem, now


def weigh(residuals: FloatArray, scale: float = 1.0) -> tuple[FloatArray, float]:
    """(n,) Cauchy's weights of (n, k) residuals in sigmas, and the cost of all.

    scale: by how much larger the residuals may be, while values are still far off.
    """
    doubt = DOUBT_SQUARED * residuals.shape[1] * scale
    squares = np.square(residuals).sum(axis=1)
    return 1.0 / (1.0 + squares / doubt), float(doubt * np.log1p(squares / doubt).sum())


def by_blocks(
    residuals: FloatArray, slopes_of: Callable[[BoolArray], FloatArray], block: IntArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """(count, p, p) and (count, p): the sums over (n, k) residuals.

    slopes_of: gives (m, k, p) of those m that are chosen (n,), so that no more than those of a
    block are in memory. block: (n,) below count.
    """
    size = slopes_of(np.zeros(len(block), np.bool_)).shape[2]
    gained, gradients = np.zeros((count, size, size)), np.zeros((count, size))
    for number in np.unique(block):
        those = block == number
        mine = slopes_of(those).reshape(-1, size)
        gained[number] = mine.T @ mine
        gradients[number] = mine.T @ residuals[those].ravel()
    return gained, gradients
