"""Which scans to look at: short windows all over a recording, where most happens."""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise

import numpy as np

from slamsim.core.types import FloatArray, IntArray

WINDOW_SCANS = 32
MAX_WINDOWS = 40
LEAST_STEP_S = 0.06
"""Scans that follow each other faster are thinned out: a window shall see some motion."""

DEFAULT_PERIOD_S = 0.1
"""Of most lidars on robots (10 Hz), where stamps tell of none."""

LEAST_IN_ORDER = 0.8
"""With fewer scans stamped in order it is unknown which stamps are the wrong ones."""


def period_s(stamps_ns: IntArray) -> float:
    """The usual time from scan to scan, whatever single stamps say. stamps_ns: (n,)."""
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    usual = float(np.median(steps)) * 1e-9 if steps.size else DEFAULT_PERIOD_S
    return usual if 1e-3 < usual < 10.0 else DEFAULT_PERIOD_S


def choose_windows(stamps_ns: IntArray, activity: FloatArray | None) -> list[IntArray]:
    """Indices of the scans of each window, in the order of the file.

    The recording is cut into equal stretches; each gives the window with most activity (n,),
    the middle one if it is unknown. Scans are thinned evenly within a window; single ones that are
    stamped out of order are left out.
    """
    usable = surely_ascending(stamps_ns)
    if usable.size < LEAST_IN_ORDER * stamps_ns.size:
        usable = np.arange(stamps_ns.size)
    active = None if activity is None else activity[usable]
    count = int(usable.size)
    stride = max(1, round(LEAST_STEP_S / period_s(stamps_ns)))
    length = min(WINDOW_SCANS * stride, count)
    if count < 2:
        return []
    stretches = min(max(1, count // length), MAX_WINDOWS)
    borders = np.linspace(0, count, stretches + 1).astype(int)
    starts = [_liveliest(first, last, length, active) for first, last in pairwise(borders.tolist())]
    return [usable[start : start + length : stride] for start in starts]


def surely_ascending(stamps_ns: IntArray) -> IntArray:
    """Indices of the stamps that stay when as few as possible are taken out to put (n,) in order,
    whichever of two that contradict each other is taken."""
    earliest = longest_ascending(stamps_ns)
    latest = stamps_ns.size - 1 - longest_ascending(-stamps_ns[::-1])
    return np.intersect1d(earliest, latest)


def longest_ascending(stamps_ns: IntArray) -> IntArray:
    """Indices of the most stamps of (n,) of which none is before the one above.

    Fredman (1975): On computing the length of longest increasing subsequences.
    """
    lowest: list[int] = []
    ends: list[int] = []
    before = np.full(stamps_ns.size, -1, dtype=np.int64)
    for index, stamp in enumerate(stamps_ns.tolist()):
        length = bisect_right(lowest, stamp)
        before[index] = ends[length - 1] if length else -1
        lowest[length : length + 1] = [stamp]
        ends[length : length + 1] = [index]
    chain = ends[-1:]
    while chain and before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1], dtype=np.int64)


def _liveliest(first: int, last: int, length: int, activity: FloatArray | None) -> int:
    latest = max(last - length, first)
    if activity is None or latest == first:
        return (first + latest) // 2
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(activity))])
    starts = np.unique(np.linspace(first, latest, 24).astype(int))
    return int(starts[np.argmax(total[starts + length] - total[starts])])
