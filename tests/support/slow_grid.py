"""The definitions of the map scores, by loops over all cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.core.geometry import inverse, transform_points
from slamsim.core.types import Float32Array, FloatArray, Grid
from slamsim.evaluate.grid import MapScores
from slamsim.evaluate.visibility import DIRECTIONS


def slow_scores(
    estimate: Grid, truth: Grid, T_truth_estimate: FloatArray, path_m: FloatArray
) -> MapScores:
    """The definitions, by loops over all cells."""

    def centre(grid: Grid, row: int, column: int) -> tuple[float, float]:
        step = grid.resolution_m
        return grid.origin_m[0] + (column + 0.5) * step, grid.origin_m[1] + (row + 0.5) * step

    def surface_cells(cells: Float32Array) -> list[tuple[int, int]]:
        found = []
        for row, column in np.ndindex(*cells.shape):
            if cells[row, column] != 1.0:
                continue
            for other in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                inside = 0 <= other[0] < cells.shape[0] and 0 <= other[1] < cells.shape[1]
                if inside and cells[other] == 0.0:
                    found.append((row, column))
                    break
        return found

    cells = surface_cells(truth.occupancy)
    surface = [centre(truth, *cell) for cell in cells]
    seen = slow_seen(truth, path_m, np.inf)
    in_view = [centre(truth, *cell) for cell in cells if cell in seen]
    wall_cells = [
        cell for cell in np.ndindex(*estimate.occupancy.shape) if estimate.occupancy[cell] > 0.65
    ]
    walls = [
        tuple(transform_points(T_truth_estimate, np.array(centre(estimate, row, column))))
        for row, column in wall_cells
    ]
    tolerance = np.sqrt(2.0) * truth.resolution_m * 1.000001

    def nearest(point: tuple[float, ...], others: Sequence[tuple[float, ...]]) -> float:
        return min((np.hypot(point[0] - x, point[1] - y) for x, y in others), default=np.inf)

    wall_distance = [nearest(wall, surface) for wall in walls]
    off = {
        cell: wall
        for cell, wall, d in zip(wall_cells, walls, wall_distance, strict=True)
        if d > tolerance
    }
    ghosts = [
        wall
        for cell, wall in off.items()
        if len(joined(cell, set(off))) * estimate.resolution_m >= 0.25
    ]
    both = either = 0
    pad = 60
    rows, columns = truth.occupancy.shape
    for row in range(-pad, rows + pad):
        for column in range(-pad, columns + pad):
            here = 0 <= row < rows and 0 <= column < columns
            free = here and truth.occupancy[row, column] == 0.0
            x, y = transform_points(inverse(T_truth_estimate), np.array(centre(truth, row, column)))
            i = int(np.floor((y - estimate.origin_m[1]) / estimate.resolution_m))
            j = int(np.floor((x - estimate.origin_m[0]) / estimate.resolution_m))
            known = 0 <= i < estimate.occupancy.shape[0] and 0 <= j < estimate.occupancy.shape[1]
            called = known and estimate.occupancy[i, j] < 0.25
            both += bool(free and called)
            either += bool((free and (row, column) in seen) or called)
    return MapScores(
        wall_recall=float(np.mean([nearest(cell, walls) <= tolerance for cell in in_view])),
        wall_coverage=float(np.mean([nearest(cell, walls) <= tolerance for cell in surface])),
        wall_precision=float(np.mean([d <= tolerance for d in wall_distance])),
        wall_error_mean_m=float(np.mean(wall_distance)),
        doubled_wall_share=float(np.mean([nearest(cell, ghosts) <= 0.5 for cell in surface])),
        free_iou=both / either,
        free_coverage=both / np.count_nonzero(truth.occupancy == 0.0),
    )


def joined(start: tuple[int, ...], cells: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
    """All cells that hang together with one, corners included."""
    found, ahead = {start}, [start]
    while ahead:
        row, column = ahead.pop()
        around = {(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & cells
        ahead += around - found
        found |= around
    return found


def slow_seen(truth: Grid, path_m: FloatArray, range_m: float) -> set[tuple[int, int]]:
    """The nearest of all solid squares that each ray enters, and all others before it."""
    cells = np.array(list(np.ndindex(*truth.occupancy.shape)))
    solid = truth.occupancy.ravel() == 1.0
    low = cells[:, ::-1] * truth.resolution_m + truth.origin_m
    high = low + truth.resolution_m
    seen = set()
    for origin in path_m:
        for angle in np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False):
            with np.errstate(divide="ignore", invalid="ignore"):
                direction = np.array([np.cos(angle), np.sin(angle)])
                ways = np.sort([(low - origin) / direction, (high - origin) / direction], axis=0)
            enter, leave = ways[0].max(axis=1), ways[1].min(axis=1)
            met = (enter <= leave) & (leave >= 0.0) & (enter <= range_m)
            end = np.where(met & solid, enter, np.inf).min()
            seen |= {(int(row), int(column)) for row, column in cells[met & (enter <= end)]}
    return seen
