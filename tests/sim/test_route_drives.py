"""Random goals, stops and turns on the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from drive_worlds import hall, line_of, walls_around, world_of
from hypothesis import example, given, settings
from hypothesis import strategies as st

from slamsim.config.bundled import bundled_names
from slamsim.config.drive import DriveConfig, FollowConfig, RouteConfig, StopsConfig
from slamsim.config.layout import MazeLayout
from slamsim.config.loading import load_run_config
from slamsim.config.robot import RobotConfig
from slamsim.config.world import WorldConfig
from slamsim.guard.errors import InputRefused
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world
from slamsim.world.model import World

ROBOT = build_robot(RobotConfig())
BLOCK = (-0.3, -0.3, 0.3, 0.3, 0.5)


def _room() -> World:
    visits = [(1.5, 1.5), (1.5, -1.5), (-1.5, -1.5)]
    return world_of([*walls_around(-2, -2, 2, 2), BLOCK], visits, start=(-1.5, 1.5, 0.0))


def _goals(seed: int | None = None, **limits: float) -> DriveConfig:
    return DriveConfig(route=RouteConfig(kind="random_goals", seed=seed, **limits))  # type: ignore[arg-type]


def _same(one: Route, other: Route) -> bool:
    return line_of(one).shape == line_of(other).shape and bool(
        np.all(line_of(one) == line_of(other))
    )


@settings(max_examples=8)
@given(st.integers(0, 10_000), st.integers(0, 10_000))
@example(2895, 0)
def test_random_goals_keep_clear_of_walls_and_join(world_seed: int, seed: int) -> None:
    world = build_world(WorldConfig(maze=MazeLayout(rows=3, columns=3)), world_seed)
    route = plan_route(world, ROBOT, _goals(seed, max_duration_s=60.0))
    line = line_of(route)
    prisms = world.solids.prisms  # type: ignore[attr-defined]
    low = [prism.footprint for prism in prisms if prism.z_min_m <= ROBOT.height_m]  # not table tops
    solid = shapely.union_all(low)
    room_m = shapely.distance(solid, shapely.points(line))
    assert room_m.min() > ROBOT.footprint_radius_m + 0.02
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() < 0.05
    np.testing.assert_allclose(line[0], world.start_pose[:2], atol=0.05)
    assert route.duration_estimate_s > 60.0


def test_goals_depend_on_the_seed_of_the_route_else_on_the_worlds() -> None:
    world = _room()
    one, same, other = (
        plan_route(world, ROBOT, _goals(seed, max_duration_s=30.0)) for seed in (0, None, 1)
    )
    assert _same(one, same)
    assert not _same(one, other)


def test_a_longer_drive_begins_as_the_shorter_one() -> None:
    short, long = (
        line_of(plan_route(_room(), ROBOT, _goals(5, max_path_length_m=length)))
        for length in (5.0, 12.0)
    )
    # The last bend of the shorter way knows nothing of what comes after it.
    assert len(long) > 2 * len(short)
    np.testing.assert_allclose(short[:80], long[:80], atol=1e-9)


def test_without_a_limit_there_are_as_many_goals_as_places_to_visit() -> None:
    length_m = plan_route(_room(), ROBOT, _goals(3)).length_m
    assert 1.0 < length_m < 4 * 8.0


def test_stops_are_as_far_apart_as_asked_for() -> None:
    config = DriveConfig(stops=StopsConfig(every_m=1.0, rest_s=(1.0, 2.0), turn_deg=90.0))
    world = hall(visits=[(5.0, 0.0), (-5.0, 0.0)])
    legs = plan_route(world, ROBOT, config).legs
    stops = [leg for leg in legs if leg.rest_s > 0.0]
    assert 12 <= len(stops) <= 30  # about 20 m of path
    for leg in stops:
        assert 0.2 < leg.length_m() < 1.55
        assert 1.0 <= leg.rest_s <= 2.0
        assert leg.speeds_m_s[-1] == 0.0
        assert leg.end_yaw_rad is not None
        turned = np.remainder(leg.end_yaw_rad - leg.heading_rad() + np.pi, 2 * np.pi) - np.pi
        assert abs(turned) <= np.pi / 2 + 1e-9
    plain = plan_route(world, ROBOT, DriveConfig())
    np.testing.assert_allclose(
        sum(leg.length_m() for leg in legs), sum(leg.length_m() for leg in plain.legs), atol=1e-6
    )


@settings(max_examples=30)
@given(st.floats(0.5, 4.0), st.integers(0, 1000))
def test_stops_cut_any_way_into_whole_pieces(every_m: float, seed: int) -> None:
    route = RouteConfig(kind="random_goals", seed=seed, max_path_length_m=6.0)
    config = DriveConfig(route=route, stops=StopsConfig(every_m=every_m, turn_deg=30.0))
    legs = plan_route(_room(), ROBOT, config).legs
    assert legs
    for leg in legs:
        assert len(leg.points_m) == len(leg.speeds_m_s) >= 2
        assert leg.length_m() > 0.0


def test_the_robot_stands_and_turns_at_its_stops() -> None:
    stops = StopsConfig(every_m=1.0, rest_s=(1.0, 1.0), turn_deg=120.0)
    follow = FollowConfig(standstill_s=0.1, final_standstill_s=0.1)
    route = RouteConfig(max_path_length_m=4.0)
    config = DriveConfig(stops=stops, follow=follow, route=route)
    run = DriveRun(_room(), ROBOT, plan_route(_room(), ROBOT, config), config)
    windows = list(run)
    assert run.outcome.finished, run.outcome
    path_m = np.concatenate([window.positions_m[:, :2] for window in windows])
    step = config.physics.rate_hz // 2
    still = np.linalg.norm(path_m[step:] - path_m[:-step], axis=1) < 0.01
    stood = np.count_nonzero(np.diff(still.astype(int)) == 1)
    legs = plan_route(_room(), ROBOT, config).legs
    assert stood >= sum(leg.rest_s > 0.0 for leg in legs) >= 2


def test_stops_on_twists_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "route.csv"
    path.write_text("t_s,v_m_s,w_rad_s\n0,0.2,0\n1,0,0\n")
    config = DriveConfig(route=RouteConfig(file=str(path)), stops=StopsConfig(every_m=1.0))
    with pytest.raises(InputRefused, match=r"leave drive\.stops out"):
        plan_route(hall(), ROBOT, config)


def test_every_bundled_drive_is_a_preset() -> None:
    names = bundled_names("configs/drives")
    assert names
    for name in names:
        config = load_run_config("tiny", None, [f"drive={name}"])
        route = plan_route(build_world(config.world, 0), ROBOT, config.drive)
        assert route.length_m > 1.0


@pytest.mark.parametrize("name", bundled_names("configs/drives"))
def test_a_bundled_drive_is_what_its_name_says(name: str) -> None:
    """In the same world: whether it stops, turns on the spot, and differs from seed to seed."""
    routes = []
    for seed in (1, 2):
        given = (f"drive={name}", f"drive.route.seed={seed}", "drive.route.max_duration_s=40")
        config = load_run_config("tiny", None, given, 1)
        world, robot = build_world(config.world, 1), build_robot(config.robot)
        routes.append(plan_route(world, robot, config.drive))
    rests = [leg.rest_s for leg in routes[0].legs[:-1] if leg.rest_s > 0.0]
    turns = [leg for leg in routes[0].legs[:-1] if leg.end_yaw_rad is not None]
    assert (len(rests) >= 3 and min(rests) >= 0.5) == (name == "stop_and_go")
    assert (len(turns) >= 3) == (name == "fast_turns")
    assert (config.drive.limits.max_yaw_rate_rad_s > 2.5) == (name == "fast_turns")
    assert _same(*routes) == (name == "tour")
