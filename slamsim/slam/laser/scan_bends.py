"""How surfaces bend: a parabola along each line that the scans of a window share.

Beams far apart see a round wall as chords whose middles lie inside it, and whose directions change
along it. Taken for straight, such a wall pulls at whatever moves points along it: the angle between
beams and the range offset. The two points of an observation have the mean and the spread of
its beams, hence the mean and the slope that they have of a parabola.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.line_bundle import fit_lines, residuals

BEND_FIELDS = 4
"""Of each surface, at t metres along its line: it lies bend (t^2 - by_slope t - by_offset) off it,
what of t^2 a line fits being left out; information: on the bend, that of before included."""

BY_OFFSET, BY_SLOPE, BEND, INFORMATION = range(BEND_FIELDS)

LARGEST_BEND_PER_M = 2.5
"""Standard deviation of bends before any beam is seen, half a curvature: posts of 0.2 m radius are
the sharpest surfaces of which several beams make a piece."""


@kernel
def fit_bends(
    points: FloatArray, weights: FloatArray, starts: IntArray, lines: FloatArray
) -> FloatArray:
    """(m, BEND_FIELDS) of surfaces whose lines (m, 4) were fitted with the same weights (k,)."""
    bends = np.empty((lines.shape[0], BEND_FIELDS))
    for s in range(lines.shape[0]):
        total = square = cube = 0.0
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                t, _ = _along_across(points[k, end], lines[s])
                total += weights[k]
                square += weights[k] * t * t
                cube += weights[k] * t * t * t
        by_offset, by_slope = square / total, cube / max(square, 1e-12)
        information, pull = 1.0 / LARGEST_BEND_PER_M**2, 0.0
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                t, off = _along_across(points[k, end], lines[s])
                bent = t * t - by_slope * t - by_offset
                information += weights[k] * bent * bent
                pull += weights[k] * bent * off
        bends[s, BY_OFFSET], bends[s, BY_SLOPE] = by_offset, by_slope
        bends[s, BEND], bends[s, INFORMATION] = pull / information, information
    return bends


@kernel
def straightened(
    points: FloatArray, starts: IntArray, lines: FloatArray, bends: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (k, 2, 2) with the bend of their surface taken out; (k, 2, 2) the normals of the
    surfaces where the points are; (k, 2) how far a bend of 1 per metre moves the surface there."""
    flat, normals = np.empty_like(points), np.empty_like(points)
    bent = np.empty(points.shape[:2])
    for s in range(lines.shape[0]):
        _, _, nx, ny = lines[s]
        by_offset, by_slope, bend, _ = bends[s]
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                t, _ = _along_across(points[k, end], lines[s])
                bent[k, end] = t * t - by_slope * t - by_offset
                off, slope = bend * bent[k, end], bend * (2.0 * t - by_slope)
                flat[k, end, 0] = points[k, end, 0] - off * nx
                flat[k, end, 1] = points[k, end, 1] - off * ny
                normals[k, end, 0] = nx + slope * ny
                normals[k, end, 1] = ny - slope * nx
    return flat, normals, bent


@kernel
def _along_across(point: FloatArray, line: FloatArray) -> tuple[float, float]:
    dx, dy = point[0] - line[0], point[1] - line[1]
    return line[2] * dy - line[3] * dx, line[2] * dx + line[3] * dy


def bent_residuals(
    points: FloatArray, weights: FloatArray, starts: IntArray
) -> tuple[FloatArray, float]:
    """(k, 2) distances of all points from their surfaces, fitted to them; and how many numbers of
    these the points tell, bends counted in part that are partly known before."""
    lines = fit_lines(points, weights, starts)
    bends = fit_bends(points, weights, starts, lines)
    flat, _, _ = straightened(points, starts, lines, bends)
    before = 1.0 / LARGEST_BEND_PER_M**2
    told = 2.0 * len(lines) + float((1.0 - before / bends[:, INFORMATION]).sum())
    return residuals(flat, starts, lines), told
