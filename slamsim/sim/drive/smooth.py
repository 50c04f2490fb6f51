"""Smooths a chain of cells into a path that a robot can drive."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers, require_finite, require_number, require_size
from slamsim.sim.drive.legs import SPACING_M
from slamsim.sim.drive.space import Space

MOST_POINTS = 1e8
SMOOTHING_M = 0.25
"""Standard deviation of the smoothing kernel along the path; bends get about this radius."""


def resample(points_m: FloatArray, spacing_m: float = SPACING_M) -> FloatArray:
    """(m, 2) points evenly spaced along a line (n, 2); the ends stay. Raises BadNumbers."""
    require_finite("a line to drive", points_m, (None, 2))
    require_size("the spacing of a line in m", spacing_m)
    if not len(points_m):
        raise BadNumbers("a line to drive has at least one point")
    steps_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    keep = np.append(True, steps_m > 1e-9)
    points_m, along_m = points_m[keep], np.cumsum(np.append(0.0, steps_m[keep[1:]]))
    require_number("the points of a line", float(along_m[-1]) / spacing_m, 0.0, MOST_POINTS)
    count = max(round(along_m[-1] / spacing_m), 1) + 1
    at_m = np.linspace(0.0, along_m[-1], count)
    return np.column_stack([np.interp(at_m, along_m, axis) for axis in points_m.T])


def smooth_path(points_m: FloatArray, space: Space) -> FloatArray:
    """The line (n, 2) with its corners rounded, its ends kept, nowhere too close to a wall.

    Where the smoothed line would come too close it is drawn back towards the given one.
    """
    line = resample(points_m)
    smoothed = _blur(line, SMOOTHING_M / SPACING_M)
    # The given line runs through cell centres; between them it may have a trifle less room.
    needed_m = np.minimum(space.needed_m, space.room_at_m(line) - 1e-9)
    share = np.ones(len(line))
    for _ in range(12):
        mixed = share[:, None] * smoothed + (1.0 - share[:, None]) * line
        short = space.room_at_m(mixed) < needed_m
        if not short.any():
            return resample(mixed)
        near = ndimage.gaussian_filter1d(short.astype(np.float64), 0.1 / SPACING_M)
        share *= 1.0 - np.clip(np.maximum(short, 2.0 * near), 0.0, 1.0) * 0.5
    return resample(np.where(short[:, None], line, mixed))


def _blur(line: FloatArray, sigma: float) -> FloatArray:
    """Gaussian along the line; mirrored through its ends, so that these stay."""
    pad = min(int(4 * sigma) + 1, len(line) - 1)
    before = 2.0 * line[0] - line[pad:0:-1]
    after = 2.0 * line[-1] - line[-2 : -pad - 2 : -1]
    padded = np.concatenate([before, line, after])
    blurred = ndimage.gaussian_filter1d(padded, sigma, axis=0, mode="nearest")
    return np.asarray(blurred[pad : pad + len(line)])
