"""Beams that always see the same while most see changes: the robot's own body."""

from __future__ import annotations

import numpy as np

from slamsim.core.components import runs_of
from slamsim.core.types import BoolArray, FloatArray

MIN_TYPICAL_SPREAD_M = 0.3
"""Below this the robot saw so little change that a constant beam means nothing."""
MAX_CONSTANT_SPREAD_M = 0.04
"""Between the 2 % and 98 % quantiles: four standard deviations of a common lidar's noise."""
SHARP_FACTOR = 10.0
"""Beside the robot's own body the spread jumps; along a corridor it grows gently."""
BESIDE = 3
_OFTEN = 0.9
"""A beam that meets the body of the robot itself nearly always returns."""


def beams_on_robot(ranges_m: FloatArray) -> BoolArray:
    """(beams,) those of (k, beams) readings, not finite where nothing returned, that always see
    the same while most see changes."""
    readings = np.where(np.isfinite(ranges_m) & (ranges_m > 0.0), ranges_m, np.nan)
    spread_m = spread_of(readings)
    known = spread_m[np.isfinite(spread_m)]
    on_robot = np.zeros(spread_m.size, dtype=np.bool_)
    if known.size and float(np.median(known)) >= MIN_TYPICAL_SPREAD_M:
        for first, last in still_runs(spread_m, np.isfinite(readings).mean(axis=0)):
            on_robot[first : last + 1] = True
    return on_robot


def still_runs(spread_m: FloatArray, share: FloatArray) -> list[tuple[int, int]]:
    """(first, last) of each stretch of beams that change little: spread_m, share: (beams,)."""
    still = (share > _OFTEN) & (spread_m < MAX_CONSTANT_SPREAD_M)
    return [run for run in runs_of(still) if _is_sharp(spread_m, *run)]


def spread_of(ranges_m: FloatArray) -> FloatArray:
    """(beams,) from the 2 % to the 98 % quantile of each beam's readings, nan without any."""
    ordered = np.sort(ranges_m, axis=0)
    count = np.isfinite(ordered).sum(axis=0)
    beams = np.arange(ordered.shape[1])
    low, high = (ordered[np.floor(q * np.maximum(count - 1, 0)).astype(int), beams]
                 for q in (0.02, 0.98))  # fmt: skip
    return np.asarray(high - low, dtype=np.float64)


def _is_sharp(spread_m: FloatArray, first: int, last: int) -> bool:
    """Whether the beams just beside the stretch change much more, or there are none."""
    inside = float(np.median(spread_m[first : last + 1]))
    beside = [spread_m[max(first - BESIDE, 0) : first], spread_m[last + 1 : last + 1 + BESIDE]]
    return all(
        side.size == 0 or not np.isfinite(side).any() or np.nanmax(side) > SHARP_FACTOR * inside
        for side in beside
    )
