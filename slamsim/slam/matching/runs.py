"""Where one straight surface ends along the beams of a scan and the next begins."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray
from slamsim.models.line_bundle import principal_axis

SPACING_FACTOR = 6.0
"""Neighbouring beams this many times further apart than square on a wall are not one surface."""

MAX_SPACING_M = 1.0
MAX_BEAM_STEP_RAD = 0.2
LEAST_INCIDENCE = 0.2
"""A range error moves a point across the surface by this share at least: spots are no points."""

BEND_SIGMAS = 4.0
BREAK_CHI2 = 20.0
"""Two lines must explain a run better by this much than one: chance alone rarely comes near."""


@kernel
def joined(points: FloatArray, origins: FloatArray, i: int, sizes: tuple[float, float]) -> bool:
    """Whether the returns i and i + 1 are of one surface. points, origins: (n, 2)."""
    noise, reach = sizes
    ax, ay = points[i, 0] - origins[i, 0], points[i, 1] - origins[i, 1]
    bx, by = points[i + 1, 0] - origins[i + 1, 0], points[i + 1, 1] - origins[i + 1, 1]
    near = min(np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by))
    if near > reach:
        return False
    step = np.abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))
    spacing = np.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
    allowed = SPACING_FACTOR * (near * step + noise)
    return bool(step < MAX_BEAM_STEP_RAD and spacing < min(allowed, MAX_SPACING_M))


@kernel
def parted(points: FloatArray, origins: FloatArray, first: int, last: int, noise: float) -> int:
    """The last point of the first of two surfaces among points first..last; -1 if they are one.

    A corner is found first as the point furthest from the chord (Douglas & Peucker 1973), then to
    the beam by least squares: a few points of another wall would tilt the piece that they are in.
    points, origins: (n, 2).
    """
    worst, off = _bend(points, first, last)
    if off > BEND_SIGMAS * noise:
        return worst
    middle, gain = _break(points, origins, first, last, noise)
    return middle if gain > BREAK_CHI2 else -1


@kernel
def _bend(points: FloatArray, first: int, last: int) -> tuple[int, float]:
    """The point furthest from the chord between two, and how far."""
    x0, y0 = points[first, 0], points[first, 1]
    dx, dy = points[last, 0] - x0, points[last, 1] - y0
    length = np.hypot(dx, dy)
    worst, worst_m = first, 0.0
    for i in range(first + 1, last):
        px, py = points[i, 0] - x0, points[i, 1] - y0
        off = np.abs(dx * py - dy * px) / length if length > 1e-9 else np.hypot(px, py)
        if off > worst_m:
            worst, worst_m = i, off
    return worst, worst_m


@kernel
def _least(count: float, x: float, y: float, squares: tuple[float, float, float]) -> float:
    """Sum of squares about the best line, from the plain sums of points."""
    if count < 3.0:
        return 0.0
    xx, xy, yy = squares
    _, _, least, _ = principal_axis(xx - x * x / count, xy - x * y / count, yy - y * y / count)
    return least


@kernel
def _break(
    points: FloatArray, origins: FloatArray, first: int, last: int, noise: float
) -> tuple[int, float]:
    """Where two lines explain points first..last best: the last point of the first line, and by
    how many squared sigmas better than one line does."""
    x0, y0 = points[first, 0], points[first, 1]
    dx, dy = points[last, 0] - x0, points[last, 1] - y0
    chord = max(np.hypot(dx, dy), 1e-9)
    x = y = xx = xy = yy = 0.0
    for i in range(first, last + 1):
        px, py = points[i, 0] - x0, points[i, 1] - y0
        x, y, xx, xy, yy = x + px, y + py, xx + px * px, xy + px * py, yy + py * py
    count = last - first + 1.0
    whole = _least(count, x, y, (xx, xy, yy))
    lx = ly = lxx = lxy = lyy = 0.0
    best, gain = first, 0.0
    for i in range(first, last):
        px, py = points[i, 0] - x0, points[i, 1] - y0
        lx, ly, lxx, lxy, lyy = lx + px, ly + py, lxx + px * px, lxy + px * py, lyy + py * py
        left = i - first + 1.0
        apart = _least(left, lx, ly, (lxx, lxy, lyy)) + _least(
            count - left, x - lx, y - ly, (xx - lxx, xy - lxy, yy - lyy)
        )
        bx, by = points[i, 0] - origins[i, 0], points[i, 1] - origins[i, 1]
        across = noise * max(
            np.abs(bx * dy - by * dx) / (chord * max(np.hypot(bx, by), 1e-9)), LEAST_INCIDENCE
        )
        better = (whole - apart) / (across * across)
        if better > gain:
            best, gain = i, better
    return best, gain
