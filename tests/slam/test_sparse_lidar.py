"""Lidars of few beams: scans put together over the motion, and mapped with no worse than wheels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from simulated import ScanList, Simulated, ate_rmse_m, box, labyrinth, simulate

from slamsim.config.slam import FrontEndConfig, SlamConfig
from slamsim.core.geometry import between, transform_points
from slamsim.core.types import Cloud, FloatArray, Scan, ScanGeometry
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.keyframes import KeyframeMaker
from slamsim.slam.frontend.motion import log_odometry
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.frontend.preintegration import OdometryStep
from slamsim.slam.frontend.tracking import Tracked
from slamsim.slam.matching.accumulate import (
    ENOUGH_PIECES,
    MOST_S,
    ScanWindow,
    with_drift,
    worth_waiting,
)
from slamsim.slam.matching.base import Match
from slamsim.slam.matching.surfaces import surface_pieces
from slamsim.slam.session import run_slam

SPARSE = ScanGeometry(-np.pi, np.deg2rad(10.0), 36, 2_777_777, 0.1, 12.0)
WALLS_M = ((0.0, 3.0), (np.pi / 2, 2.0), (np.pi, 2.5), (-np.pi / 2, 1.5))
"""Direction of the normal and distance of the walls of a room, about its origin."""


def room_scan(T_map_base: FloatArray, beams: int = 36, stamp_ns: int = 0) -> Cloud:
    """What a flash scan of the room shows, without noise."""
    angles = T_map_base[2] + np.arange(beams) * 2.0 * np.pi / beams - np.pi
    ranges = np.full(beams, np.inf)
    for normal, distance in WALLS_M:
        along = np.cos(angles - normal)
        to_wall = distance - T_map_base[0] * np.cos(normal) - T_map_base[1] * np.sin(normal)
        met = np.divide(to_wall, along, out=np.full(beams, np.inf), where=along > 1e-6)
        ranges = np.minimum(ranges, met)
    local = angles - T_map_base[2]
    points = ranges[:, None] * np.column_stack([np.cos(local), np.sin(local)])
    return Cloud(stamp_ns, points, np.zeros((beams, 2)), np.ones(beams, dtype=np.bool_))


def off_the_walls_m(points_m: FloatArray) -> FloatArray:
    """(n,) distance of points in the room's frame to the nearest wall."""
    normals = np.array([[np.cos(a), np.sin(a)] for a, _ in WALLS_M])
    distances = np.array([d for _, d in WALLS_M])
    return np.asarray(np.abs(points_m @ normals.T - distances).min(axis=1))


def prediction(
    step: OdometryStep | None, sigmas: tuple[float, float, float] = (0.01, 0.01, 0.002)
) -> Prediction:
    zero, covariance = np.zeros(3), np.diag(np.square(sigmas))
    return Prediction(0, zero, covariance, zero, zero, zero, False, step, covariance)


def step_of(seconds: float) -> OdometryStep:
    return replace(OdometryStep.none(np.zeros(PARAMETERS)), seconds=seconds)


def test_scans_of_a_window_lie_on_the_same_walls_in_the_order_of_their_bearings() -> None:
    window = ScanWindow()
    poses = [np.array([0.1 * k, 0.02 * k, 0.03 * k]) for k in range(5)]
    for k, pose in enumerate(poses):
        cloud = window.add(room_scan(pose, stamp_ns=k), pose)

    assert cloud.stamp_ns == 4 and len(cloud.points_m) == 5 * 36
    np.testing.assert_allclose(
        off_the_walls_m(transform_points(poses[-1], cloud.points_m)), 0.0, atol=1e-9
    )
    assert (np.diff(np.arctan2(cloud.points_m[:, 1], cloud.points_m[:, 0])) >= 0.0).all()
    alone = surface_pieces(room_scan(poses[-1]), 0.01, 0.25, 60.0)
    together = surface_pieces(cloud, 0.01, 0.25, 60.0)
    assert len(together) >= 2 * len(alone)


