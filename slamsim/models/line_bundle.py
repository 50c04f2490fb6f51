"""The equations of a bundle adjustment of poses and straight surfaces, surfaces eliminated.

Each pose is disturbed by a small step in its own frame, so that levers are no longer than the lidar
reaches, wherever in the map it stands. Each observation of a surface is two points that stand for
all its beams: they have their mean and their spread along the surface. A surface is a line,
refitted to its observations at every pose (variable projection, Golub & Pereyra 1973), with an
offset and a turn that are eliminated by Schur complement. The map hangs on poses alone; a window of
scans of one lidar also on the shape of its scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.supernodes import Panels, add_block

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


def moments_of(
    mean_m: FloatArray, scatter_m2: FloatArray, beams: FloatArray, noise_m: float
) -> Moments:
    """Of k pieces of surface; noise_m: standard deviation of a range.

    mean_m: (k, 2) in the frame of the view. scatter_m2: (k, 3) xx, xy, yy summed over the beams.
    beams: (k,) how many.
    """
    xx, xy, yy = scatter_m2.T
    middle, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    half = np.sqrt((middle + root) / beams)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    across = np.maximum(middle - root, 0.0) + NOISE_BEAMS * noise_m**2
    points = np.stack([mean_m - half, mean_m + half], axis=1)
    return Moments(points, across / (beams + NOISE_BEAMS - 2.0) / beams)


@kernel
def principal_axis(xx: float, xy: float, yy: float) -> tuple[float, float, float, float]:
    """Normal (unit vector of least scatter), least and largest eigenvalue of a 2 x 2 scatter."""
    half_gap = 0.5 * (xx - yy)
    root = np.sqrt(half_gap * half_gap + xy * xy)
    middle = 0.5 * (xx + yy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return -np.sin(angle), np.cos(angle), max(middle - root, 0.0), middle + root


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
def pose_rows(
    points: FloatArray, starts: IntArray, lines: FloatArray, views: IntArray, poses: FloatArray
) -> FloatArray:
    """(k, 2, 1, 3) how far points (k, 2, 2) in the map move across their surface for a small step
    of the pose that they are seen from, in its own frame; poses: (n, 3), views: (k,) which."""
    rows = np.empty((points.shape[0], 2, 1, 3))
    for s in range(starts.size - 1):
        nx, ny = lines[s, 2], lines[s, 3]
        for k in range(starts[s], starts[s + 1]):
            x, y, yaw = poses[views[k]]
            cos, sin = np.cos(yaw), np.sin(yaw)
            for end in range(2):
                px, py = points[k, end]
                rows[k, end, 0, 0] = cos * nx + sin * ny
                rows[k, end, 0, 1] = cos * ny - sin * nx
                rows[k, end, 0, 2] = ny * (px - x) - nx * (py - y)
    return rows


class Seen(NamedTuple):
    """k observations, sorted by surface, those of one view next to each other within a surface.

    points: (k, 2, 2) in the map. weights: (k,). starts: (m + 1,) first of each surface. lines: (m,
    LINE_FIELDS). rows: (k, 2, b, 3) how far each point moves across its surface for small steps of
    the b unknowns, of three numbers each, that it hangs on. unknowns: (k, b) their numbers, as in
    ``Panels``: the view's pose, then what is the same for all observations of a surface.
    """

    points: FloatArray
    weights: FloatArray
    starts: IntArray
    lines: FloatArray
    rows: FloatArray
    unknowns: IntArray


@kernel
def pull_to_lines(seen: Seen, right: FloatArray) -> None:
    """Add to the right-hand side (n, 3) what all observations want."""
    for s in range(seen.starts.size - 1):
        x, y, nx, ny = seen.lines[s]
        for k in range(seen.starts[s], seen.starts[s + 1]):
            for end in range(2):
                px, py = seen.points[k, end]
                pull = seen.weights[k] * (nx * (px - x) + ny * (py - y))
                for b in range(seen.unknowns.shape[1]):
                    for i in range(3):
                        right[seen.unknowns[k, b], i] -= pull * seen.rows[k, end, b, i]


@kernel
def add_surfaces(seen: Seen, panels: Panels, system: FloatArray) -> None:
    """Add all observations to the system.

    system: (k,) flat, as ``models.supernodes`` lays it out.
    """
    kinds = seen.unknowns.shape[1]
    for s in range(seen.starts.size - 1):
        begin, end = seen.starts[s], seen.starts[s + 1]
        shared = np.zeros((end - begin + kinds, 2, 3))
        who = np.empty(end - begin + kinds, np.int64)
        groups = kinds - 1
        for group in range(groups):
            who[group] = seen.unknowns[begin, 1 + group]
        own = np.zeros(2)
        for k in range(begin, end):
            if groups == kinds - 1 or who[groups - 1] != seen.unknowns[k, 0]:
                who[groups] = seen.unknowns[k, 0]
                groups += 1
            _add_observation(seen, k, seen.lines[s], groups - 1, (own, shared), panels, system)
        _eliminate((own[0], own[1]), shared, who[:groups], panels, system)


@kernel
def _add_observation(
    seen: Seen,
    k: int,
    line: FloatArray,
    group: int,
    surface: tuple[FloatArray, FloatArray],
    panels: Panels,
    system: FloatArray,
) -> None:
    """Add observation k to the system and to what its surface has: its own information (2,) about
    offset and turn, and that shared with each unknown; group: the pose's place among these."""
    own, shared = surface
    x, y, nx, ny = line
    kinds, fixed, weight = seen.unknowns.shape[1], panels.place.size - 1, seen.weights[k]
    blocks = np.zeros((kinds, kinds, 3, 3))
    for end in range(2):
        px, py = seen.points[k, end]
        along = nx * (py - y) - ny * (px - x)
        own[0] += weight
        own[1] += weight * along * along
        for b in range(kinds):
            row, at = seen.rows[k, end, b], group if b == 0 else b - 1
            for i in range(3):
                shared[at, 0, i] += weight * row[i]
                shared[at, 1, i] += weight * along * row[i]
                for c in range(b + 1):
                    for j in range(3):
                        blocks[b, c, i, j] += weight * row[i] * seen.rows[k, end, c, j]
    for b in range(kinds):
        for c in range(b + 1):
            if fixed not in (seen.unknowns[k, b], seen.unknowns[k, c]):
                add_block(panels, system, seen.unknowns[k, b], seen.unknowns[k, c], blocks[b, c])


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
    offset, turn = own[0], max(own[1], 1e-12)
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
