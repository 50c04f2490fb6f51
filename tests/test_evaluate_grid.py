"""Map scores: against a slow search over all pairs of cells, and against known faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from slamsim.evaluate.grid import MapScores, compare_grids, sample, wall_surface
from slamsim.geometry import inverse, transform_points
from slamsim.safe.errors import SlamsimError
from slamsim.types import Float32Array, FloatArray, Grid

IDENTITY = np.zeros(3)


def room(rows: int = 60, columns: int = 80, resolution_m: float = 0.05) -> Grid:
    """A free room in thick walls with a pillar, unreachable on the outside."""
    cells = np.full((rows, columns), np.nan, dtype=np.float32)
    cells[4:-4, 4:-4] = 1.0
    cells[8:-8, 8:-8] = 0.0
    cells[20:26, 30:36] = 1.0
    return Grid(cells, resolution_m, (-1.0, 2.0))


def mapped(truth: Grid) -> Grid:
    """What a perfect lidar would show of it: surfaces and free space."""
    cells = np.full(truth.occupancy.shape, np.nan, dtype=np.float32)
    cells[truth.occupancy == 0.0] = 0.05
    cells[wall_surface(truth.occupancy)] = 0.95
    return Grid(cells, truth.resolution_m, truth.origin_m)


def slow_scores(estimate: Grid, truth: Grid, T_truth_estimate: FloatArray) -> MapScores:
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

    surface = [centre(truth, *cell) for cell in surface_cells(truth.occupancy)]
    walls = [
        tuple(transform_points(T_truth_estimate, np.array(centre(estimate, row, column))))
        for row, column in np.ndindex(*estimate.occupancy.shape)
        if estimate.occupancy[row, column] > 0.65
    ]
    tolerance = np.sqrt(2.0) * truth.resolution_m * 1.000001

    def nearest(point: tuple[float, ...], others: Sequence[tuple[float, ...]]) -> float:
        return min((np.hypot(point[0] - x, point[1] - y) for x, y in others), default=np.inf)

    wall_distance = [nearest(wall, surface) for wall in walls]
    ghosts = [wall for wall, d in zip(walls, wall_distance, strict=True) if d > tolerance]
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
            called = known and estimate.occupancy[i, j] < 0.35
            both += bool(free and called)
            either += bool(free or called)
    return MapScores(
        wall_recall=float(np.mean([nearest(cell, walls) <= tolerance for cell in surface])),
        wall_precision=float(np.mean([d <= tolerance for d in wall_distance])),
        wall_error_mean_m=float(np.mean(wall_distance)),
        doubled_wall_share=float(np.mean([nearest(cell, ghosts) <= 0.5 for cell in surface])),
        free_iou=both / either,
    )


@pytest.mark.parametrize("seed", range(3))
def test_scores_are_those_of_a_slow_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth_cells = rng.choice([0.0, 1.0, np.nan], (18, 24), p=[0.7, 0.25, 0.05])
    truth = Grid(truth_cells.astype(np.float32), 0.05, (0.3, -0.2))
    estimate_cells = rng.choice([0.05, 0.5, 0.95, np.nan], (25, 30), p=[0.6, 0.1, 0.1, 0.2])
    estimate = Grid(estimate_cells.astype(np.float32), 0.04, (-0.1, 0.1))
    T_truth_estimate = np.array([0.11, -0.13, 0.4])
    fast = compare_grids(estimate, truth, T_truth_estimate)
    slow = slow_scores(estimate, truth, T_truth_estimate)
    assert fast.wall_recall == pytest.approx(slow.wall_recall)
    assert fast.wall_precision == pytest.approx(slow.wall_precision)
    assert fast.wall_error_mean_m == pytest.approx(slow.wall_error_mean_m)
    assert fast.doubled_wall_share == pytest.approx(slow.doubled_wall_share)
    assert fast.free_iou == pytest.approx(slow.free_iou)


def test_a_perfect_map_has_perfect_scores_though_no_inside_of_a_wall_was_seen() -> None:
    truth = room()
    assert compare_grids(mapped(truth), truth, IDENTITY) == MapScores(1.0, 1.0, 0.0, 0.0, 1.0)


def test_one_cell_off_is_right_diagonals_included_and_two_cells_off_is_wrong() -> None:
    truth = room()
    perfect = mapped(truth)
    step = truth.resolution_m
    near = compare_grids(perfect, truth, np.array([step, step, 0.0]))
    assert (near.wall_recall, near.wall_precision) == (1.0, 1.0)
    assert near.free_iou is not None
    assert near.free_iou < 1.0
    far = compare_grids(perfect, truth, np.array([2 * step, 2 * step, 0.0]))
    assert far.wall_recall is not None
    assert far.wall_recall < 0.2


def test_the_alignment_undoes_any_origin_and_turn() -> None:
    truth = room()
    perfect = mapped(truth)
    T_truth_estimate = np.array([3.0, -2.0, np.pi / 2])
    # A quarter turn back: the true right edge, at x = 3 m, becomes the lowest row.
    corner = transform_points(inverse(T_truth_estimate), np.array([-1.0 + 80 * 0.05, 2.0]))
    turned = Grid(perfect.occupancy.T[::-1].copy(), 0.05, (corner[0], corner[1]))
    scores = compare_grids(turned, truth, T_truth_estimate)
    assert (scores.wall_recall, scores.wall_precision) == (1.0, 1.0)
    assert scores.free_iou == pytest.approx(1.0)


def test_a_wall_drawn_twice_is_told() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = perfect.occupancy.copy()
    cells[12, 10:70] = 0.95  # 0.2 m inside the lower wall
    scores = compare_grids(Grid(cells, 0.05, perfect.origin_m), truth, IDENTITY)
    assert scores.wall_recall == 1.0
    assert scores.doubled_wall_share is not None
    assert 0.2 < scores.doubled_wall_share < 0.6
    assert scores.wall_precision is not None
    assert scores.wall_precision < 0.9


def test_free_space_that_is_claimed_beyond_the_walls_counts_against_the_map() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = np.pad(perfect.occupancy, ((0, 0), (0, 100)), constant_values=0.05)
    scores = compare_grids(Grid(cells, 0.05, perfect.origin_m), truth, IDENTITY)
    assert scores.free_iou is not None
    assert scores.free_iou < 0.5


def test_an_empty_map_finds_nothing_and_has_no_precision() -> None:
    truth = room()
    empty = Grid(np.full((5, 5), np.nan, dtype=np.float32), 0.05, (0.0, 0.0))
    assert compare_grids(empty, truth, IDENTITY) == MapScores(0.0, None, None, 0.0, 0.0)


def test_a_truth_without_a_reachable_wall_is_refused() -> None:
    solid = Grid(np.ones((5, 5), dtype=np.float32), 0.05, (0.0, 0.0))
    with pytest.raises(SlamsimError, match="no wall"):
        compare_grids(mapped(room()), solid, IDENTITY)


def test_a_point_outside_the_grid_is_unknown() -> None:
    truth = room()
    values = sample(truth, np.array([[-1.01, 2.5], [0.0, 3.0], [100.0, 3.0], [-0.79, 2.21]]))
    np.testing.assert_array_equal(values, [np.nan, 0.0, np.nan, 1.0])
