"""Which scans to look at: short windows all over a recording, where most happens."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from slamsim.types import FloatArray, IntArray

WINDOW_SCANS = 32
MAX_WINDOWS = 40
LEAST_STEP_S = 0.06
"""Scans that follow each other faster are thinned out: a window shall see some motion."""

DEFAULT_PERIOD_S = 0.1


def period_s(stamps_ns: IntArray) -> float:
    """The usual time from scan to scan, whatever single stamps say."""
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    usual = float(np.median(steps)) * 1e-9 if steps.size else DEFAULT_PERIOD_S
    return usual if 1e-3 < usual < 10.0 else DEFAULT_PERIOD_S


def choose_windows(stamps_ns: IntArray, activity: FloatArray | None) -> list[IntArray]:
    """Indices of the scans of each window, in the order of the file.

    The recording is cut into equal stretches; each gives the window with most activity (n,),
    the middle one if nobody knows. Scans are thinned evenly within a window.
    """
    count = int(stamps_ns.size)
    stride = max(1, round(LEAST_STEP_S / period_s(stamps_ns)))
    length = min(WINDOW_SCANS * stride, count)
    if count < 2:
        return []
    stretches = min(max(1, count // length), MAX_WINDOWS)
    borders = np.linspace(0, count, stretches + 1).astype(int)
    starts = [
        _liveliest(first, last, length, activity) for first, last in pairwise(borders.tolist())
    ]
    return [np.arange(start, start + length, stride, dtype=np.int64) for start in starts]


def _liveliest(first: int, last: int, length: int, activity: FloatArray | None) -> int:
    latest = max(last - length, first)
    if activity is None or latest == first:
        return (first + latest) // 2
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(activity))])
    starts = np.unique(np.linspace(first, latest, 24).astype(int))
    return int(starts[np.argmax(total[starts + length] - total[starts])])
