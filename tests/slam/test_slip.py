"""Wheels that slip, stand or spin: noticed, sized, told, and not believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import Simulated, ate_rmse_m, labyrinth, noisy_wheels, simulate

from slamsim.config.slam import FrontEndConfig, MotionConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import Event
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.models.differential_drive import Reading
from slamsim.slam.frontend.motion import Increments, Odometry, log_odometry
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.frontend.prediction import Predictor
from slamsim.slam.frontend.slip import OPENED_M, WINDOW_S, Look, SlipWatch, coasted
from slamsim.slam.matching.base import Match

STEP_NS = 100_000_000
SURE = np.square([0.001, 0.001, 0.0005])


def look(number: int, wheels: FloatArray, turn_rad: float = 0.0, path_m: float = 0.05) -> Look:
    return Look(
        number * STEP_NS, (number + 1) * STEP_NS, wheels, np.zeros(3), SURE, turn_rad, 1e-6, path_m
    )


def seen(errors_m: list[float], turn_rad: float = 0.0, path_m: float = 0.05) -> SlipWatch:
    watch = SlipWatch()
    for number, error_m in enumerate(errors_m):
        watch.see(look(number, np.array([error_m, 0.0, 0.0]), turn_rad, path_m))
    return watch


def test_small_errors_are_no_slip_and_change_nothing() -> None:
    watch = SlipWatch()
    noise = np.random.default_rng(0).normal(size=(500, 3)) * np.sqrt(SURE)
    doubts = [watch.see(look(n, error)) for n, error in enumerate(noise)]
    assert not np.any(doubts)
    assert watch.events() == ()


def test_one_bad_step_that_the_next_takes_back_is_no_event() -> None:
    assert seen([0.0] * 10 + [0.3, -0.3] + [0.0] * 20).events() == ()


def test_wheels_that_spin_are_told_with_their_time_and_size() -> None:
    (event,) = seen([0.0] * 20 + [-0.04] * 10 + [0.0] * 20).events()
    assert event.kind == "slip"
    assert event.start_ns == pytest.approx(20 * STEP_NS, abs=STEP_NS)
    assert event.end_ns == pytest.approx(30 * STEP_NS, abs=WINDOW_S * 1e9 + STEP_NS)
    assert event.words == "the wheels rolled 0.40 m farther than the robot moved"


def test_a_robot_that_is_pushed_is_told_so() -> None:
    (event,) = seen([0.0] * 10 + [0.03] * 10 + [0.0] * 20, path_m=0.0).events()
    assert event.words == "the robot was moved 0.30 m while its wheels stood"


def test_wheels_that_contradict_the_gyroscope_are_told_without_any_match() -> None:
    watch, nothing = SlipWatch(), np.full(3, np.nan)
    doubts = [
        watch.see(replace(look(n, nothing), coast=nothing, turn_rad=0.05 if 10 <= n < 20 else 0.0))
        for n in range(40)
    ]
    (event,) = watch.events()
    assert event.words == "turns by the wheels and by the gyroscope differ by 29 degrees"
    assert doubts[15][0] == OPENED_M**2 and doubts[15][2] == 0.0
    assert not np.any(doubts[-1])


@pytest.mark.parametrize(("gyro_rad", "matched"), [(0.0, False), (0.05, False), (0.0, True)])
def test_where_wheels_contradict_the_gyroscope_a_lost_scan_may_be_far_from_the_odometry(
    gyro_rad: float, matched: bool
) -> None:
    """A wheel spins beside a wall: the next scan must not be taken for that of another place."""
    stamps_ns = np.arange(21) * STEP_NS
    steps = np.tile([0.05, 0.0, 0.05, gyro_rad], (20, 1))
    odometry = Odometry(Increments(stamps_ns, steps), Reading(0.001, 0.001, 0.0005, 0.0005))
    predictor = Predictor(MotionConfig(), odometry)
    for stamp_ns in stamps_ns:
        prediction = predictor.predict(int(stamp_ns))
        match = Match(prediction.T_map_base, 1e6 * np.eye(3), 1.0, 1.0, np.zeros((0, 3)))
        predictor.update(prediction, match if matched else None)
    sigma_m = np.sqrt(predictor.covariance[0, 0])
    assert (sigma_m > OPENED_M) == (gyro_rad == 0.0 and not matched)


def test_constant_velocity_is_taken_only_while_it_does_better() -> None:
    assert seen([0.0] * 10 + [-0.04] * 10).coasting
    assert not seen([0.0] * 10 + [-0.04] * 10 + [0.0] * 10).coasting
    watch = SlipWatch()
    for number in range(10):
        error = np.array([-0.04, 0.0, 0.0])
        watch.see(replace(look(number, error), coast=error))
    assert not watch.coasting


def test_coasting_keeps_the_turn_of_the_gyroscope() -> None:
    velocity = np.array([0.5, 0.0, 1.0])
    wheels = np.array([3.0, 0.0, 0.2])
    turned = coasted(wheels, velocity, 0.1, gyro=True)
    assert turned[2] == 0.2
    assert np.hypot(turned[0], turned[1]) == pytest.approx(0.05)
    np.testing.assert_allclose(coasted(wheels, velocity, 0.1, gyro=False), velocity * 0.1)


@pytest.fixture(scope="module")
def driven() -> Simulated:
    walls, tour = labyrinth(0)
    return simulate(walls, tour, seed=0, max_s=30.0)


def with_fault(driven: Simulated, kind: str) -> PlanarTrajectory:
    """The wheels of the drive, wrong between 15 and 16.5 s."""
    wheels = noisy_wheels(driven.truth, 0)
    step = between(wheels.poses[:-1], wheels.poses[1:])
    wrong = (wheels.stamps_ns[1:] > 15e9) & (wheels.stamps_ns[1:] <= 16.5e9)
    if kind == "spin":
        step[wrong, 0] += 0.4 / np.count_nonzero(wrong)
    else:
        step[wrong] = 0.0
    poses = [wheels.poses[0]]
    for one in step:
        poses.append(compose(poses[-1], one))
    return PlanarTrajectory(wheels.stamps_ns, np.array(poses))


@pytest.mark.parametrize("kind", ["spin", "frozen"])
@pytest.mark.parametrize("gyro", [True, False])
def test_the_way_is_kept_through_slip(driven: Simulated, kind: str, gyro: bool) -> None:
    log = replace(driven.log, odometry=with_fault(driven, kind))
    if not gyro:
        log = replace(log, imu=None, T_base_imu=None)
    front_end = FrontEnd(FrontEndConfig(), log_odometry(log), log.T_base_laser)
    tracked = [one for scan in log.scans if (one := front_end.step(scan)) is not None]
    stamps_ns = np.array([one.stamp_ns for one in tracked])
    path = PlanarTrajectory(stamps_ns, np.array([one.T_map_base for one in tracked]))
    assert ate_rmse_m(path, driven.truth) < 0.02
    slips: list[Event] = [event for event in front_end.events() if event.kind == "slip"]
    assert len(slips) == 1
    assert 14.0e9 < slips[0].start_ns < 15.5e9 and 16.0e9 < slips[0].end_ns < 18.0e9
    opened = [one.stamp_ns for one in tracked if one.odometry and one.odometry.doubt.any()]
    assert opened and min(opened) > 14.5e9 and max(opened) < 18.0e9
