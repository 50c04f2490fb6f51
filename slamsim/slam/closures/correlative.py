"""Correlative matching: the best pose in a window, found without looking at every pose.

The likelihood of a point is read from a grid; a pyramid of the grid's maxima bounds the score
of a whole block of translations at once, so that branch and bound finds the best pose of the
window exactly (Olson 2009, "Real-time correlative scan matching"; Hess et al. 2016, "Real-time
loop closure in 2D LIDAR SLAM", algorithm 3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slamsim.core.geometry import transform_points
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray
from slamsim.slam.closures.branch_and_bound import FULL_SCALE, MAX_LOOKUPS, best_offset

MAX_LEVEL = 6
REACH_SHARE = 0.9
"""A turn by one step moves this share of the points by no more than a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodGrid:
    """levels: (k, rows, cols); level l holds the largest likelihood, of 255, of the
    2^l x 2^l cells from (row, col) on. origin_m: (2,) outer corner of cell (0, 0)."""

    levels: NDArray[np.uint8]
    origin_m: FloatArray
    resolution_m: float


@dataclass(frozen=True, slots=True)
class Window:
    """Half widths of a search about its middle."""

    x_m: float
    y_m: float
    turn_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Peak:
    """T_grid_points: (3,) pose of the points' middle. score: their mean likelihood, 0 to 1.

    rival: the highest score at another place in the window, or the bound below which none was
    sought.
    """

    T_grid_points: FloatArray
    score: float
    rival: float


def likelihood_grid(
    points_m: FloatArray,
    resolution_m: float,
    sigma_m: float,
    radius_m: float,
    max_level: int = MAX_LEVEL,
) -> LikelihoodGrid:
    """The grid of a set of surface points (n, 2): exp(-d^2 / 2 sigma^2) of the nearest one.

    Points farther than radius_m from the origin are left out.
    """
    kept = points_m[np.hypot(points_m[:, 0], points_m[:, 1]) <= radius_m]
    kept = kept if len(kept) else np.zeros((1, 2))
    margin = (1 << max_level) + int(np.ceil(3.0 * sigma_m / resolution_m)) + 1
    first = np.floor(kept.min(axis=0) / resolution_m).astype(np.int64) - margin
    last = np.floor(kept.max(axis=0) / resolution_m).astype(np.int64) + margin
    columns, rows = (last - first + 1).tolist()
    origin_m = first * resolution_m
    levels = np.zeros((max_level + 1, rows, columns), dtype=np.uint8)
    _smear((kept - origin_m) / resolution_m, sigma_m / resolution_m, levels[0])
    _raise_levels(levels)
    return LikelihoodGrid(levels, origin_m, resolution_m)


def search(
    grid: LikelihoodGrid,
    points_m: FloatArray,
    T_grid_points: FloatArray,
    window: Window,
    min_score: float,
    rival: tuple[float, float, float],
    most_lookups: float = MAX_LOOKUPS,
) -> Peak | None:
    """The pose in the window about ``T_grid_points`` with the highest score, at least min_score.

    points_m: (n, 2), best given about their own middle, for they are turned about their origin.
    Translations are searched in steps of a cell, turns in steps that move the points by less
    than one. rival: (share, distance_m, turn_rad): the second search asks whether a pose farther
    than that from the best reaches that share of its score. None if nothing reaches min_score or
    the search reads the grid more often than most_lookups.
    """
    share, distance_m, turn_rad = rival
    places = Places(grid, points_m, T_grid_points, window, (distance_m, turn_rad), most_lookups)
    best = places.best(min_score)
    if best is None:
        return None
    second = places.best(share * best.score)
    if second is None and places.given_up:
        return replace(best, rival=1.0)
    return replace(best, rival=share * best.score if second is None else second.score)