def test_a_robot_at_rest_sees_the_same_again() -> None:
    window, pose = ScanWindow(), np.zeros(3)
    for k in range(20):
        cloud = window.add(room_scan(pose, stamp_ns=k), pose)
    assert cloud.stamp_ns == 19 and len(cloud.points_m) == 36


def test_a_slow_robot_with_many_scans_comes_to_see_more() -> None:
    window = ScanWindow()
    for k in range(41):
        pose = np.array([0.002 * k, 0.0, 0.0])
        cloud = window.add(room_scan(pose), pose)
    assert 7 * 36 <= len(cloud.points_m) <= 9 * 36


def test_a_window_that_was_matched_is_not_matched_again() -> None:
    window = ScanWindow()
    window.add(room_scan(np.zeros(3)), np.zeros(3))
    window.clear()
    newest = room_scan(np.array([0.2, 0.0, 0.0]))
    assert window.add(newest, np.array([0.2, 0.0, 0.0])) is newest


def test_waiting_ends_with_enough_pieces_time_or_drift() -> None:
    near = prediction(step_of(0.5))
    assert worth_waiting(near, 4)
    assert not worth_waiting(near, ENOUGH_PIECES)
    assert not worth_waiting(prediction(step_of(MOST_S)), 4)
    assert not worth_waiting(prediction(step_of(0.5), (0.05, 0.05, 0.002)), 4)
    assert not worth_waiting(prediction(step_of(0.5), (0.01, 0.01, 0.02)), 4)


def test_without_odometry_nothing_is_put_together() -> None:
    assert not worth_waiting(prediction(None), 4)
    assert not worth_waiting(replace(prediction(step_of(0.5)), jump=True), 4)


def test_a_match_of_several_scans_is_as_unsure_as_their_odometry() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3)) * [40.0, 30.0, 80.0]
    information, pull = root.T @ root, rng.normal(size=3)
    match = Match(np.zeros(3), information, 1.0, 1.0, np.zeros((0, 3)), pull)
    before = prediction(step_of(0.5), (0.02, 0.03, 0.01))

    found = with_drift(match, before)

    wanted = np.linalg.inv(information) + before.step_covariance / 3.0
    np.testing.assert_allclose(found.information, np.linalg.inv(wanted), rtol=1e-9)
    np.testing.assert_allclose(
        np.linalg.solve(found.information, found.pull), np.linalg.solve(information, pull)
    )


def test_a_direction_that_no_wall_holds_stays_unheld() -> None:
    across = np.array([0.0, 1.0, 0.2])
    information = 1e4 * np.outer(across, across)
    match = Match(np.zeros(3), information, 1.0, 1.0, np.eye(3)[:1], np.zeros(3))
    found = with_drift(match, prediction(step_of(0.5)))
    assert np.linalg.matrix_rank(found.information, tol=1e-3) == 1
    assert abs(found.information[0]).max() < 1e-9


@cache
def sparse_drive(gyro: bool) -> Simulated:
    walls, tour = labyrinth(seed=1, cells=4)
    return simulate(walls, tour, seed=1, geometry=SPARSE, gyro=gyro, max_s=70.0)


@cache
def track(simulated: Simulated) -> tuple[list[Tracked], FrontEnd]:
    log = simulated.log
    front_end = FrontEnd(FrontEndConfig(), log_odometry(log), log.T_base_laser)
    steps = [front_end.step(scan) for scan in log.scans]
    return [one for one in steps if one is not None], front_end


def test_every_scan_is_tracked_and_some_are_held_back() -> None:
    tracked, front_end = track(sparse_drive(gyro=True))

    assert len(tracked) == len(sparse_drive(gyro=True).log.scans)
    held = [one for one in tracked if one.held_back]
    assert 0.2 * len(tracked) < len(held) < 0.9 * len(tracked)
    assert all(one.match is None and not one.keyscan and not one.information.any() for one in held)
    assert front_end.restarts == 0 and front_end.warnings() == ()
    assert front_end.events() == ()


