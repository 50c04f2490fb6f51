"""Stamps rounded to a coarse step: a slow clock, few decimals, a float."""

from __future__ import annotations

import math

import numpy as np

from slamsim.core.types import FloatArray

_TOLERANCE_S = 2e-6
_SHARE = 0.99
_MIN_STEPS = 3
_UNEVEN_SHARE = 0.01
_VARYING_SHARE = 0.05
_REPEATED_SHARE = 0.05
_TOGETHER = 8
_RANDOM_SPREAD, _RANDOM_DRAWS = 2.0, 10
"""Sums over so many steps that they would scatter by so much, in steps of the grid, were messages
lost at random: ten of these lie within two of each other in one of thousands of streams."""
_STAYS_SHARE = 1.0 / 3.0
"""Scatter about an edge leaves half of the stays longer than one message; of messages repeated at
random, one in twenty, as many stay longer."""
_STEPS_S = sorted(
    {
        *(2.0**power for power in range(-9, 8)),
        *(digit * 10.0**power for digit in (1.0, 2.0, 2.5, 5.0) for power in (-3, -2, -1, 0)),
        *(1.0 / rate for rate in (24.0, 25.0, 30.0, 60.0, 120.0, 240.0)),
    },
    reverse=True,
)
"""Powers of two, which are also what a float leaves of large numbers; decimals; frame rates."""


def rounding_step_s(steps_s: FloatArray) -> float:
    """The step to which stamps are rounded, from the steps between them; 0 if none shows.

    It shows where all are multiples of it, and that not because the messages come evenly: an even
    stream on a grid is no worse for it. steps_s: (n,).
    """
    moving = steps_s != 0.0
    if moving.sum() < _MIN_STEPS:
        return 0.0
    for step_s in _STEPS_S:
        counts = np.rint(steps_s / step_s)
        on_grid = np.abs(steps_s - counts * step_s) < _TOLERANCE_S
        if on_grid[moving].mean() >= _SHARE:
            return step_s if _is_rounded(counts[on_grid], step_s) else 0.0
    return 0.0


def in_equal_groups(steps_s: FloatArray) -> bool:
    """Whether messages share stamps two by two, or three by three, and so on, without exception.

    Then rounding and repeating look the same. steps_s: (n,) between messages.
    """
    begins = np.flatnonzero(steps_s != 0.0)
    sizes = np.diff(begins)
    return bool(sizes.size >= _MIN_STEPS and sizes[0] > 1 and (sizes == sizes[0]).all())


def _is_rounded(counts: FloatArray, step_s: float) -> bool:
    """counts: (m,) steps of the grid from each stamp to the next.

    Not rounded are an even stream, one that lost messages, and one in which some messages carry
    the stamp of the one before.
    """
    if in_equal_groups(counts):
        return any(
            abs(power - round(power)) < 1e-9 for power in (np.log2(step_s), np.log10(step_s))
        )
    values, times = np.unique(counts[counts != 0.0], return_counts=True)
    usual = values[np.argmax(times)]
    if _is_at_an_edge(counts - usual):
        return True
    none = float((counts == 0.0).mean())
    if none > _REPEATED_SHARE:  # behind a stamp that is repeated lies a step that is too long
        return bool((counts > 1.0).mean() < 0.2 * none)
    if (np.mod(counts, usual) != 0.0).mean() > _UNEVEN_SHARE:
        return True
    return _comes_regularly(counts, float(usual))


def _is_at_an_edge(off: FloatArray) -> bool:
    """Whether stamps as even as the grid scatter across one edge of it. off: (m,) of each step of
    theirs from the usual one, in steps of the grid.

    Too long and too short ones then take turns. From an edge they stay away for a while to either
    side; where single messages are repeated, or held up, one follows the other at once.
    """
    gone = np.concatenate([[0.0], np.cumsum(off)])
    lasts = np.diff(np.flatnonzero(off))
    if np.ptp(gone) > 1.0 or lasts.size < 2 * _RANDOM_DRAWS:
        return False
    return all((lasts[side::2] > 1).mean() > _STAYS_SHARE for side in (0, 1))


def _comes_regularly(counts: FloatArray, usual: float) -> bool:
    """Whether the longer steps are spread as evenly as rounding spreads them.

    An even stream that is rounded has as many steps of the grid in any eight of its own, give
    or take one, and its rarer steps come at a period, give or take one. Where the stamps scattered
    before they were rounded it may be two, but no more over however many. What is lost is lost at
    random.
    """
    others = counts != usual
    share = float(others.mean())
    if share > _VARYING_SHARE:
        many = math.ceil((_RANDOM_SPREAD**2) / (share * (1.0 - share)))
        beside = np.abs(counts - counts.mean()) < 1.0  # multiples on either side of the period
        regular = (~beside).mean() <= _UNEVEN_SHARE and counts.size >= _RANDOM_DRAWS * many
        if _varies_by(counts, _TOGETHER) <= 1.0 or (regular and _varies_by(counts, many) <= 2.0):
            return True
    apart = np.diff(np.flatnonzero(others))
    return bool(apart.size >= _TOGETHER and np.ptp(apart) <= 1)


def _varies_by(counts: FloatArray, together: int) -> float:
    """How far apart sums of so many neighbours are, but for the farthest."""
    sums = np.convolve(counts, np.ones(together), "valid")
    low, high = np.quantile(sums, [0.01, 0.99]) if sums.size else (0.0, np.inf)
    return float(high - low)
