"""Stamps rounded to a coarse step: a slow clock, few decimals, a float."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray

_TOLERANCE_S = 2e-6
_SHARE = 0.99
_MIN_STEPS = 3
_UNEVEN_SHARE = 0.01
_VARYING_SHARE = 0.05
_REPEATED_SHARE = 0.05
_TOGETHER = 8
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
    none = float((counts == 0.0).mean())
    if none > _REPEATED_SHARE:  # behind a stamp that is repeated lies a step that is too long
        return bool((counts > 1.0).mean() < 0.2 * none)
    values, times = np.unique(counts[counts != 0.0], return_counts=True)
    usual = values[np.argmax(times)]
    if (np.mod(counts, usual) != 0.0).mean() > _UNEVEN_SHARE:
        return True
    return _comes_regularly(counts, float(usual))


def _comes_regularly(counts: FloatArray, usual: float) -> bool:
    """Whether the longer steps are spread as evenly as rounding spreads them.

    An even stream that is rounded has as many steps of the grid in any eight of its own, give
    or take one, and its rarer steps come at a period, give or take one. What is lost is lost at
    random.
    """
    together = np.convolve(counts, np.ones(_TOGETHER), "valid")
    low, high = np.quantile(together, [0.01, 0.99]) if together.size else (0.0, np.inf)
    if (counts != usual).mean() > _VARYING_SHARE and high - low <= 1.0:
        return True
    apart = np.diff(np.flatnonzero(counts != usual))
    return bool(apart.size >= _TOGETHER and np.ptp(apart) <= 1)
