"""Whitens correlated residuals of neighbouring scans, for correct standard deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.quantiles import chi_square
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import solving

BLOCK_S = 2.0
"""Errors farther apart than this are taken for independent."""

MOST_PIECES = 8
BLOCKS_OF_A_PIECE = 3
SCATTERS = 0.01
"""Pieces of a healthy drive scatter as much as noise explains, but for this share of them."""

NO_OTHER = 1e-9
"""Share of the weight that is left where one piece has all of it."""

MOST_SHARED = 0.48
"""Residuals whose errors were all those of shared scans would add up to nothing at all."""


def blocks(steps: LaserSteps) -> Iterator[IntArray]:
    """Pairs of one window and less than BLOCK_S apart, each pair once, in the order of time.

    Each (k,) numbers of steps.
    """
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
        for part in np.unique(since):  # where scans are missing, parts are empty
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


def whitening(part: IntArray, steps: LaserSteps, share: FloatArray) -> FloatArray:
    """(k, n, n) for each of k columns what takes the errors of shared scans out of one block."""
    pattern = shared_scans(steps.first[part], steps.second[part])
    covariances = [(1.0 - 2.0 * mine) * np.eye(part.size) + mine * pattern for mine in share]
    return np.linalg.inv(np.linalg.cholesky(np.array(covariances)))


def whitened(by: FloatArray, column: FloatArray) -> FloatArray:
    """(n, k, ...) of one block, by its ``whitening`` (k, n, n)."""
    return np.asarray(np.einsum("kij,jk...->ik...", by, column))


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """An estimate by each of k pieces of the drive alone.

    middle_s: (k,) when. moved: (k, p) the estimate of the piece less that of all. covariance:
    (k, p, p) by noise.
    """

    middle_s: FloatArray
    moved: FloatArray
    covariance: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """(k, p)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def each_alone(self, changes: FloatArray) -> Pieces:
        """What each piece tells of every unknown if the others change by no more than this.

        changes: (p,) standard deviations of what the others may change by from piece to piece, inf
        where nothing is known. Short pieces tell some only together: a bias and a gain of a
        gyroscope while the robot turns at one rate. The covariances are diagonal.
        """
        information = np.linalg.inv(self.covariance)
        gradient = np.einsum("kij,kj->ki", information, self.moved)
        moved, variances = np.empty_like(self.moved), np.empty_like(self.moved)
        for place in range(len(changes)):
            others = 1.0 / np.square(changes)
            others[place] = 0.0
            inverse = np.linalg.inv(information + np.diag(others))
            moved[:, place] = np.einsum("kj,kj->k", inverse[:, place], gradient)
            variances[:, place] = inverse[:, place, place]
        return Pieces(self.middle_s, moved, variances[:, :, None] * np.eye(len(changes)))

    def widened(
        self, covariance: FloatArray, slopes: tuple[tuple[int, int], ...] = ()
    ) -> FloatArray:
        """(p, p) the covariance of the whole estimate, wider where pieces scatter by more than
        their noise: errors then last longer than a block. By how much follows from what each piece
        moves the whole by (White 1980; HC2 of MacKinnon & White 1985), not from how far off it is
        itself: one without turns knows a gain of turns by the noise of the wheels alone.

        slopes: places of a value and of its growth per second, which pieces do not tell: what a
        value wanders by makes its growth as unsure as that of a line through the pieces.
        """
        weights = 1.0 / np.square(self.sigmas)
        share = weights / weights.sum(axis=0)
        apart = self.moved - (share * self.moved).sum(axis=0)
        squares = np.square(share * apart) / np.maximum(1.0 - share, NO_OTHER)
        expected = chi_square(1.0 - SCATTERS, len(self.moved) - 1)
        squares *= (weights * np.square(apart)).sum(axis=0) > expected
        least = squares.sum(axis=0)
        for value, growth in slopes:
            mine = share[:, value]
            since_s = np.square(self.middle_s - mine @ self.middle_s)
            least[growth] = squares[:, value] @ since_s / np.square(mine @ since_s)
        stretch = np.sqrt(np.maximum(least / np.diag(covariance), 1.0))
        return np.asarray(np.outer(stretch, stretch) * covariance)


def pieces_of(
    middle_s: FloatArray,
    gained: FloatArray,
    gradients: FloatArray,
    prior: FloatArray,
    variance_factor: float,
) -> Pieces | None:
    """Blocks (b,) of a fit, in the order of time, as pieces of several blocks each.

    gained: (b, p, p) information and gradients: (b, p) of each block at the optimum, prior:
    (p, p); each piece is one Gauss-Newton step away. None of too few blocks for two pieces.
    """
    count = min(len(middle_s) // BLOCKS_OF_A_PIECE, MOST_PIECES)
    if count < 2:
        return None
    members = np.array_split(np.argsort(middle_s, kind="stable"), count)
    information = np.array([gained[one].sum(axis=0) for one in members]) + prior
    gradient = np.array([gradients[one].sum(axis=0) for one in members])
    with solving("an estimate by a piece of the drive"):
        inverse = np.linalg.inv(information)
    return Pieces(
        np.array([float(middle_s[one].mean()) for one in members]),
        -np.einsum("kij,kj->ki", inverse, gradient),
        np.asarray(variance_factor * inverse),
    )
