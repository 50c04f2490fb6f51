"""Detects and unwraps wheel counters that overflow."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import IntArray

LEAST_BITS = 8
SMALL_STEP = 4
"""Steps of a counter are, wraps apart, this many times smaller than its range."""


def counter_range(counts: IntArray) -> int | None:
    """How many different values a wrapping counter (n,) has: a power of two; None of any other.

    A counter that wraps uses nearly all of its range, and steps over nearly all of it at once.
    """
    if counts.size < 3:
        return None
    steps = np.diff(counts)
    extent = int(counts.max()) - int(counts.min())
    whole = 1 << max(extent.bit_length(), LEAST_BITS)
    if np.abs(steps).max() <= whole // 2:
        return None
    return whole if np.abs(_short_way(steps, whole)).max() < whole // SMALL_STEP else None


def unwrapped(counts: IntArray) -> IntArray:
    """(n,) the same counter with more digits, if it wraps; else as it is."""
    whole = counter_range(counts)
    if whole is None:
        return counts
    steps = _short_way(np.diff(counts), whole)
    return np.asarray(counts[0] + np.concatenate([[0], np.cumsum(steps)]))


def _short_way(steps: IntArray, whole: int) -> IntArray:
    half = whole // 2
    return np.asarray((steps + half) % whole - half)
