"""Clock offset during a drive, piece by piece."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slamsim.check.motion.coarse_offset import GRID_S, Rate, convolved, sampled
from slamsim.core.types import FloatArray, IntArray

ALIKE = 0.85
MOST_CANDIDATES = 12
CHANGE_COST_PER_S = 0.25
LEAST_SHARE = 0.3
"""A piece whose turning varies less than this, against that of the whole drive, tells no lag."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalLags:
    """times_s, lags_s: (k,) of the pieces that tell one."""

    times_s: FloatArray
    lags_s: FloatArray

    def line(self) -> tuple[float, float]:
        """Lag at time 0 and its growth per second, by least absolute deviations."""
        weight = np.ones(len(self.times_s))
        design = np.column_stack([np.ones(len(self.times_s)), self.times_s])
        fitted: FloatArray = np.zeros(2)
        for _ in range(20):
            by = design * weight[:, None]
            solved = np.linalg.lstsq(by, self.lags_s * weight, rcond=None)[0]
            fitted = np.asarray(solved, dtype=np.float64)
            weight = 1.0 / np.sqrt(np.maximum(np.abs(self.lags_s - design @ fitted), 1e-3))
        return float(fitted[0]), float(fitted[1])

    def wander_s(self) -> float:
        """How far the lags spread about their line: the middle seven tenths of them.

        A piece in ten that tells a wrong lag, in a hall where all directions look alike, is no
        wandering clock.
        """
        at_zero, growth = self.line()
        left = self.lags_s - at_zero - growth * self.times_s
        return float(np.subtract(*np.quantile(left, [0.85, 0.15])))

    def at(self, times_s: FloatArray) -> FloatArray:
        """(m,) lag of the nearest piece."""
        middle = 0.5 * (self.times_s[:-1] + self.times_s[1:])
        return np.asarray(self.lags_s[np.searchsorted(middle, times_s)])


def local_lags(one: Rate, piece_of: IntArray, other: Rate, sign: float) -> LocalLags | None:
    """The likeliest lag of each piece of the one signal: alike, and not far from the neighbours'.

    piece_of: (n,) number of the piece that each value of ``one`` belongs to, ascending. sign: -1 if
    they turn opposite ways. The best path through all candidates is found by dynamic programming
    (Viterbi 1967). None of fewer than three pieces that tell a lag.
    """
    gain = sign * _rms(one) / max(_rms(other), 1e-12)
    turns = Rate(other.starts_s, other.ends_s, gain * other.values)
    times, candidates = [], []
    for number in np.unique(piece_of):
        mine = piece_of == number
        piece = one.select(mine)
        if np.std(piece.values) < LEAST_SHARE * _rms(one):
            continue
        found = _candidates(piece, turns)
        if len(found):
            times.append(0.5 * float(piece.starts_s[0] + piece.ends_s[-1]))
            candidates.append(found)
    if len(times) < 3:
        return None
    return LocalLags(np.array(times), _best_path(candidates))


def _rms(rate: Rate) -> float:
    seconds = rate.ends_s - rate.starts_s
    return float(np.sqrt((np.square(rate.values) * seconds).sum() / seconds.sum()))


def _candidates(piece: Rate, other: Rate) -> FloatArray:
    """(c, 2) lag of likeliest places, and likeness: 1 less the share of the squares left over."""
    (a, known_a), (b, known_b) = sampled(piece, GRID_S), sampled(other, GRID_S)
    apart = 2.0 * convolved(b, a[::-1]) - convolved(np.square(b), known_a[::-1])
    whole = convolved(known_b, known_a[::-1]) > 0.98 * known_a.sum()
    likeness = np.where(whole, apart / np.square(a).sum(), 0.0)
    lags = (np.arange(likeness.size) - (len(a) - 1)) * GRID_S
    lags = lags + float(other.starts_s[0] - piece.starts_s[0])
    inner = likeness[1:-1]
    peak = np.zeros(likeness.size, dtype=np.bool_)
    peak[1:-1] = (inner >= likeness[:-2]) & (inner >= likeness[2:]) & (inner > ALIKE)
    places = np.flatnonzero(peak)
    best = places[np.argsort(-likeness[places])][:MOST_CANDIDATES]
    return np.column_stack([lags[best], likeness[best]])


def _best_path(candidates: list[FloatArray]) -> FloatArray:
    """(k,) the lag of each piece."""
    cost = 1.0 - candidates[0][:, 1]
    came_from: list[IntArray] = []
    for before, here in pairwise(candidates):
        change = CHANGE_COST_PER_S * np.abs(here[:, None, 0] - before[None, :, 0])
        total = cost[None, :] + change
        came_from.append(total.argmin(axis=1))
        cost = total.min(axis=1) + 1.0 - here[:, 1]
    place = int(cost.argmin())
    path = [place]
    for origin in reversed(came_from):
        place = int(origin[place])
        path.append(place)
    path.reverse()
    return np.array([found[at, 0] for found, at in zip(candidates, path, strict=True)])
