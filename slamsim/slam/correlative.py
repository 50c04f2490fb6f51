"""Correlative matching: the best pose in a window, found without looking at every pose.

The likelihood of a point is read from a grid; a pyramid of the grid's maxima bounds the score
of a whole block of translations at once, so that branch and bound finds the best pose of the
window exactly (Olson 2009, "Real-time correlative scan matching"; Hess et al. 2016, "Real-time
loop closure in 2D LIDAR SLAM", algorithm 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.geometry import transform_points
from slamsim.jit import kernel
from slamsim.types import FloatArray, IntArray

MAX_LEVEL = 6
FULL_SCALE = 255.0
REACH_SHARE = 0.9
"""A turn by one step moves this share of the points by no more than a cell."""

MAX_LOOKUPS = 60_000_000
"""A search that has read the grid so often is given up."""


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodGrid:
    """levels: (MAX_LEVEL + 1, rows, cols); level l holds the largest likelihood, of 255, of the
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
    points_m: FloatArray, resolution_m: float, sigma_m: float, radius_m: float
) -> LikelihoodGrid:
    """The grid of a set of surface points (n, 2): exp(-d^2 / 2 sigma^2) of the nearest one.

    Points farther than radius_m from the origin are left out.
    """
    kept = points_m[np.hypot(points_m[:, 0], points_m[:, 1]) <= radius_m]
    kept = kept if len(kept) else np.zeros((1, 2))
    margin = (1 << MAX_LEVEL) + int(np.ceil(3.0 * sigma_m / resolution_m)) + 1
    first = np.floor(kept.min(axis=0) / resolution_m).astype(np.int64) - margin
    last = np.floor(kept.max(axis=0) / resolution_m).astype(np.int64) + margin
    columns, rows = (last - first + 1).tolist()
    origin_m = first * resolution_m
    levels = np.zeros((MAX_LEVEL + 1, rows, columns), dtype=np.uint8)
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
) -> Peak | None:
    """The pose in the window about ``T_grid_points`` with the highest score, at least min_score.

    points_m: (n, 2), best given about their own middle, for they are turned about their origin.
    Translations are searched in steps of a cell, turns in steps that move the points by less
    than one. rival: (share, distance_m, turn_rad): the second search asks whether a pose farther
    than that from the best reaches that share of its score. None if nothing reaches min_score or
    the search grew too long.
    """
    ranges_m = np.sort(np.hypot(points_m[:, 0], points_m[:, 1]))
    reach_m = max(float(ranges_m[int(REACH_SHARE * (len(ranges_m) - 1))]), 1.0)
    step_rad = grid.resolution_m / reach_m
    turns = np.arange(-np.ceil(window.turn_rad / step_rad), np.ceil(window.turn_rad / step_rad) + 1)
    yaws = T_grid_points[2] + turns * step_rad
    cells = _cells(grid, points_m, T_grid_points[:2], yaws)
    half = np.ceil(np.array([window.x_m, window.y_m]) / grid.resolution_m).astype(np.int64)
    nowhere = np.array([0, 0, 0, -1, -1], dtype=np.int64)
    best, score = _branch_and_bound(grid.levels, cells, half, min_score, nowhere)
    if score < min_score:
        return None
    share, distance_m, turn_rad = rival
    around = np.array(
        [*best, round(turn_rad / step_rad), round(distance_m / grid.resolution_m)], dtype=np.int64
    )
    _, second = _branch_and_bound(grid.levels, cells, half, share * score, around)
    offset_m = (best[1:] * grid.resolution_m).astype(np.float64)
    found = np.array([*(T_grid_points[:2] + offset_m), yaws[best[0]]])
    return Peak(found, score, max(second, share * score) if second >= 0.0 else 1.0)


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


