"""The equations of a bundle adjustment of poses and straight surfaces, surfaces eliminated.

Each pose is disturbed by a small step in its own frame, so that levers are no longer than the lidar
reaches, wherever in the map it stands. Each observation of a surface is two points that stand for
all its beams: they have their mean and their spread along the surface. A surface is a line,
refitted to its observations at every pose (variable projection, Golub & Pereyra 1973), with an
offset and a turn that are eliminated by Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.supernodes import Panels, add_block
from slamsim.slam.matching.runs import principal_axis
from slamsim.slam.matching.surfaces import BEAMS, SCATTER_XX, SCATTER_XY, SCATTER_YY, X, Y

LINE_FIELDS = 4
"""A line: a point (x, y) in the middle of its observations, and its normal (x, y)."""

NOISE_BEAMS = 5.0
"""The noise of a range as known beforehand counts as much as so many beams of a piece."""


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """points_m: (k, 2, 2) two points that have the mean of each piece and its spread along the
    surface, in the frame of its view. variance: (k,) of the mean across the surface."""

    points_m: FloatArray
    variance: FloatArray


def moments_of(pieces: FloatArray, noise_m: float) -> Moments:
    """Of pieces (k, PIECE_FIELDS); noise_m: standard deviation of a range."""
    beams = pieces[:, BEAMS]
    xx, xy, yy = pieces[:, SCATTER_XX], pieces[:, SCATTER_XY], pieces[:, SCATTER_YY]
    middle, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    half = np.sqrt((middle + root) / beams)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    across = np.maximum(middle - root, 0.0) + NOISE_BEAMS * noise_m**2
    mean = pieces[:, [X, Y]]
    points = np.stack([mean - half, mean + half], axis=1)
    return Moments(points, across / (beams + NOISE_BEAMS - 2.0) / beams)


@kernel
def to_map(points: FloatArray, views: IntArray, poses: FloatArray) -> FloatArray:
    """(k, 2, 2) both points of each observation in the map frame."""
    out = np.empty_like(points)
    for k in range(points.shape[0]):
        x, y, yaw = poses[views[k]]
        cos, sin = np.cos(yaw), np.sin(yaw)
        for end in range(2):
            px, py = points[k, end]
            out[k, end, 0] = x + cos * px - sin * py
            out[k, end, 1] = y + sin * px + cos * py
    return out


@kernel
def fit_lines(points: FloatArray, weights: FloatArray, starts: IntArray) -> FloatArray:
    """(m, LINE_FIELDS) weighted total least squares. points: (k, 2, 2) in the map, sorted by
    surface; starts: (m + 1,) first observation of each surface."""
    lines = np.empty((starts.size - 1, LINE_FIELDS))
    for s in range(starts.size - 1):
        total = x = y = xx = xy = yy = 0.0
        for k in range(starts[s], starts[s + 1]):
            total += 2.0 * weights[k]
            x += weights[k] * (points[k, 0, 0] + points[k, 1, 0])
            y += weights[k] * (points[k, 0, 1] + points[k, 1, 1])
        x /= total
        y /= total
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                dx, dy = points[k, end, 0] - x, points[k, end, 1] - y
                xx += weights[k] * dx * dx
                xy += weights[k] * dx * dy
                yy += weights[k] * dy * dy
        nx, ny, _, _ = principal_axis(xx, xy, yy)
        lines[s, 0], lines[s, 1], lines[s, 2], lines[s, 3] = x, y, nx, ny
    return lines


@kernel
def residuals(points: FloatArray, starts: IntArray, lines: FloatArray) -> FloatArray:
    """(k, 2) signed distance of both points of each observation from the line."""
    out = np.empty((points.shape[0], 2))
    for s in range(starts.size - 1):
        x, y, nx, ny = lines[s]
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                out[k, end] = nx * (points[k, end, 0] - x) + ny * (points[k, end, 1] - y)
    return out


@kernel
def pull_to_lines(
    points: FloatArray,
    weights: FloatArray,
    poses: tuple[IntArray, FloatArray],
    surfaces: tuple[IntArray, FloatArray],
    right: FloatArray,
) -> None:
    """Add to the right-hand side (n, 3) what all observations want; see ``add_surfaces``."""
    unknowns, T_map_own = poses
    starts, lines = surfaces
    row = np.empty(3)
    for s in range(starts.size - 1):
        x, y, nx, ny = lines[s]
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                px, py = points[k, end]
                pull = weights[k] * (nx * (px - x) + ny * (py - y))
                _across(T_map_own[unknowns[k]], points[k, end], (nx, ny), row)
                for i in range(3):
                    right[unknowns[k], i] -= pull * row[i]


@kernel
def _across(
    T_map_own: FloatArray, point: FloatArray, normal: tuple[float, float], row: FloatArray
) -> None:
    """How far a point moves across a surface for a small step of its pose in the pose's frame."""
    x, y, yaw = T_map_own
    nx, ny = normal
    cos, sin = np.cos(yaw), np.sin(yaw)
    row[0], row[1] = cos * nx + sin * ny, cos * ny - sin * nx
    row[2] = ny * (point[0] - x) - nx * (point[1] - y)


@kernel
def add_surfaces(
    points: FloatArray,
    weights: FloatArray,
    poses: tuple[IntArray, FloatArray],
    surfaces: tuple[IntArray, FloatArray],
    panels: Panels,
    system: FloatArray,
) -> None:
    """Add all observations to the system.

    poses: (k,) number of the pose behind each observation, as in ``panels``, equal ones next to
    each other within a surface, and (n, 3) T_map_own by that number. surfaces: starts and lines.
    """
    unknowns, T_map_own = poses
    starts, lines = surfaces
    fixed = panels.place.size - 1
    row, block = np.empty(3), np.empty((3, 3))
    for s in range(starts.size - 1):
        x, y, nx, ny = lines[s]
        size = starts[s + 1] - starts[s]
        shared, who = np.zeros((size, 2, 3)), np.empty(size, np.int64)
        groups = 0
        offset = turn = 0.0
        for k in range(starts[s], starts[s + 1]):
            if groups == 0 or who[groups - 1] != unknowns[k]:
                who[groups] = unknowns[k]
                groups += 1
            block[:] = 0.0
            for end in range(2):
                px, py = points[k, end]
                along = nx * (py - y) - ny * (px - x)
                _across(T_map_own[unknowns[k]], points[k, end], (nx, ny), row)
                offset += weights[k]
                turn += weights[k] * along * along
                for i in range(3):
                    shared[groups - 1, 0, i] += weights[k] * row[i]
                    shared[groups - 1, 1, i] += weights[k] * along * row[i]
                    for j in range(3):
                        block[i, j] += weights[k] * row[i] * row[j]
            if unknowns[k] != fixed:
                add_block(panels, system, unknowns[k], unknowns[k], block)
        _eliminate((offset, turn), shared, who[:groups], panels, system)


@kernel
def _eliminate(
    own: tuple[float, float],
    shared: FloatArray,
    who: IntArray,
    panels: Panels,
    system: FloatArray,
) -> None:
    """Take one surface out of the system: own is its information, shared that with each pose."""
    fixed = panels.place.size - 1
    offset, turn = own
    block = np.empty((3, 3))
    for a in range(who.size):
        for b in range(a + 1):
            if fixed in (who[a], who[b]):
                continue
            for i in range(3):
                for j in range(3):
                    block[i, j] = -(
                        shared[a, 0, i] * shared[b, 0, j] / offset
                        + shared[a, 1, i] * shared[b, 1, j] / turn
                    )
            add_block(panels, system, who[a], who[b], block)