class Places:
    """A search of one window that gives one place after the other, the best first.

    apart: (distance_m, turn_rad) from which on a pose is another place than one given before. The
    others are as for ``search``.
    """

    def __init__(
        self,
        grid: LikelihoodGrid,
        points_m: FloatArray,
        T_grid_points: FloatArray,
        window: Window,
        apart: tuple[float, float],
        most_lookups: float,
    ) -> None:
        ranges_m = np.sort(np.hypot(points_m[:, 0], points_m[:, 1]))
        reach_m = max(float(ranges_m[int(REACH_SHARE * (len(ranges_m) - 1))]), 1.0)
        step_rad, turns = _turns(window.turn_rad, grid.resolution_m / reach_m)
        self._grid, self._middle_m, self._most_lookups = grid, T_grid_points[:2], most_lookups
        self._yaws = T_grid_points[2] + turns * step_rad
        self._cells = _cells(grid, points_m, self._middle_m, self._yaws)
        half = np.ceil(np.array([window.x_m, window.y_m]) / grid.resolution_m)
        self._half = half.astype(np.int64)
        reach = (round(apart[1] / step_rad), round(apart[0] / grid.resolution_m))
        self._reach = (*reach, round(2.0 * np.pi / step_rad))
        self._shift = float(ranges_m[-1]) * step_rad / grid.resolution_m
        self._given = np.zeros((0, 6), dtype=np.int64)
        self.given_up = False
        """Whether the last search read the grid too often to end."""

    def best(self, min_score: float) -> Peak | None:
        """The best place not given before, if it scores as much."""
        window = (self._grid.levels, self._cells, self._half)
        offset, score = best_offset(
            *window, min_score, self._given, self._shift, self._most_lookups
        )
        self.given_up = score < 0.0
        if score <= 0.0 or score < min_score:
            return None
        self._given = np.vstack([self._given, [*offset, *self._reach]])
        offset_m = (offset[1:] * self._grid.resolution_m).astype(np.float64)
        return Peak(np.array([*(self._middle_m + offset_m), self._yaws[offset[0]]]), score, 0.0)


def _turns(half_rad: float, step_rad: float) -> tuple[float, FloatArray]:
    """The step, at most step_rad, and how many of it each turn is; on a circle each one once."""
    if half_rad < np.pi:
        half = np.ceil(half_rad / step_rad)
        return step_rad, np.arange(-half, half + 1.0)
    circle = int(np.ceil(2.0 * np.pi / step_rad))
    return 2.0 * np.pi / circle, np.arange(circle, dtype=np.float64) - circle // 2


def scores(grid: LikelihoodGrid, points_m: FloatArray, T_grid_points: FloatArray) -> FloatArray:
    """(k,) mean likelihood of the points (n, 2) at each of the poses (k, 3)."""
    placed = transform_points(T_grid_points[:, None], points_m)
    cells = np.floor((placed - grid.origin_m) / grid.resolution_m).astype(np.int64)
    rows, columns = grid.levels.shape[1:]
    inside = (cells >= 0).all(axis=2) & (cells[..., 0] < columns) & (cells[..., 1] < rows)
    cells[~inside] = 0
    values = np.where(inside, grid.levels[0][cells[..., 1], cells[..., 0]], 0)
    return np.asarray(values.mean(axis=1) / FULL_SCALE)


def _cells(
    grid: LikelihoodGrid, points_m: FloatArray, middle_m: FloatArray, yaws: FloatArray
) -> NDArray[np.int32]:
    """(yaws, n, 2) row and column of each point at each turn."""
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    x = middle_m[0] + cos * points_m[:, 0] - sin * points_m[:, 1]
    y = middle_m[1] + sin * points_m[:, 0] + cos * points_m[:, 1]
    rows = np.floor((y - grid.origin_m[1]) / grid.resolution_m)
    columns = np.floor((x - grid.origin_m[0]) / grid.resolution_m)
    return np.stack([rows, columns], axis=-1).astype(np.int32)


@kernel
def _smear(points: FloatArray, sigma: float, level: NDArray[np.uint8]) -> None:
    """Stamp a bell of the given width, in cells, at each point."""
    reach = int(np.ceil(3.0 * sigma))
    for k in range(points.shape[0]):
        column, row = int(points[k, 0]), int(points[k, 1])
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                dx, dy = c + 0.5 - points[k, 0], r + 0.5 - points[k, 1]
                value = np.uint8(
                    np.round(255.0 * np.exp(-0.5 * (dx * dx + dy * dy) / (sigma * sigma)))
                )
                level[r, c] = max(level[r, c], value)


@kernel
def _raise_levels(levels: NDArray[np.uint8]) -> None:
    """Fill levels 1 and up from level 0: the maximum of four blocks of the level below."""
    rows, columns = levels.shape[1], levels.shape[2]
    for level in range(1, levels.shape[0]):
        half = 1 << (level - 1)
        for r in range(rows):
            r2 = min(r + half, rows - 1)
            for c in range(columns):
                c2 = min(c + half, columns - 1)
                below = levels[level - 1]
                levels[level, r, c] = max(below[r, c], below[r, c2], below[r2, c], below[r2, c2])
