"""A drive as others see it: windows, stamps, endings, the same every time."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drive_worlds import hall, walls_around, world_of

from slamsim.config.drive import (
    DriveConfig,
    FollowConfig,
    LimitsConfig,
    PhysicsConfig,
    RouteConfig,
)
from slamsim.config.robot import CylinderConfig, RobotConfig
from slamsim.core.types import Drive, TriangleMesh
from slamsim.sim.bullet import pybullet
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.record import START_NS, stamps_ns
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveOutcome, DriveRun, bare_step_seconds
from slamsim.sim.engine import engine_parameters
from slamsim.sim.robot.model import build_robot
from slamsim.world.model import FloorPatch, World

ROBOT = build_robot(RobotConfig())
QUICK = FollowConfig(standstill_s=0.5, final_standstill_s=0.5, stuck_after_s=1.5)
COLUMNS = tuple(Drive.__dataclass_fields__)


def _small_world(**kwargs: object) -> World:
    blocks = [*walls_around(-1.5, -1.5, 1.5, 1.5), (-0.2, -0.2, 0.2, 0.2, 0.5)]
    visits = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
    return world_of(blocks, visits, start=(-1.0, 1.0, 0.0), **kwargs)  # type: ignore[arg-type]


def _windows(
    world: World, config: DriveConfig, route: Route | None = None
) -> tuple[list[Drive], DriveOutcome]:
    run = DriveRun(world, ROBOT, route or plan_route(world, ROBOT, config), config)
    windows = list(run)
    return windows, run.outcome


@cache
def _tour() -> tuple[list[Drive], DriveOutcome]:
    """All of the small world, in windows of the usual length; only to be looked at."""
    return _windows(_small_world(), DriveConfig(follow=QUICK))


def _column(windows: list[Drive], name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.concatenate([getattr(window, name) for window in windows])


def _digest(windows: list[Drive]) -> str:
    return hashlib.sha256(b"".join(_column(windows, n).tobytes() for n in COLUMNS)).hexdigest()


def _twists(folder: Path, *rows: str) -> RouteConfig:
    path = folder / "route.csv"
    path.write_text("\n".join(["t_s,v_m_s,w_rad_s", *rows]))
    return RouteConfig(file=str(path))


def test_a_tour_is_driven_to_its_end_without_touching_a_wall() -> None:
    world, (windows, outcome) = _small_world(), _tour()
    assert outcome.finished, outcome
    assert not _column(windows, "wall_contact").any()
    path = _column(windows, "positions_m")[:, :2]
    for place in [*world.visit_points_m, world.start_pose[:2]]:
        assert np.linalg.norm(path - place, axis=1).min() < 0.35
    assert np.linalg.norm(path[-1] - world.start_pose[:2]) < 0.1
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert outcome.path_length_m == pytest.approx(length, rel=1e-9)
    assert outcome.duration_s == pytest.approx(len(path) / 240.0)


def test_windows_follow_one_another_without_gap_or_overlap_whatever_their_length() -> None:
    short = DriveConfig(follow=QUICK, physics=PhysicsConfig(window_s=0.33))
    both = {DriveConfig().physics.window_s: _tour()[0], 0.33: _windows(_small_world(), short)[0]}
    for window_s, windows in both.items():
        stamps = _column(windows, "stamps_ns")
        steps = np.arange(len(stamps))
        expected = [START_NS + round(k * 1e9 / 240) for k in steps[:1000].tolist()]
        assert stamps[:1000].tolist() == expected
        np.testing.assert_array_equal(stamps, stamps_ns(0, len(steps), 240))
        assert all(len(window) <= round(window_s * 240) + 6 for window in windows)
    assert len(set(map(_digest, both.values()))) == 1


def test_stamps_are_exact_after_days() -> None:
    first = 240 * 86_400 * 30
    exact = [START_NS + (k * 10**9 + 120) // 240 for k in range(first, first + 7)]
    assert stamps_ns(first, 7, 240).tolist() == exact


def test_the_same_drive_twice_to_the_last_bit() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK)
    route = plan_route(world, ROBOT, config)
    run = DriveRun(world, ROBOT, route, config)
    first, second = _digest(list(run)), _digest(list(run))
    assert first == second == _digest(_tour()[0])


@pytest.mark.long
def test_a_drive_is_not_disturbed_by_another_one_beside_it() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK, physics=PhysicsConfig(window_s=1.0))
    route = plan_route(world, ROBOT, config)
    beside = iter(DriveRun(hall(), ROBOT, route, config))
    together = []
    for window in DriveRun(world, ROBOT, route, config):
        together.append(window)
        next(beside, None)
    assert _digest(together) == _digest(_tour()[0])


def test_a_drive_given_up_half_way_leaves_no_engine_behind() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK, physics=PhysicsConfig(window_s=0.5))
    route = plan_route(world, ROBOT, config)
    for _ in range(3):
        windows = iter(DriveRun(world, ROBOT, route, config))
        next(windows)
        windows.close()  # type: ignore[attr-defined]
    probe = pybullet.connect(pybullet.DIRECT)
    pybullet.disconnect(probe)
    assert probe == 0


def test_the_outcome_is_not_known_before_the_end() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK)
    run = DriveRun(world, ROBOT, plan_route(world, ROBOT, config), config)
    with pytest.raises(RuntimeError, match="last window"):
        _ = run.outcome


def test_a_largest_duration_ends_in_a_standstill() -> None:
    config = DriveConfig(follow=QUICK, route=RouteConfig(max_duration_s=6.0))
    windows, outcome = _windows(_small_world(), config)
    assert outcome.finished
    assert "max_duration_s" in outcome.reason
    assert 4.0 < outcome.duration_s <= 6.0
    speed = np.linalg.norm(_column(windows, "linear_velocity_m_s")[-60:], axis=1)
    assert speed.max() < 1e-3


def test_the_drive_begins_and_ends_standing() -> None:
    windows, _ = _tour()
    speed = np.linalg.norm(_column(windows, "linear_velocity_m_s"), axis=1)
    assert speed[:120].max() < 1e-3
    assert speed[-115:].max() < 1e-3


def test_progress_is_told_in_seconds() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK, physics=PhysicsConfig(window_s=2.0))
    told = list[tuple[float, float]]()
    route = plan_route(world, ROBOT, config)
    run = DriveRun(world, ROBOT, route, config, lambda done, total: told.append((done, total)))
    list(run)
    assert told[0][0] == pytest.approx(2.0)
    assert told[-1] == (run.outcome.duration_s, run.outcome.duration_s)
    assert all(done <= total for done, total in told)
    assert route.duration_estimate_s == pytest.approx(run.outcome.duration_s, rel=0.25)


def test_a_robot_that_drives_against_a_wall_is_stuck_and_told_so(tmp_path: Path) -> None:
    config = DriveConfig(follow=QUICK, route=_twists(tmp_path, "0,0.3,0", "60,0,0"))
    windows, outcome = _windows(_small_world(), config)
    assert not outcome.finished
    assert "stuck at" in outcome.reason
    assert "0.30 m/s" in outcome.reason
    assert outcome.duration_s < 30.0
    assert _column(windows, "wall_contact").any()
    assert len(_column(windows, "stamps_ns")) == round(outcome.duration_s * 240)


def test_a_robot_on_ice_tries_again_before_it_gives_up() -> None:
    ice = FloorPatch(-2.0, -2.0, 2.0, 2.0, 0.0)
    config = DriveConfig(follow=QUICK)
    windows, outcome = _windows(_small_world(patches=[ice]), config)
    assert not outcome.finished
    assert "stuck" in outcome.reason
    assert _column(windows, "commands")[:, 0].min() < -0.1


def test_a_blocked_robot_backs_up_as_often_as_configured_and_then_gives_up() -> None:
    """A wall that the plan does not know of."""
    world = _small_world()
    config = DriveConfig(follow=QUICK)
    route = plan_route(world, ROBOT, config)
    blocked = world_of(
        [*walls_around(-1.5, -1.5, 1.5, 1.5), (0.3, 0.6, 0.4, 1.5, 0.5)],
        start=(-1.0, 1.0, 0.0),
    )
    windows, outcome = _windows(blocked, config, route)
    assert not outcome.finished
    assert "stuck" in outcome.reason
    commands = _column(windows, "commands")[:, 0]
    backed_up = np.flatnonzero(np.diff((commands < -0.1).astype(int)) == 1)
    assert len(backed_up) == config.follow.max_recoveries


def test_a_robot_that_tips_over_is_told_so(tmp_path: Path) -> None:
    """Top-heavy and braking hard, it falls on its face."""
    mast = CylinderConfig(radius_m=0.05, height_m=0.3, mass_kg=20.0, bottom_z_m=1.2)
    robot = build_robot(RobotConfig(weight=mast))
    config = DriveConfig(
        follow=QUICK,
        limits=LimitsConfig(max_speed_m_s=1.5, max_acceleration_m_s2=20.0),
        route=_twists(tmp_path, "0,1.5,0", "1.5,0,0", "8,0,0"),
    )
    world = hall()
    run = DriveRun(world, robot, plan_route(world, robot, config), config)
    windows = list(run)
    assert not run.outcome.finished
    assert "tipped over" in run.outcome.reason
    assert "max_tilt_deg is 35" in run.outcome.reason
    assert np.isfinite(_column(windows, "positions_m")).all()


def test_physics_that_fails_ends_the_drive_with_what_was_driven(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config = DriveConfig(follow=QUICK, route=_twists(tmp_path, "0,0.2,0", "5,0,0"))
    world = hall()
    run = DriveRun(world, ROBOT, plan_route(world, ROBOT, config), config)
    step, count = pybullet.stepSimulation, 0

    def failing(client: int) -> None:
        nonlocal count
        count += 1
        if count == 500:
            body, force = pybullet.getNumBodies(client) - 1, [math.nan] * 3
            pybullet.applyExternalForce(body, -1, force, [0, 0, 0], pybullet.WORLD_FRAME, client)
        step(client)

    monkeypatch.setattr(pybullet, "stepSimulation", failing)
    windows = list(run)
    assert not run.outcome.finished
    assert "not a number" in run.outcome.reason
    assert 300 < len(_column(windows, "stamps_ns")) <= 500
    assert np.isfinite(_column(windows, "positions_m")).all()


def test_engine_parameters_tell_what_a_result_depends_on() -> None:
    parameters = engine_parameters(PhysicsConfig(rate_hz=500, solver_iterations=33))
    assert parameters["fixedTimeStep"] == pytest.approx(0.002)
    assert parameters["numSolverIterations"] == 33
    assert parameters["friction_combination"] == "product"


def test_the_yardstick_measures_time() -> None:
    assert 0.0 < bare_step_seconds(_small_world(), ROBOT, PhysicsConfig(), 1.0) < 10.0


def test_walls_in_many_pieces_hold_the_robot_like_walls_in_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A mesh beyond the engine's buffer is cut; without the cut, PyBullet would lose walls."""
    monkeypatch.setattr("slamsim.sim.engine.MESH_CHUNK_TRIANGLES", 3)
    config = DriveConfig(follow=QUICK, route=_twists(tmp_path, "0,0.3,0", "60,0,0"))
    windows, outcome = _windows(_small_world(), config)
    assert "stuck" in outcome.reason
    assert _column(windows, "positions_m")[:, 0].max() < 1.5 - 0.17


def test_a_floor_within_the_mesh_does_not_disturb_the_robot() -> None:
    world, config = _small_world(), DriveConfig(follow=QUICK)
    corners = np.array([[-2.0, -2.0, 0.0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    first = len(world.mesh.vertices_m)
    with_floor = replace(
        world,
        mesh=TriangleMesh(
            np.vstack([world.mesh.vertices_m, corners]),
            np.vstack([world.mesh.triangles, [[first, first + 1, first + 2]]]).astype(np.int32),
        ),
    )
    windows, outcome = _windows(with_floor, config)
    assert outcome.finished
    assert not _column(windows, "wall_contact").any()
