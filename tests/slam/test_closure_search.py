"""The correlative search against looking at every pose."""

from __future__ import annotations

import numpy as np
import pytest

from slamsim.core.geometry import between, inverse, transform_points
from slamsim.core.types import FloatArray
from slamsim.slam.closures.branch_and_bound import best_offset
from slamsim.slam.closures.correlative import (
    LikelihoodGrid,
    Window,
    _cells,
    likelihood_grid,
    scores,
    search,
)

RIVAL = (0.85, 0.5, 0.3)
NOTHING = np.zeros(3)
NO_POSES = np.zeros((0, 6), dtype=np.int64)


def room(rng: np.random.Generator) -> FloatArray:
    """(n, 2) points along the walls of a cluttered room."""
    along = np.linspace(-1.0, 1.0, 150)
    walls = [np.column_stack([6.0 * along, np.full(150, y)]) for y in (-4.0, 4.0)]
    walls += [np.column_stack([np.full(150, x), 4.0 * along]) for x in (-6.0, 6.0)]
    walls += [centre + 0.3 * rng.normal(size=(20, 2)) for centre in rng.uniform(-3, 3, (6, 2))]
    return np.concatenate(walls)


def every_pose(
    grid: LikelihoodGrid, points: FloatArray, start: FloatArray, window: Window
) -> FloatArray:
    """(k, 4) score and pose of everything in the window, with the search's own steps."""
    ranges = np.sort(np.hypot(points[:, 0], points[:, 1]))
    step = grid.resolution_m / max(ranges[int(0.9 * (len(ranges) - 1))], 1.0)
    turns = int(np.ceil(window.turn_rad / step))
    half_x = int(np.ceil(window.x_m / grid.resolution_m))
    half_y = int(np.ceil(window.y_m / grid.resolution_m))
    found = []
    for turn in range(-turns, turns + 1):
        for i in range(-half_x, half_x + 1):
            for j in range(-half_y, half_y + 1):
                offset = [i * grid.resolution_m, j * grid.resolution_m, turn * step]
                found.append(start + offset)
    poses = np.array(found)
    return np.column_stack([scores(grid, points, poses), poses])


@pytest.mark.parametrize("seed", range(6))
def test_branch_and_bound_finds_what_looking_everywhere_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls = room(rng)
    grid = likelihood_grid(walls, 0.1, 0.1, 30.0)
    T_room_points = rng.normal(size=3) * [0.5, 0.3, 0.1]
    seen = walls[rng.permutation(len(walls))[:120]]
    points = transform_points(inverse(T_room_points), seen) + rng.normal(0.0, 0.02, seen.shape)
    window = Window(1.1, 0.8, 0.2)

    peak = search(grid, points, NOTHING, window, 0.1, RIVAL)
    looked = every_pose(grid, points, NOTHING, window)
    assert peak is not None
    # The grid of the oracle rounds each pose anew, the search once per turn: a cell's difference.
    assert abs(peak.score - looked[:, 0].max()) < 0.02
    off = between(T_room_points, peak.T_grid_points)
    assert np.hypot(off[0], off[1]) < 0.15 and abs(off[2]) < 0.03

    apart = np.hypot(*(looked[:, 1:3] - peak.T_grid_points[:2]).T) > 0.9
    rival = looked[apart, 0].max() if apart.any() else 0.0
    if rival < 0.8 * peak.score:
        assert peak.rival <= RIVAL[0] * peak.score + 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_blocks_of_many_turns_lose_nothing(seed: int) -> None:
    """Against every turn and offset, wide windows, points at the same cells: to the last digit."""
    rng = np.random.default_rng(seed)
    grid = likelihood_grid(room(rng), 0.2, 0.2, 30.0, 7)
    points = rng.uniform(-1.0, 1.0, (40, 2)) * rng.choice([0.5, 3.0, 6.0])
    turns, half = rng.integers(1, 90), rng.integers(1, [60, 40])
    step_rad = 0.2 / np.hypot(*points.T).max() * rng.choice([0.3, 0.9, 1.6])
    yaws = np.arange(turns) * step_rad
    cells = _cells(grid, points, NOTHING[:2], yaws)
    shift = float(np.hypot(*points.T).max()) * step_rad / grid.resolution_m

    total = np.zeros((turns, 2 * half[0] + 1, 2 * half[1] + 1))
    padded = np.pad(grid.levels[0], ((half[1], half[1]), (half[0], half[0])))
    for turn in range(turns):
        for r, c in cells[turn]:
            total[turn] += padded[r : r + 2 * half[1] + 1, c : c + 2 * half[0] + 1].T
    most = total.max() / (255.0 * len(points))

    best, score = best_offset(grid.levels, cells, half, 0.0, NO_POSES, shift)
    assert score == most and total[best[0], best[1] + half[0], best[2] + half[1]] == total.max()
    assert best_offset(grid.levels, cells, half, most + 1e-6, NO_POSES, shift)[1] == 0.0
    # The best pose left out, with all around it: the best of the others.
    around = np.array([[*best, 3, 5, 10_000]])
    a, x, y = np.ogrid[:turns, -half[0] : half[0] + 1, -half[1] : half[1] + 1]
    near = (abs(a - best[0]) <= 3) & (abs(x - best[1]) <= 5) & (abs(y - best[2]) <= 5)
    second = best_offset(grid.levels, cells, half, 0.0, around, shift)[1]
    assert second == np.where(near, 0.0, total).max() / (255.0 * len(points))


