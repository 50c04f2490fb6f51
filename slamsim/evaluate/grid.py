"""Scores of a map against the true walls and free space.

Both grids are compared as sets of cell centres, after the same rigid alignment as the
trajectories, so that neither their origins nor their orientations nor their resolutions need to
agree. "Within one cell" means that two cell centres are at most one diagonal of a cell of the
true grid apart: what the eight neighbours of a cell are from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import inverse, transform_points
from slamsim.core.types import BoolArray, Float32Array, FloatArray, Grid, IntArray
from slamsim.evaluate.visibility import seen_from
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite

GHOST_RADIUS_M = 0.5
"""A wall is drawn twice if another is drawn this near to it where there is no wall."""

GHOST_LENGTH_M = 0.25
"""What is drawn where no wall is counts as one if so much of it hangs together; an isolated cell
just beyond the tolerance is no wall, and precision counts it already."""

MOST_CELLS = 2e9
"""Of the lattice over both grids; a labyrinth has a few million."""

_BLOCK_ROWS = 256
_ROUNDING = 1e-6
"""Distances a millionth of a cell beyond the tolerance are rounding."""


@dataclass(frozen=True, slots=True)
class MapScores:
    """wall_recall: share of the true wall surface in view from the path driven that the map shows
    within one cell. wall_coverage: the same share of all wall surface that borders reachable
    space, hidden or not: it judges the route as well as the map.

    wall_precision: share of the map's occupied cells that lie within one cell of a true wall
    surface. wall_error_mean_m: mean distance of its occupied cells from the nearest true wall
    surface. doubled_wall_share: share of the true wall surface within 0.5 m of which the map shows
    a stretch of 0.25 m or more that belongs to no true wall. free_iou: intersection over union of
    the free cells that were in view from the path driven. free_coverage: share of all reachable
    free cells that the map calls free. A share of nothing (an empty map's precision) is None.
    """

    wall_recall: float | None
    wall_coverage: float | None
    wall_precision: float | None
    wall_error_mean_m: float | None
    doubled_wall_share: float | None
    free_iou: float | None
    free_coverage: float | None


def compare_grids(
    estimate: Grid,
    truth: Grid,
    T_truth_estimate: FloatArray,
    path_m: FloatArray,
    range_m: float = math.inf,
) -> MapScores:
    """Score a map; truth: 1 solid, 0 free and reachable, nan not reachable.

    T_truth_estimate: (3,) takes the estimate's frame to the truth's, from the trajectories.
    path_m: (n, 2) the true path, from which the walls were seen as far as range_m.
    Raises SlamsimError if the truth has no wall that borders reachable space, or the two lie too
    far apart, BadNumbers for an alignment, a path or a range that is none.
    """
    _lattice_bounds(estimate, truth, T_truth_estimate)
    surface_cells = wall_surface(truth.occupancy)
    surface = cell_centres(truth, surface_cells)
    if surface.shape[0] == 0:
        raise SlamsimError("the true grid has no wall that borders reachable space")
    seen = seen_from(truth, path_m, range_m)
    in_view = seen[surface_cells]
    walls = _walls(estimate, T_truth_estimate)
    within_m = tolerance_m(truth)
    map_to_truth_m = nearest_m(walls, surface)
    shown = nearest_m(surface, walls) <= within_m
    ghosts = walls[_hangs_together(estimate, map_to_truth_m > within_m)]
    doubled = nearest_m(surface, ghosts) <= GHOST_RADIUS_M
    free_iou, free_coverage = _free_shares(estimate, truth, seen, T_truth_estimate)
    return MapScores(
        wall_recall=share(shown[in_view]),
        wall_coverage=share(shown),
        wall_precision=share(map_to_truth_m <= within_m),
        wall_error_mean_m=float(np.mean(map_to_truth_m)) if walls.size else None,
        doubled_wall_share=share(doubled),
        free_iou=free_iou,
        free_coverage=free_coverage,
    )


def wrong_walls(
    estimate: Grid,
    truth: Grid,
    T_truth_estimate: FloatArray,
    path_m: FloatArray,
    range_m: float = math.inf,
) -> tuple[BoolArray, BoolArray]:
    """What precision and recall count against a map, as cells; arguments as compare_grids.

    Returns the estimate's occupied cells (its shape) that belong to no true wall, and the
    truth's surface cells in view (its shape) that the map does not show.
    """
    _lattice_bounds(estimate, truth, T_truth_estimate)
    in_view = wall_surface(truth.occupancy) & seen_from(truth, path_m, range_m)
    surface = cell_centres(truth, wall_surface(truth.occupancy))
    walls, wall_cells = _walls(estimate, T_truth_estimate), occupied(estimate)
    invented, missed = np.zeros_like(wall_cells), np.zeros_like(in_view)
    invented[wall_cells] = nearest_m(walls, surface) > tolerance_m(truth)
    missed[in_view] = nearest_m(cell_centres(truth, in_view), walls) > tolerance_m(truth)
    return invented, missed


def wall_surface(occupancy: Float32Array) -> BoolArray:
    """Solid cells with an edge in common with a free reachable cell.

    The inside of a wall and its far side can never be seen and are not asked for. occupancy: (rows,
    columns), as many come back.
    """
    free = np.pad(occupancy == 0.0, 1)
    beside_free = free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:]
    return np.asarray((occupancy == 1.0) & beside_free, dtype=np.bool_)


def cell_centres(grid: Grid, cells: BoolArray) -> FloatArray:
    """(n, 2) centres of the chosen cells, in the grid's frame, row by row."""
    rows, columns = np.nonzero(cells)
    return np.column_stack([columns + 0.5, rows + 0.5]) * grid.resolution_m + grid.origin_m


def occupied(grid: Grid) -> BoolArray:
    """(rows, columns) cells that the map calls a wall."""
    return np.asarray(grid.occupancy > Grid.OCCUPIED_ABOVE, dtype=np.bool_)


def sample(grid: Grid, points_m: FloatArray) -> FloatArray:
    """(n,) occupancy of the cell that each point (n, 2) lies in, nan outside the grid."""
    cells = np.floor((points_m - grid.origin_m) / grid.resolution_m).astype(np.int64)
    rows, columns = grid.occupancy.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < columns) & (cells[:, 1] < rows)
    values = np.full(points_m.shape[0], np.nan)
    values[inside] = grid.occupancy[cells[inside, 1], cells[inside, 0]]
    return values


