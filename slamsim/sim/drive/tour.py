"""Order of the goals of a tour: a short closed tour (approximate travelling salesman)."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import BadNumbers, require_finite


def closed_tour(lengths: FloatArray) -> IntArray:
    """An order of all places that begins at place 0 and from which the way leads back to it.

    lengths: (k, k) symmetric. Nearest neighbour, then 2-opt and moving single places until
    neither helps (Croes 1958; Or 1976). Deterministic. Raises BadNumbers for what are no lengths.
    """
    require_finite("the lengths of ways", lengths, (len(lengths), len(lengths)))
    if not len(lengths) or not (lengths >= 0.0).all() or not np.allclose(lengths, lengths.T):
        raise BadNumbers("the ways between places are as long as the ways back, and not negative")
    tour = _nearest_neighbour(lengths)
    while True:
        shorter = _relocate(lengths, _two_opt(lengths, tour))
        if tour_length(lengths, shorter) >= tour_length(lengths, tour) - 1e-9:
            return shorter
        tour = shorter


def tour_length(lengths: FloatArray, tour: IntArray) -> float:
    """Of the closed tour (n,), the way back included. lengths: (n, n) between goals."""
    return float(lengths[tour, np.roll(tour, -1)].sum())


def _nearest_neighbour(lengths: FloatArray) -> IntArray:
    tour, left = [0], np.ones(len(lengths), dtype=bool)
    left[0] = False
    while left.any():
        candidates = np.where(left, lengths[tour[-1]], np.inf)
        tour.append(int(candidates.argmin()))
        left[tour[-1]] = False
    return np.array(tour, dtype=np.int64)


def _two_opt(lengths: FloatArray, tour: IntArray) -> IntArray:
    """Turn round pieces of the tour as long as that makes it shorter; place 0 stays first."""
    tour, improved = tour.copy(), True
    while improved:
        improved = False
        for first in range(1, len(tour) - 1):
            ends = np.arange(first + 1, len(tour))
            after = np.append(tour, tour[0])
            a, b = tour[first - 1], tour[first]
            change = (
                lengths[a, after[ends]]
                + lengths[b, after[ends + 1]]
                - lengths[a, b]
                - lengths[after[ends], after[ends + 1]]
            )
            best = int(change.argmin())
            if change[best] < -1e-9:
                last = int(ends[best]) + 1
                tour[first:last] = tour[first:last][::-1].copy()
                improved = True
    return tour


def _relocate(lengths: FloatArray, tour: IntArray) -> IntArray:
    """Move each place once to where it costs least."""
    for place in range(1, len(lengths)):
        at = int(np.flatnonzero(tour == place)[0])
        rest = np.delete(tour, at)
        after = np.roll(rest, -1)
        added = lengths[rest, place] + lengths[place, after] - lengths[rest, after]
        best = int(added.argmin())
        if added[best] < added[at - 1] - 1e-9:
            tour = np.insert(rest, best + 1, place)
    return tour
