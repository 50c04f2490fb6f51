"""Trends with the time step, and the largest time step that is fine enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

SURE = 0.01
"""A trend is believed if chance would make one as clear in fewer than one of a hundred cases."""
FEWEST = 6
"""Ranks of fewer points than this cannot be so clear."""


@dataclass(frozen=True, slots=True)
class Trend:
    """rank: Spearman's correlation of ranks, -1 to 1. chance: of one as clear by luck."""

    rank: float
    chance: float

    def grows(self) -> bool:
        return self.rank > 0 and self.chance < SURE

    def falls(self) -> bool:
        return self.rank < 0 and self.chance < SURE

    def __str__(self) -> str:
        chance = f"p = {self.chance:.1g}" if self.chance > 1e-6 else "p < 1e-6"
        return f"rank correlation {self.rank:+.2f}, {chance}"


def trend(x: Sequence[float], y: Sequence[float]) -> Trend | None:
    """None for too few points, or for values that are all the same."""
    if len(x) < FEWEST or len(set(x)) == 1 or len(set(y)) == 1:
        return None
    found = spearmanr(x, y)
    return Trend(float(found.statistic), float(found.pvalue))


def largest_below(
    steps_s: Sequence[float], errors: Sequence[float | None], bound: float
) -> float | None:
    """The largest step up to which every error is known and below the bound, or None."""
    best = None
    for at in np.argsort(steps_s, kind="stable"):
        error = errors[at]
        if error is None or error >= bound:
            break
        best = steps_s[at]
    return best
