"""Closures that came as a surprise wait here until enough others say the same.

Two closures agree if going round the cycle that they and the estimate form leads back to where it
began (pairwise consistency, Mangelson et al. 2018).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.geometry import between, compose
from slamsim.slam.closure import Closure
from slamsim.types import FloatArray

FORGET_AFTER_M = 20.0
TOLERANCE_M = 0.15
TOLERANCE_RAD = 0.05
DRIFT_M_PER_M = 0.03


class WaitingClosures:
    """min_support: closures, each of another key frame, that must agree before they count."""

    def __init__(self, min_support: int) -> None:
        self._min_support = min_support
        self._waiting: list[Closure] = []

    def add(self, closure: Closure, poses: FloatArray) -> Sequence[Closure]:
        """The closures that may count now: none, or the new one with all that agree with it."""
        agreeing = [other for other in self._waiting if agree(closure, other, poses)]
        keyframes = {other.edge.target for other in agreeing} | {closure.edge.target}
        if len(keyframes) < self._min_support:
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


def agree(a: Closure, b: Closure, poses: FloatArray) -> bool:
    """Whether two closures are consistent, given the estimate (n, 3) of all key frames."""
    sources = between(poses[b.edge.source], poses[a.edge.source])
    targets = between(poses[a.edge.target], poses[b.edge.target])
    around = compose(compose(sources, a.edge.T_source_target), targets)
    error = between(b.edge.T_source_target, around)
    walked_m = float(np.hypot(sources[0], sources[1]) + np.hypot(targets[0], targets[1]))
    off_m = float(np.hypot(error[0], error[1]))
    return off_m <= TOLERANCE_M + DRIFT_M_PER_M * walked_m and abs(error[2]) <= TOLERANCE_RAD