def _walls(estimate: Grid, T_truth_estimate: FloatArray) -> FloatArray:
    """(n, 2) centres of the occupied cells, in the truth's frame."""
    return transform_points(T_truth_estimate, cell_centres(estimate, occupied(estimate)))


def tolerance_m(truth: Grid) -> float:
    """How far two cell centres are apart at most that are within one cell."""
    return float(np.sqrt(2.0) * truth.resolution_m * (1.0 + _ROUNDING))


def share(chosen: BoolArray) -> float | None:
    """How many of (n,) are so; None of none."""
    return float(np.mean(chosen)) if chosen.size else None


def nearest_m(points: FloatArray, others: FloatArray) -> FloatArray:
    """(n,) distance from each point to the nearest of the others, inf if there is none."""
    from scipy.spatial import KDTree

    if points.shape[0] == 0 or others.shape[0] == 0:
        return np.full(points.shape[0], np.inf)
    return np.asarray(KDTree(others).query(points)[0], dtype=np.float64)


def _hangs_together(estimate: Grid, chosen: BoolArray) -> BoolArray:
    """Which of the chosen occupied cells (in their order) are part of a stretch, not isolated."""
    from scipy import ndimage

    cells = occupied(estimate)
    image = np.zeros_like(cells)
    image[cells] = chosen
    stretches, _ = ndimage.label(image, np.ones((3, 3)))
    long_enough = np.bincount(stretches.ravel()) * estimate.resolution_m >= GHOST_LENGTH_M
    long_enough[0] = False
    return np.asarray(long_enough[stretches[cells]], dtype=np.bool_)


def _free_shares(
    estimate: Grid, truth: Grid, seen: BoolArray, T_truth_estimate: FloatArray
) -> tuple[float | None, float | None]:
    """Intersection over union of what was seen, and coverage of all there is.

    Over the true lattice extended to the whole map: what the map calls free outside counts. Row by
    row in blocks, so that memory stays small however far a bad map reaches.
    """
    T_estimate_truth = inverse(T_truth_estimate)
    low, high = _lattice_bounds(estimate, truth, T_truth_estimate)
    in_view = Grid(seen.astype(np.float32), truth.resolution_m, truth.origin_m)
    both = either = 0
    for first in range(low[1], high[1], _BLOCK_ROWS):
        block = np.arange(first, min(first + _BLOCK_ROWS, high[1]))
        x, y = np.meshgrid(np.arange(low[0], high[0]), block)
        centres = (np.column_stack([x.ravel(), y.ravel()]) + 0.5) * truth.resolution_m
        centres += truth.origin_m
        truly_free = sample(truth, centres) == 0.0
        called_free = (
            sample(estimate, transform_points(T_estimate_truth, centres)) < Grid.FREE_BELOW
        )
        asked = truly_free & (sample(in_view, centres) == 1.0)
        both += int(np.count_nonzero(truly_free & called_free))
        either += int(np.count_nonzero(asked | called_free))
    there = int(np.count_nonzero(truth.occupancy == 0.0))
    return both / either if either else None, both / there if there else None


def _lattice_bounds(
    estimate: Grid, truth: Grid, T_truth_estimate: FloatArray
) -> tuple[IntArray, IntArray]:
    """First and past-the-last (column, row) on the true lattice that hold both grids.

    Raises SlamsimError if that are more cells than can be looked at."""
    require_finite("the alignment of the map", T_truth_estimate, (3,))
    rows, columns = truth.occupancy.shape
    low, high = np.zeros(2, dtype=np.int64), np.array([columns, rows], dtype=np.int64)
    rows, columns = estimate.occupancy.shape
    corners = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]], dtype=np.float64)
    corners = corners * estimate.resolution_m + estimate.origin_m
    cells = (transform_points(T_truth_estimate, corners) - truth.origin_m) / truth.resolution_m
    low = np.minimum(low, np.floor(cells.min(axis=0)).astype(np.int64))
    high = np.maximum(high, np.ceil(cells.max(axis=0)).astype(np.int64))
    metres = (high - low) * truth.resolution_m
    if float(np.prod((high - low).astype(np.float64))) > MOST_CELLS:
        raise SlamsimError(
            f"the map and the true grid lie {metres[0]:.3g} x {metres[1]:.3g} m apart, too many "
            f"cells of {truth.resolution_m:g} m to compare"
        )
    return low, high
