"""Whitens correlated residuals of neighbouring scans, for correct standard deviations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.stats import t

from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import solving

BLOCK_S = 2.0
"""Errors farther apart than this are taken for independent."""

MOST_SHARED = 0.48
"""Residuals whose errors were all those of shared scans would add up to nothing at all."""


def blocks(steps: LaserSteps) -> Iterator[IntArray]:
    """Pairs of one window and less than BLOCK_S apart, each pair once, in the order of time."""
    order = np.lexsort((steps.first_ns, steps.window))
    since = np.zeros(len(steps), dtype=np.int64)
    windows = steps.window[order]
    begins = np.flatnonzero(np.diff(windows, prepend=windows[:1] - 1))
    for begin, end in zip(begins, [*begins[1:], len(steps)], strict=True):
        stamps = steps.first_ns[order[begin:end]]
        seconds = (stamps[-1] - stamps[0]) * 1e-9
        parts = min(max(round(seconds / BLOCK_S), 1), stamps.size)
        share = (stamps - stamps[0]) / max(float(stamps[-1] - stamps[0]), 1.0)
        since = np.minimum((share * parts).astype(np.int64), parts - 1)
        for part in range(parts):
            yield order[begin:end][since == part]


def shared_scans(first: IntArray, second: IntArray) -> FloatArray:
    """(n, n) 2 on the diagonal; -1 where a pair begins with the scan that another ends with, 1
    where both begin, or both end, with the same one."""
    same_begin = first[:, None] == first[None, :]
    same_end = second[:, None] == second[None, :]
    chained = second[:, None] == first[None, :]
    return np.asarray(same_begin.astype(float) + same_end - chained - chained.T)


def share_of_scans(residual: FloatArray, steps: LaserSteps, parts: list[IntArray]) -> FloatArray:
    """(k,) from 0 to MOST_SHARED: how much of the variance of (n, k) unit residuals is that of
    single scans, counted twice in every pair."""
    products, squares = np.zeros(residual.shape[1]), np.zeros(residual.shape[1])
    for part in parts:
        pattern = shared_scans(steps.first[part], steps.second[part])
        np.fill_diagonal(pattern, 0.0)
        mine = residual[part]
        count = np.abs(pattern).sum()
        if count == 0.0:
            continue
        products += np.einsum("ik,ij,jk->k", mine, pattern, mine)
        squares += np.square(mine).mean(axis=0) * count
    share = np.divide(products, squares, out=np.zeros_like(products), where=squares > 0.0)
    return np.asarray(np.clip(share, 0.0, MOST_SHARED))


def whitened(
    part: IntArray, steps: LaserSteps, share: FloatArray, *columns: FloatArray
) -> list[FloatArray]:
    """Each of (n, k, ...) columns of one block with the errors of shared scans taken out."""
    pattern = shared_scans(steps.first[part], steps.second[part])
    out = [np.empty((part.size, *column.shape[1:])) for column in columns]
    for row, mine in enumerate(share):
        factor = np.linalg.cholesky((1.0 - 2.0 * mine) * np.eye(part.size) + mine * pattern)
        inverted = np.linalg.inv(factor)
        for column, target in zip(columns, out, strict=True):
            target[:, row] = np.tensordot(inverted, column[part, row], axes=1)
    return out


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
    return np.asarray(t.ppf(0.975, np.clip(freedom, 3.0, usual)) / 1.96)