def test_steps_from_scan_to_scan_are_those_of_the_odometry() -> None:
    tracked, _ = track(sparse_drive(gyro=True))
    after_rest = [one for one in tracked if one.stamp_ns > 3_000_000_000]
    assert {one.held_back for one in after_rest} == {False, True}
    for before, one in pairwise(after_rest):
        assert one.odometry is not None
        step = between(before.T_odom_base, one.T_odom_base)
        off = between(step, one.odometry.T_first_last)  # the calibration goes on meanwhile
        assert np.hypot(off[0], off[1]) < 0.002 and abs(off[2]) < 0.003


def test_key_frames_are_made_of_scans_that_were_matched() -> None:
    tracked, _ = track(sparse_drive(gyro=True))
    maker = KeyframeMaker(SlamConfig().back_end.keyframes, 60.0)
    made = [(one, maker.make(one)) for one in tracked]
    frames = [frame for _, frame in made if frame is not None]
    assert len(frames) > 20
    assert all(frame is None for one, frame in made if one.held_back)
    for frame in frames[1:]:
        assert frame.odometry is not None and len(frame.view) >= 5


@pytest.mark.long
@pytest.mark.parametrize("gyro", [True, False])
def test_a_labyrinth_is_mapped_with_36_beams(gyro: bool) -> None:
    simulated = sparse_drive(gyro)
    result = run_slam(simulated.log, SlamConfig(calibrate_laser=False))

    wheels_m = ate_rmse_m(result.odometry, simulated.truth)
    assert wheels_m > 0.1
    assert ate_rmse_m(result.trajectory, simulated.truth) < 0.1 * wheels_m
    assert {event.kind for event in result.events} <= {"blind", "slip"}
    assert len(result.trajectory) == len(simulated.log.scans)


def test_scans_that_show_enough_are_matched_at_once() -> None:
    walls, tour = labyrinth(seed=1, cells=4)
    tracked, _ = track(simulate(walls, tour, seed=1, max_s=20.0))
    assert not any(one.held_back for one in tracked)


def test_silence_within_a_window_is_told_as_a_gap() -> None:
    drive = sparse_drive(gyro=True)
    scans = [s for s in drive.log.scans if not 20.0 <= s.stamp_ns * 1e-9 < 24.0]
    _, front_end = track(replace(drive, log=replace(drive.log, scans=ScanList(scans))))
    assert "gap" in {event.kind for event in front_end.events()}


def test_a_map_that_only_odometry_makes_is_said_to_be_no_better() -> None:
    drive = sparse_drive(gyro=True)

    def nearly_blind(scan: Scan) -> Scan:
        ranges_m = np.full_like(scan.ranges_m, np.inf)
        ranges_m[16:20] = scan.ranges_m[16:20]
        return replace(scan, ranges_m=ranges_m)

    first, *others = drive.log.scans
    _, front_end = track(
        replace(drive, log=replace(drive.log, scans=ScanList([first, *map(nearly_blind, others)])))
    )
    (told,) = (event for event in front_end.events() if event.kind == "odometry")
    assert "follow the odometry alone" in told.words
    assert told.end_ns - told.start_ns > 60_000_000_000


@pytest.mark.parametrize("reach_m, said", [(4.0, True), (30.0, False)])
def test_a_corridor_whose_end_is_out_of_reach_is_followed_by_the_wheels(
    reach_m: float, said: bool
) -> None:
    walls = np.concatenate([box(0.0, y, 25.0, y + 0.1) for y in (-1.1, 1.0)])
    ends = np.concatenate([box(x, -1.1, x + 0.1, 1.1) for x in (-0.1, 25.0)])
    lidar = ScanGeometry(-np.pi, np.deg2rad(1.0), 360, 277_777, 0.1, reach_m)
    along = np.array([[6.0, 0.0], [19.0, 0.0]])
    _, front_end = track(simulate(np.concatenate([walls, ends]), along, geometry=lidar))
    told = [event for event in front_end.events() if event.kind == "odometry"]
    assert bool(told) == said
