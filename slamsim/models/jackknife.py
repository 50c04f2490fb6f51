"""How unsure an estimate is, from what each block of the data does to it when left out."""

from __future__ import annotations

import numpy as np

from slamsim.core.quantiles import student_t
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import solving


def jackknife(
    information: FloatArray, gained: FloatArray, gradients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(p, p) covariance of an estimate, and (b, p) what each block does to it when left out.

    information: (p, p) of all. gained: (b, p, p) of each block, gradients: (b, p) its gradient at
    the optimum. The delete-one jackknife in one linear step (MacKinnon & White 1985).
    """
    count = len(gradients)
    with solving("an estimate without one of its blocks"):
        moved = np.linalg.solve(information[None] - gained, gradients[..., None])[..., 0]
    moved = moved - moved.mean(axis=0)
    return np.asarray((count - 1.0) / count * moved.T @ moved), moved


def wider(moved: FloatArray) -> FloatArray:
    """(p,) by how much an interval of 1.96 sigmas is too short for sigmas from (b, p) few blocks.

    Student's t, with the degrees of freedom that the spread of the blocks leaves: a few turns may
    decide everything (Satterthwaite 1946).
    """
    squares = np.square(moved)
    fourth = np.square(squares).sum(axis=0)
    spread = np.square(squares.sum(axis=0))
    usual = np.full(moved.shape[1], len(moved) - 1.0)
    freedom = np.divide(3.0 * spread, fourth, out=usual.copy(), where=fourth > 0.0)
    return np.asarray(student_t(0.975, np.clip(freedom, 3.0, usual)) / 1.96)
