"""Map scores: against a slow search over all pairs of cells, and against known faults."""

from __future__ import annotations

import numpy as np
import pytest
from slow_grid import slow_scores, slow_seen

from slamsim.core.geometry import inverse, transform_points
from slamsim.core.types import Grid
from slamsim.evaluate.grid import (
    MapScores,
    cell_centres,
    compare_grids,
    sample,
    wall_surface,
    wrong_walls,
)
from slamsim.evaluate.visibility import seen_from
from slamsim.guard.errors import SlamsimError

IDENTITY = np.zeros(3)
AROUND = np.array([(-0.3, 2.6), (2.3, 2.6), (2.3, 4.3), (-0.3, 4.3), (-0.3, 2.6)])
"""A path around the pillar of the room."""


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


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("range_m", [np.inf, 0.4])
def test_what_is_in_view_is_what_a_slow_search_finds(seed: int, range_m: float) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.choice([0.0, 1.0, np.nan], (20, 26), p=[0.8, 0.1, 0.1]).astype(np.float32)
    truth = Grid(cells, 0.05, (0.3, -0.2))
    path_m = np.array([(0.417, 0.013), (0.931, 0.229), (1.273, 0.611)])
    seen = seen_from(truth, path_m, range_m)
    found = {(int(row), int(column)) for row, column in np.argwhere(seen)}
    slow = slow_seen(truth, path_m, range_m)
    # A ray through the very corner of a cell may go either way.
    assert len(found ^ slow) <= 2
    assert len(slow) > 30


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_scores_are_those_of_a_slow_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth_cells = rng.choice([0.0, 1.0, np.nan], (18, 24), p=[0.7, 0.25, 0.05])
    truth = Grid(truth_cells.astype(np.float32), 0.05, (0.3, -0.2))
    estimate_cells = rng.choice([0.05, 0.5, 0.95, np.nan], (25, 30), p=[0.6, 0.1, 0.1, 0.2])
    estimate = Grid(estimate_cells.astype(np.float32), 0.04, (-0.1, 0.1))
    T_truth_estimate = np.array([0.11, -0.13, 0.4])
    path_m = np.array([(0.517, 0.113), (1.273, 0.411)])
    fast = compare_grids(estimate, truth, T_truth_estimate, path_m)
    slow = slow_scores(estimate, truth, T_truth_estimate, path_m)
    assert fast.wall_recall == pytest.approx(slow.wall_recall, abs=0.03)
    assert fast.wall_coverage == pytest.approx(slow.wall_coverage)
    assert fast.wall_precision == pytest.approx(slow.wall_precision)
    assert fast.wall_error_mean_m == pytest.approx(slow.wall_error_mean_m)
    assert fast.doubled_wall_share == pytest.approx(slow.doubled_wall_share)
    assert fast.free_iou == pytest.approx(slow.free_iou, abs=0.01)
    assert fast.free_coverage == pytest.approx(slow.free_coverage)


def test_a_perfect_map_has_perfect_scores_though_no_inside_of_a_wall_was_seen() -> None:
    truth = room()
    assert compare_grids(mapped(truth), truth, IDENTITY, AROUND) == MapScores(
        wall_recall=1.0,
        wall_coverage=1.0,
        wall_precision=1.0,
        wall_error_mean_m=0.0,
        doubled_wall_share=0.0,
        free_iou=1.0,
        free_coverage=1.0,
    )


def test_one_cell_off_is_right_diagonals_included_and_two_cells_off_is_wrong() -> None:
    truth = room()
    perfect = mapped(truth)
    step = truth.resolution_m
    near = compare_grids(perfect, truth, np.array([step, step, 0.0]), AROUND)
    assert (near.wall_recall, near.wall_precision) == (1.0, 1.0)
    assert near.free_iou is not None
    assert near.free_iou < 1.0
    far = compare_grids(perfect, truth, np.array([2 * step, 2 * step, 0.0]), AROUND)
    assert far.wall_recall is not None
    assert far.wall_recall < 0.2


def test_the_alignment_undoes_any_origin_and_turn() -> None:
    truth = room()
    perfect = mapped(truth)
    T_truth_estimate = np.array([3.0, -2.0, np.pi / 2])
    # A quarter turn back: the true right edge, at x = 3 m, becomes the lowest row.
    corner = transform_points(inverse(T_truth_estimate), np.array([-1.0 + 80 * 0.05, 2.0]))
    turned = Grid(perfect.occupancy.T[::-1].copy(), 0.05, (corner[0], corner[1]))
    scores = compare_grids(turned, truth, T_truth_estimate, AROUND)
    assert (scores.wall_recall, scores.wall_precision) == (1.0, 1.0)
    assert scores.free_iou == pytest.approx(1.0)