def test_the_bound_of_a_block_is_never_below_a_pose_in_it() -> None:
    rng = np.random.default_rng(3)
    grid = likelihood_grid(room(rng), 0.1, 0.1, 30.0)
    rows, columns = grid.levels.shape[1:]
    for level in range(1, len(grid.levels)):
        size = 1 << level
        for _ in range(200):
            r, c = rng.integers(0, rows - size), rng.integers(0, columns - size)
            block = grid.levels[0][r : r + size, c : c + size]
            assert grid.levels[level][r, c] == block.max()


def test_the_likelihood_is_one_on_a_surface_and_falls_as_a_bell() -> None:
    grid = likelihood_grid(np.array([[0.05, 0.05], [2.05, 0.05]]), 0.1, 0.1, 30.0)
    at = np.array([[0.05, 0.05, 0.0], [0.15, 0.05, 0.0], [0.25, 0.05, 0.0], [1.05, 0.05, 0.0]])
    expected = np.exp(-0.5 * np.square([0.0, 1.0, 2.0, 10.0]))
    assert np.allclose(scores(grid, np.zeros((1, 2)), at), expected, atol=0.01)


def test_two_places_alike_are_told_to_be_two() -> None:
    """A corridor with doors every two metres looks the same two metres on."""
    along = np.arange(-12.0, 12.0, 0.1)
    walls = np.concatenate([np.column_stack([along, np.full(along.size, y)]) for y in (-1.0, 1.0)])
    walls = walls[(walls[:, 0] % 2.0) < 1.4]
    grid = likelihood_grid(walls, 0.1, 0.1, 30.0)
    seen = walls[np.abs(walls[:, 0]) < 5.0]
    narrow = search(grid, seen, NOTHING, Window(0.4, 0.4, 0.1), 0.3, RIVAL)
    wide = search(grid, seen, NOTHING, Window(3.0, 0.4, 0.1), 0.3, RIVAL)
    assert narrow is not None and narrow.rival <= RIVAL[0] * narrow.score + 1e-9
    assert wide is not None and wide.rival > 0.95 * wide.score


def test_nothing_is_found_where_nothing_fits() -> None:
    rng = np.random.default_rng(5)
    grid = likelihood_grid(room(rng), 0.1, 0.1, 30.0)
    strange = rng.uniform(-8.0, 8.0, (200, 2))
    assert search(grid, strange, NOTHING, Window(1.0, 1.0, 0.3), 0.6, RIVAL) is None


def test_points_outside_the_grid_and_empty_submaps_are_no_trouble() -> None:
    empty = likelihood_grid(np.zeros((0, 2)), 0.1, 0.1, 30.0)
    far = np.array([[1e4, -1e4], [-1e4, 1e4]])
    assert search(empty, far, NOTHING, Window(0.5, 0.5, 0.1), 0.5, RIVAL) is None
    assert np.array_equal(scores(empty, far, np.zeros((1, 3))), [0.0])


def test_surfaces_beyond_the_radius_are_left_out() -> None:
    near, far = np.array([[1.0, 0.0]]), np.array([[50.0, 0.0]])
    grid = likelihood_grid(np.concatenate([near, far]), 0.1, 0.1, 20.0)
    assert grid.levels.shape[2] < 200


@pytest.mark.parametrize("yaw_rad", [0.0, 1.5, np.pi - 0.02, np.pi, -np.pi + 0.02])
def test_a_place_does_not_rival_itself_where_the_circle_of_turns_closes(yaw_rad: float) -> None:
    rng = np.random.default_rng(5)
    walls = room(rng)
    walls = np.concatenate([walls[walls[:, 0] > -2.0], 0.1 * rng.normal(size=(80, 2)) + [3.0, 2.0]])
    grid = likelihood_grid(walls, 0.1, 0.1, 30.0)
    T_room_points = np.array([0.2, -0.1, yaw_rad])
    points = transform_points(inverse(T_room_points), walls[::4])
    peak = search(grid, points, NOTHING, Window(1.0, 1.0, np.pi), 0.1, RIVAL)
    assert peak is not None and peak.rival <= RIVAL[0] * peak.score + 1e-9
    off = between(T_room_points, peak.T_grid_points)
    assert np.hypot(off[0], off[1]) < 0.15 and abs(off[2]) < 0.03
