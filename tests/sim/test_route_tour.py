"""Planning on the true map: clearance, ways, order of the visits."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from drive_worlds import hall, line_of, walls_around, world_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csgraph, csr_array
from scipy.spatial import cKDTree

from slamsim.config.drive import DriveConfig, LimitsConfig, RouteConfig
from slamsim.config.layout import MazeLayout
from slamsim.config.robot import RobotConfig
from slamsim.config.world import WorldConfig
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.sim.drive.legs import curvature_1_m, speed_profile
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.smooth import resample, smooth_path
from slamsim.sim.drive.space import Space, connect_places, free_space, narrowest_on_the_way_m
from slamsim.sim.drive.tour import closed_tour, tour_length
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world
from slamsim.world.model import World

ROBOT = build_robot(RobotConfig())
NEEDED_M = ROBOT.footprint_radius_m + RouteConfig().clearance_m


def _distance_to_blocks_m(world: World, points_m: FloatArray) -> FloatArray:
    """(n,) exact distance to the nearest solid, by shapely: the oracle."""
    import shapely

    solid = shapely.union_all([prism.footprint for prism in world.solids.prisms])  # type: ignore[attr-defined]
    return np.asarray(shapely.distance(solid, shapely.points(points_m)))


@settings(max_examples=8)
@given(st.integers(0, 10_000), st.sampled_from(["backtracker", "wilson", "kruskal"]))
def test_a_tour_passes_everywhere_with_room_and_comes_back(seed: int, algorithm: str) -> None:
    layout = MazeLayout(rows=4, columns=4, algorithm=algorithm)  # type: ignore[arg-type]
    world = build_world(WorldConfig(maze=layout), seed)
    route = plan_route(world, ROBOT, DriveConfig())
    line = line_of(route)
    assert np.max(cKDTree(line).query(world.visit_points_m)[0]) < 0.4
    np.testing.assert_allclose(line[[0, -1]], [world.start_pose[:2]] * 2, atol=0.05)
    joints = [
        np.linalg.norm(a.points_m[-1] - b.points_m[0])
        for a, b in zip(route.legs[:-1], route.legs[1:], strict=True)
    ]
    assert max(joints, default=0.0) < 1e-6
    room_m = _distance_to_blocks_m(world, line)
    assert room_m.min() > ROBOT.footprint_radius_m + 0.02


def test_the_path_keeps_to_the_middle_where_there_is_room() -> None:
    world = world_of(walls_around(0, 0, 10, 2), [(9.0, 1.0)], start=(1.0, 1.0, 0.0))
    line = line_of(plan_route(world, ROBOT, DriveConfig()))
    assert np.abs(line[:, 1] - 1.0).max() < 0.05


def test_a_dead_end_is_left_backwards_only_after_a_turn() -> None:
    world = world_of(walls_around(0, 0, 10, 2), [(9.0, 1.0)], start=(1.0, 1.0, 0.0))
    route = plan_route(world, ROBOT, DriveConfig())
    assert len(route.legs) == 2
    assert all(leg.speeds_m_s[-1] == 0.0 for leg in route.legs)


def test_a_passage_that_is_too_narrow_is_refused_with_the_widths() -> None:
    blocks = [*walls_around(0, 0, 6, 3), (2.9, 0.0, 3.0, 1.3, 0.5), (2.9, 1.6, 3.0, 3.0, 0.5)]
    world = world_of(blocks, [(5.0, 1.5)], start=(1.0, 1.5, 0.0))
    with pytest.raises(SlamsimError, match=r"narrows to 0\.2\d m, .* need 0\.45 m"):
        plan_route(world, ROBOT, DriveConfig())


@settings(max_examples=10)
@given(st.floats(0.0, 0.04), st.floats(0.04, 0.1))
def test_a_way_that_the_world_promises_is_found_however_cells_lie(
    shift_m: float, spare_m: float
) -> None:
    wide_m = 2.0 * NEEDED_M + spare_m
    low_m, high_m = 1.2 + shift_m, 1.2 + shift_m + wide_m
    blocks = [*walls_around(0, 0, 6, 3), (2.0, 0.0, 3.0, low_m, 0.5), (2.0, high_m, 3.0, 3.0, 0.5)]
    world = replace(world_of(blocks, [(5.0, 1.5)], start=(1.0, 1.5, 0.0)), clearance_m=wide_m)
    route = plan_route(world, ROBOT, DriveConfig())
    assert _distance_to_blocks_m(world, line_of(route)).min() >= NEEDED_M - 1e-6


def test_a_start_without_room_is_refused() -> None:
    world = world_of(walls_around(0, 0, 6, 3), [(5.0, 1.5)], start=(0.1, 1.5, 0.0))
    with pytest.raises(SlamsimError, match="does not fit at its start"):
        plan_route(world, ROBOT, DriveConfig())


def test_nowhere_to_go_is_said() -> None:
    with pytest.raises(SlamsimError, match="nowhere to go"):
        plan_route(hall(), ROBOT, DriveConfig())


def test_clearance_is_never_promised_beyond_what_there_is() -> None:
    rng = np.random.default_rng(3)
    blocks = walls_around(0, 0, 8, 8)
    for x, y in rng.uniform(1, 7, (12, 2)):
        blocks.append((x, y, x + rng.uniform(0.05, 1), y + rng.uniform(0.05, 1), 0.5))
    world = world_of(blocks, start=(0.5, 0.5, 0.0))
    space = free_space(world, 0.04, NEEDED_M)
    cells = np.argwhere(space.room_m > 0.0)
    points = space.centres_m(cells)
    promised = space.room_m[tuple(cells.T)]
    assert np.all(promised <= _distance_to_blocks_m(world, points) + 0.012)
    np.testing.assert_array_equal(space.cells_of(points), cells)


def test_the_narrowest_place_of_the_widest_way() -> None:
    blocks = [*walls_around(0, 0, 6, 4), (2.9, 0.0, 3.0, 1.0, 0.5), (2.9, 1.8, 3.0, 4.0, 0.5)]
    world = world_of(blocks, start=(1.0, 2.0, 0.0))
    space = free_space(world, 0.02, NEEDED_M)
    narrowest = narrowest_on_the_way_m(space, np.array([1.0, 2.0]), np.array([5.0, 2.0]))
    assert narrowest == pytest.approx(0.4, abs=0.03)


def _open_space(seed: int) -> Space:
    """Random rooms on a coarse grid, all joined to cell (1, 1)."""
    from scipy import ndimage

    rng = np.random.default_rng(seed)
    free = rng.random((24, 24)) > 0.25
    free[0] = free[-1] = free[:, 0] = free[:, -1] = False
    free[1, 1] = True
    labels, _ = ndimage.label(free, structure=np.ones((3, 3)))
    return Space((labels == labels[1, 1]) * 1.0, np.zeros(2), 1.0, 0.5)


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_ways_between_places_against_a_search_from_each(seed: int) -> None:
    """A way of the net may be longer than the best one (it passes by places), never shorter."""
    space = _open_space(seed)
    cells = np.argwhere(space.room_m > 0.0)
    rng = np.random.default_rng(seed + 1)
    if len(cells) < 8:
        return
    chosen = np.vstack([[[1, 1]], cells[rng.choice(len(cells), 5, replace=False)]])
    net = connect_places(space, space.centres_m(chosen), preferred_m=0.0)
    exact = _eight_neighbour_distances(cells, chosen)
    for a in range(len(chosen)):
        for b in range(len(chosen)):
            if a == b:
                continue
            way = np.concatenate(net.cells_between(a, b))
            np.testing.assert_array_equal(way[[0, -1]], chosen[[a, b]])
            steps = np.abs(np.diff(way, axis=0)).max(axis=1)
            assert steps.max(initial=0) <= 1
            assert np.all(space.room_m[tuple(way.T)] > 0.0)
            length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
            assert length >= exact[a, b] - 1e-6
            assert net.lengths[a, b] == pytest.approx(length, abs=1e-6)


def _eight_neighbour_distances(cells: np.ndarray, chosen: np.ndarray) -> FloatArray:
    pairs = np.array(sorted(cKDTree(cells).query_pairs(1.5)))
    lengths = np.linalg.norm(cells[pairs[:, 0]] - cells[pairs[:, 1]], axis=1)
    graph = csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    at = [int(np.flatnonzero((cells == cell).all(axis=1))[0]) for cell in chosen]
    return np.asarray(csgraph.dijkstra(graph, directed=False, indices=at)[:, at])


@settings(max_examples=25)
@given(st.integers(0, 100_000), st.integers(2, 7))
def test_a_tour_against_all_orders(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(0, 10, (count, 2))
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    tour = closed_tour(lengths)
    assert tour[0] == 0
    assert sorted(tour.tolist()) == list(range(count))
    best = min(
        tour_length(lengths, np.array([0, *order])) for order in permutations(range(1, count))
    )
    assert tour_length(lengths, tour) <= 1.1 * best + 1e-9


def test_a_long_tour_is_near_the_known_bound() -> None:
    """Random points in a square: the best tour is about 0.7124 sqrt(n A) (Johnson 1996)."""
    points = np.random.default_rng(5).uniform(0, 1, (300, 2))
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    length = tour_length(lengths, closed_tour(lengths))
    assert length < 1.15 * 0.7124 * np.sqrt(300) * (1 + 0.33 / 300) + 0.5


def test_smoothing_keeps_the_ends_and_the_room() -> None:
    blocks = [*walls_around(0, 0, 4, 4), (0.0, 1.9, 3.2, 2.1, 0.5)]
    space = free_space(world_of(blocks, start=(0.5, 0.5, 0.0)), 0.04, NEEDED_M)
    corner = np.array([[0.5, 1.2], [3.6, 1.2], [3.6, 3.0], [0.5, 3.0]])
    line = smooth_path(corner, space)
    np.testing.assert_allclose(line[[0, -1]], corner[[0, -1]], atol=1e-9)
    assert space.room_at_m(line).min() >= NEEDED_M - 0.021
    assert np.abs(curvature_1_m(line)).max() < np.abs(curvature_1_m(resample(corner))).max() / 3


def test_curvature_of_a_circle() -> None:
    angles = np.arange(0.0, 3.0, 0.025 / 0.8)
    circle = 0.8 * np.column_stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(curvature_1_m(circle)[3:-3], 1.0 / 0.8, rtol=1e-3)
    np.testing.assert_allclose(curvature_1_m(circle[::-1])[3:-3], -1.0 / 0.8, rtol=1e-3)


def test_speeds_allow_for_bends_walls_and_the_stop() -> None:
    limits = LimitsConfig()
    straight = resample(np.array([[0.0, 0.0], [5.0, 0.0]]))
    speeds = speed_profile(straight, None, limits)
    assert speeds[0] == limits.max_speed_m_s
    assert speeds[-1] == 0.0
    braking = -np.diff(speeds**2) / 2 / 0.025
    assert braking.max() <= limits.max_acceleration_m_s2
    angles = np.arange(0.0, 3.0, 0.05)
    bend = 0.5 * np.column_stack([np.cos(angles), np.sin(angles)])
    fastest = speed_profile(bend, None, limits)[5:-40].max()
    assert fastest == pytest.approx(np.sqrt(0.3 * 0.5), rel=0.02)
    corridor = free_space(
        world_of(walls_around(-1, -0.26, 6, 0.26), start=(0.0, 0.0, 0.0)), 0.04, NEEDED_M
    )
    assert speed_profile(straight, corridor, limits)[0] < 0.6 * limits.max_speed_m_s


def test_a_largest_path_length_cuts_the_route() -> None:
    world = build_world(WorldConfig(maze=MazeLayout(rows=4, columns=4)), 1)
    for length in (1.0, 7.3, 20.0):
        config = DriveConfig(route=RouteConfig(max_path_length_m=length))
        route = plan_route(world, ROBOT, config)
        assert length - 0.1 < route.length_m <= length + 0.03
        assert route.legs[-1].speeds_m_s[-1] == 0.0


def test_a_world_too_large_for_the_search_is_refused_with_a_way_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("slamsim.sim.drive.space.MAX_OPEN_CELLS", 1000)
    with pytest.raises(SlamsimError, match=r"make drive\.route\.resolution_m larger"):
        plan_route(hall(visits=[(4.0, 4.0)]), ROBOT, DriveConfig())