def test_a_wall_drawn_twice_is_told() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = perfect.occupancy.copy()
    cells[12, 10:70] = 0.95  # 0.2 m inside the lower wall
    scores = compare_grids(Grid(cells, 0.05, perfect.origin_m), truth, IDENTITY, AROUND)
    assert scores.wall_recall == 1.0
    assert scores.doubled_wall_share is not None
    assert 0.2 < scores.doubled_wall_share < 0.6
    assert scores.wall_precision is not None
    assert scores.wall_precision < 0.9


def test_stray_cells_beside_a_wall_are_no_second_wall() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = perfect.occupancy.copy()
    cells[12, 10:70:3] = 0.95
    scores = compare_grids(Grid(cells, 0.05, perfect.origin_m), truth, IDENTITY, AROUND)
    assert scores.doubled_wall_share == 0.0
    assert scores.wall_precision is not None
    assert scores.wall_precision < 1.0


def test_free_space_that_was_not_in_view_is_not_asked_for() -> None:
    cells = room().occupancy.copy()
    cells[8:-8, 38:40] = 1.0
    cells[50, 38:40] = 0.0
    truth = Grid(cells, 0.05, (-1.0, 2.0))
    perfect = mapped(truth)
    left = perfect.occupancy.copy()
    left[:, 40:] = np.nan  # the other room, which only a slit leads to
    path_m = np.array([(-0.3, 2.6), (-0.3, 4.0)])
    scores = compare_grids(Grid(left, 0.05, perfect.origin_m), truth, IDENTITY, path_m)
    assert scores.free_iou is not None
    assert scores.free_iou > 0.95
    assert scores.free_coverage is not None
    assert 0.3 < scores.free_coverage < 0.6


def test_free_space_that_is_claimed_beyond_the_walls_counts_against_the_map() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = np.pad(perfect.occupancy, ((0, 0), (0, 100)), constant_values=0.05)
    scores = compare_grids(Grid(cells, 0.05, perfect.origin_m), truth, IDENTITY, AROUND)
    assert scores.free_iou is not None
    assert scores.free_iou < 0.5


def test_an_empty_map_finds_nothing_and_has_no_precision() -> None:
    truth = room()
    empty = Grid(np.full((5, 5), np.nan, dtype=np.float32), 0.05, (0.0, 0.0))
    assert compare_grids(empty, truth, IDENTITY, AROUND) == MapScores(
        wall_recall=0.0,
        wall_coverage=0.0,
        wall_precision=None,
        wall_error_mean_m=None,
        doubled_wall_share=0.0,
        free_iou=0.0,
        free_coverage=0.0,
    )


def test_a_truth_without_a_reachable_wall_is_refused() -> None:
    solid = Grid(np.ones((5, 5), dtype=np.float32), 0.05, (0.0, 0.0))
    with pytest.raises(SlamsimError, match="no wall"):
        compare_grids(mapped(room()), solid, IDENTITY, AROUND)


def test_a_point_outside_the_grid_is_unknown() -> None:
    truth = room()
    values = sample(truth, np.array([[-1.01, 2.5], [0.0, 3.0], [100.0, 3.0], [-0.79, 2.21]]))
    np.testing.assert_array_equal(values, [np.nan, 0.0, np.nan, 1.0])


def test_a_wall_that_cannot_be_seen_from_the_path_is_not_asked_for() -> None:
    truth = room()
    perfect = mapped(truth)
    cells = perfect.occupancy.copy()
    cells[20:26, 35] = np.nan  # the far side of the pillar, seen from the left
    from_the_left = np.array([(-0.4, 3.15)])
    map_without = Grid(cells, 0.05, perfect.origin_m)
    scores = compare_grids(map_without, truth, IDENTITY, from_the_left)
    assert scores.wall_recall == 1.0
    assert scores.wall_coverage is not None
    assert scores.wall_coverage < 1.0
    around = compare_grids(map_without, truth, IDENTITY, AROUND)
    assert around.wall_recall == around.wall_coverage
    near = compare_grids(map_without, truth, IDENTITY, from_the_left, range_m=0.1)
    assert near.wall_recall is None


def test_the_cells_that_count_against_a_map_are_those_of_its_scores() -> None:
    rng = np.random.default_rng(5)
    truth = room()
    perfect = mapped(truth)
    cells = np.where(rng.uniform(size=perfect.occupancy.shape) < 0.1, 0.9, perfect.occupancy)
    cells[4:12] = np.nan
    estimate = Grid(cells.astype(np.float32), 0.05, perfect.origin_m)
    scores = compare_grids(estimate, truth, IDENTITY, AROUND)
    invented, missed = wrong_walls(estimate, truth, IDENTITY, AROUND)
    assert scores.wall_precision == pytest.approx(
        1.0 - invented.sum() / np.count_nonzero(estimate.occupancy > 0.65)
    )
    in_view = wall_surface(truth.occupancy) & seen_from(truth, AROUND)
    assert scores.wall_recall == pytest.approx(1.0 - missed.sum() / in_view.sum())
    assert len(cell_centres(truth, missed)) == missed.sum() > 0
