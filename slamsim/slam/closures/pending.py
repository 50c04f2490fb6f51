"""Closures that came as a surprise wait here until enough others say the same.

Two closures agree if going round the cycle that they and the estimate form leads back to where it
began (pairwise consistency, Mangelson et al. 2018).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray
from slamsim.slam.closures.closure import Closure

FORGET_AFTER_M = 20.0
TOLERANCE_M = 0.15
TOLERANCE_RAD = 0.05
DRIFT_M_PER_M = 0.03
"""A cycle of two closures may be open by the error of two matches between submaps, and by what
odometry drifts on the path between both: 3 %, as of wheels that were never calibrated. Closures
that found no other on FORGET_AFTER_M of path are given up."""


class WaitingClosures:
    """Keeps surprising closures until ``min_support`` independent ones agree.

    apart_m: key frames on less path than this share scans; their closures are one witness. Three
    closures of one metre of a corridor say no more than one: where walls repeat themselves, all
    of them are wrong by the same step.
    """

    def __init__(self, min_support: int, apart_m: float) -> None:
        self._min_support, self._apart_m = min_support, apart_m
        self._waiting: list[Closure] = []

    def add(self, closure: Closure, poses: FloatArray) -> Sequence[Closure]:
        """The closures that may count now: none, or the new one with all that agree with it.

        poses: (n, 3) of all key frames.
        """
        agreeing = [other for other in self._waiting if agree(closure, other, poses)]
        seen = [(one.path_m, one.witnesses) for one in (*agreeing, closure)]
        if witnesses(seen, self._apart_m) < self._min_support:
            self._waiting.append(closure)
            return ()
        self._waiting = [other for other in self._waiting if other not in agreeing]
        return (*agreeing, closure)

    def forget(self, path_m: float) -> int:
        """Drop those that have waited for too long; how many."""
        kept = [c for c in self._waiting if path_m - c.path_m <= FORGET_AFTER_M]
        dropped = len(self._waiting) - len(kept)
        self._waiting = kept
        return dropped


def witnesses(closures: Iterable[tuple[float, int]], apart_m: float) -> int:
    """Those of closures (path to the key frame in m, own witnesses) whose key frames are far
    enough from one another on the path."""
    count, last_m = 0, -np.inf
    for path_m, own in sorted(closures, key=lambda one: (one[0], -one[1])):
        if path_m - last_m >= apart_m:
            count, last_m = count + own, path_m
    return count


def agree(a: Closure, b: Closure, poses: FloatArray) -> bool:
    """Whether two closures are consistent, given the estimate (n, 3) of all key frames."""
    sources = between(poses[b.edge.source], poses[a.edge.source])
    targets = between(poses[a.edge.target], poses[b.edge.target])
    around = compose(compose(sources, a.edge.T_source_target), targets)
    error = between(b.edge.T_source_target, around)
    walked_m = float(np.hypot(sources[0], sources[1]) + np.hypot(targets[0], targets[1]))
    off_m = float(np.hypot(error[0], error[1]))
    return off_m <= TOLERANCE_M + DRIFT_M_PER_M * walked_m and abs(error[2]) <= TOLERANCE_RAD
