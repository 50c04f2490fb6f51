"""Numbers in the rows of trials, their trends with the time step, and the largest step that is fine
enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.scenarios.base import Outcome, Row


def number(row: Row, key: str) -> float:
    """A number of a row that has it."""
    return float(cast(float, row[key]))


def column(outcomes: Sequence[Outcome], key: str) -> FloatArray:
    """(n,) the same number of every row; nan where a row has none."""
    values = (one.values.get(key) for one in outcomes)
    return np.array([np.nan if value is None else cast(float, value) for value in values])


def having(outcomes: Sequence[Outcome], **wanted: object) -> list[Outcome]:
    """Those whose rows say exactly this."""
    return [
        one
        for one in outcomes
        if all(one.values.get(key) == value for key, value in wanted.items())
    ]


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
    from scipy.stats import spearmanr  # not at the top: it takes 0.7 s

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