@kernel
def _bound(
    level: NDArray[np.uint8], cells: NDArray[np.int32], x: int, y: int, enough: float
) -> float:
    """Sum of the points' values at an offset, -1 as soon as it cannot reach ``enough``."""
    rows, columns = level.shape
    total, left = 0, 255 * cells.shape[0]
    for k in range(cells.shape[0]):
        r, c = cells[k, 0] + y, cells[k, 1] + x
        left -= 255
        if 0 <= r < rows and 0 <= c < columns:
            total += level[r, c]
        if total + left < enough:
            return -1.0
    return float(total)


@kernel
def _excluded(a: int, x: int, y: int, size: int, around: IntArray) -> bool:
    """Whether a whole block of offsets lies in the neighbourhood that does not count."""
    best_a, best_x, best_y, turn, reach = around
    return bool(
        abs(a - best_a) <= turn
        and x >= best_x - reach
        and y >= best_y - reach
        and x + size - 1 <= best_x + reach
        and y + size - 1 <= best_y + reach
    )


@kernel
def _roots(
    level: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    size: int,
    goal: float,
    around: IntArray,
) -> FloatArray:
    """(k, 4) blocks (score bound, turn, x, y) of the coarsest level to look into, best first."""
    nx, ny = (2 * half[0]) // size + 1, (2 * half[1]) // size + 1
    roots = np.empty((cells.shape[0] * nx * ny, 4))
    count = 0
    for a in range(cells.shape[0]):
        for i in range(nx):
            for j in range(ny):
                x, y = i * size - half[0], j * size - half[1]
                score = _bound(level, cells[a], x, y, goal)
                if score >= goal and not _excluded(a, x, y, size, around):
                    roots[count, 0], roots[count, 1] = score, a
                    roots[count, 2], roots[count, 3] = x, y
                    count += 1
    return roots[np.argsort(-roots[:count, 0])]


@kernel
def _children(
    block: FloatArray,
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    goal: float,
    around: IntArray,
) -> FloatArray:
    """(k, 5) the quarters (bound, turn, x, y, level) of a block that may still win, best last."""
    a, x, y, level = int(block[1]), int(block[2]), int(block[3]), int(block[4]) - 1
    size = 1 << level
    kept = np.empty((4, 5))
    count = 0
    for i in range(2):
        for j in range(2):
            cx, cy = x + i * size, y + j * size
            if cx > half[0] or cy > half[1] or _excluded(a, cx, cy, size, around):
                continue
            score = _bound(levels[level], cells[a], cx, cy, goal)
            if score >= goal:
                kept[count, 0], kept[count, 1] = score, a
                kept[count, 2], kept[count, 3], kept[count, 4] = cx, cy, level
                count += 1
    return kept[np.argsort(kept[:count, 0])]


@kernel
def _branch_and_bound(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    min_score: float,
    around: IntArray,
) -> tuple[IntArray, float]:
    """Best (turn, x, y) in cells and its score; score 0 if none reaches min_score, -1 if given up.

    around: (turn, x, y, half width in turns, in cells) of poses not to consider.
    """
    full = 255.0 * cells.shape[1]
    best, found = np.zeros(3, np.int64), 0.0
    goal = min_score * full
    top = 0
    while top < levels.shape[0] - 1 and (1 << top) < max(half[0], half[1]):
        top += 1
    roots = _roots(levels[top], cells, half, 1 << top, goal, around)
    stack = np.empty((4 * (top + 1) + 1, 5))
    blocks = 0
    for k in range(roots.shape[0]):
        stack[0, :4], stack[0, 4] = roots[k], top
        depth = 1
        while depth > 0:
            depth -= 1
            block = stack[depth].copy()
            if block[0] < goal or (found > 0.0 and block[0] <= found):
                continue
            if block[4] == 0.0:
                best[0], best[1], best[2] = int(block[1]), int(block[2]), int(block[3])
                found = goal = block[0]
                continue
            for child in _children(block, levels, cells, half, goal, around):
                stack[depth] = child
                depth += 1
            blocks += 4
            if blocks * cells.shape[1] > MAX_LOOKUPS:
                return best, -1.0
    return best, found / full
