"""What wheels and gyroscope say of a stretch, against exact truth and finite differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import ScanList, ate_rmse_m, drive, noisy_gyro, noisy_wheels

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import between, compose, matrix_from_rpy, se3_from_parts, wrap_angle
from slamsim.core.result import Calibrated
from slamsim.core.types import EncoderStream, FloatArray, ImuStream, Log, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.models.differential_drive import pose_reading, wheel_odometry
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.motion import NoMotion, Odometry, increments, predict_motion
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep

POINTS = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0], [0.0, 4.0], [3.0, 4.0]])
NOMINAL = np.zeros(PARAMETERS)
SECOND = 1_000_000_000


def _log(
    odometry: PlanarTrajectory | None,
    imu: ImuStream | None = None,
    encoders: EncoderStream | None = None,
    T_base_imu: FloatArray | None = None,
) -> Log:
    return Log("test", "simulation", ScanList([]), odometry, imu, encoders, np.eye(4), T_base_imu)


def _odometry(wheels: PlanarTrajectory, imu: ImuStream | None = None) -> Odometry:
    return Odometry(increments(wheels, imu), pose_reading(wheels))


@cache
def _some_odometry() -> Odometry:
    truth = drive(POINTS)
    wheels = noisy_wheels(truth, 3)
    reading = replace(pose_reading(wheels), track_m=0.28)
    return Odometry(increments(wheels, noisy_gyro(truth, 3)), reading)


def test_without_a_gyroscope_the_wheels_are_taken_as_they_are() -> None:
    wheels = noisy_wheels(drive(POINTS), 0)
    alone = predict_motion(_log(wheels))
    np.testing.assert_array_equal(alone.stamps_ns, wheels.stamps_ns)
    expected = between(wheels.poses[0], wheels.poses)
    np.testing.assert_allclose(wrap_angle(alone.poses - expected), 0.0, atol=1e-9)


def test_a_log_without_any_motion_is_refused() -> None:
    with pytest.raises(NoMotion, match="neither odometry nor wheel encoders"):
        predict_motion(_log(None))


def test_encoders_go_before_odometry_that_was_derived_from_them() -> None:
    ticks = np.array([[0, 0], [100, 120], [220, 230]])
    encoders = EncoderStream(np.array([0, 10**8, 2 * 10**8]), ticks, 1000, 0.035, 0.23)
    wrong = PlanarTrajectory(encoders.stamps_ns, np.full((3, 3), 7.0))
    np.testing.assert_allclose(
        predict_motion(_log(wrong, encoders=encoders)).poses,
        wheel_odometry(encoders).poses,
        atol=1e-12,
    )


def test_perfect_sensors_give_back_the_truth() -> None:
    truth = drive(POINTS)
    perfect = noisy_gyro(truth, 0, bias_rad_s=0.0, noise_rad_s=0.0)
    fused = predict_motion(_log(truth, perfect))
    error = between(between(truth.poses[0], truth.poses), fused.at(truth.stamps_ns))
    assert np.abs(error[:, :2]).max() < 2e-3
    assert np.abs(error[:, 2]).max() < 3e-3


def test_the_gyroscope_takes_the_place_of_a_wrong_track_width() -> None:
    truth = drive(POINTS)
    wheels, imu = noisy_wheels(truth, 1), noisy_gyro(truth, 1)
    known = {
        "gyro_bias_rad_s": Calibrated(0.01, 0.001, True),
        "gyro_scale": Calibrated(1.0, 0.001, True),
    }
    fused = predict_motion(_log(wheels, imu), known)
    assert ate_rmse_m(fused, truth) < 0.3 * ate_rmse_m(wheels, truth)


def test_an_imu_mounted_upside_down_says_the_same() -> None:
    truth = drive(POINTS)
    wheels, imu = noisy_wheels(truth, 1), noisy_gyro(truth, 1)
    rotation = matrix_from_rpy(np.pi, 0.0, 1.0)
    turned = replace(imu, angular_velocity_rad_s=imu.angular_velocity_rad_s @ rotation)
    T_base_imu = se3_from_parts(rotation, np.zeros(3))
    np.testing.assert_allclose(
        predict_motion(_log(wheels, turned, T_base_imu=T_base_imu)).poses,
        predict_motion(_log(wheels, imu, T_base_imu=np.eye(4))).poses,
        atol=1e-9,
    )


def test_a_gap_in_the_imu_is_bridged_by_the_wheels() -> None:
    truth = drive(POINTS)
    imu = noisy_gyro(truth, 0, bias_rad_s=0.0, noise_rad_s=0.0)
    keep = (imu.stamps_ns < 6 * SECOND) | (imu.stamps_ns > 12 * SECOND)
    cut = ImuStream(
        imu.stamps_ns[keep],
        imu.angular_velocity_rad_s[keep],
        imu.linear_acceleration_m_s2[keep],
    )
    fused = predict_motion(_log(truth, cut))
    error = wrap_angle(fused.at(truth.stamps_ns)[:, 2] - truth.poses[:, 2] + truth.poses[0, 2])
    assert np.abs(error).max() < 5e-3
    step = _odometry(truth, cut).step(5 * SECOND, 13 * SECOND, NOMINAL)
    assert step.gyro_s == pytest.approx(2.0, abs=0.1)


@settings(max_examples=40)
@given(
    st.integers(2 * SECOND, 12 * SECOND),
    st.integers(10_000_000, 3 * SECOND),
    st.integers(0, PARAMETERS - 1),
    st.integers(0, 100),
)
def test_the_jacobian_is_what_a_little_more_of_a_parameter_does(
    first_ns: int, span_ns: int, which: int, seed: int
) -> None:
    odometry = _some_odometry()
    parameters = np.random.default_rng(seed).normal(size=PARAMETERS) * 0.02
    step = odometry.step(first_ns, first_ns + span_ns, parameters)
    more = parameters.copy()
    more[which] += 1e-6
    moved = odometry.step(first_ns, first_ns + span_ns, more)
    slope = between(step.T_first_last, moved.T_first_last) / 1e-6
    np.testing.assert_allclose(step.jacobian[:3, which], slope, atol=1e-4)
    turned = (moved.wheel_turn_rad - step.wheel_turn_rad) / 1e-6
    assert step.jacobian[3, which] == pytest.approx(turned, abs=1e-6)
    np.testing.assert_allclose(
        between(step.at(more).T_first_last, moved.T_first_last), 0.0, atol=1e-9
    )


@settings(max_examples=40)
@given(st.lists(st.integers(2 * SECOND, 15 * SECOND), min_size=3, max_size=3, unique=True))
def test_two_steps_make_one(stamps_ns: list[int]) -> None:
    first_ns, middle_ns, last_ns = sorted(stamps_ns)
    odometry, parameters = _some_odometry(), np.array([0.01, 0.02, 0.03, 0.004, 0.005])
    whole = odometry.step(first_ns, last_ns, parameters)
    head = odometry.step(first_ns, middle_ns, parameters)
    both = head.then(odometry.step(middle_ns, last_ns, parameters))
    np.testing.assert_allclose(between(both.T_first_last, whole.T_first_last), 0.0, atol=1e-9)
    np.testing.assert_allclose(both.jacobian, whole.jacobian, atol=1e-9)
    for name in ("seconds", "path_m", "turned_rad", "gyro_s", "wheel_turn_rad"):
        assert getattr(both, name) == pytest.approx(getattr(whole, name), abs=1e-9)


def test_a_path_ends_where_the_step_leads() -> None:
    odometry = _some_odometry()
    first_ns, last_ns = 3 * SECOND + 1234, 4 * SECOND + 56789
    path = odometry.path(first_ns, last_ns, NOMINAL)
    assert path.stamps_ns[[0, -1]].tolist() == [first_ns, last_ns]
    assert np.all(np.diff(path.stamps_ns) > 0)
    step = odometry.step(first_ns, last_ns, NOMINAL)
    np.testing.assert_allclose(between(path.poses[-1], step.T_first_last), 0.0, atol=1e-12)


def test_odometry_that_grows_and_forgets_says_the_same() -> None:
    truth = drive(POINTS)
    wheels, imu = noisy_wheels(truth, 1), noisy_gyro(truth, 1)
    whole = _odometry(wheels, imu)
    cut = len(wheels) // 2
    head = PlanarTrajectory(wheels.stamps_ns[: cut + 1], wheels.poses[: cut + 1])
    tail = PlanarTrajectory(wheels.stamps_ns[cut:], wheels.poses[cut:])
    grown = Odometry(increments(head, imu), whole.reading)
    grown.extend(increments(tail, imu))
    first_ns = int(head.stamps_ns[-1]) - SECOND
    grown.forget_before(first_ns)
    assert len(grown.stamps_ns) < 0.7 * len(whole.stamps_ns)
    np.testing.assert_allclose(
        grown.step(first_ns, first_ns + 3 * SECOND, NOMINAL).T_first_last,
        whole.step(first_ns, first_ns + 3 * SECOND, NOMINAL).T_first_last,
        atol=1e-9,
    )
    with pytest.raises(SlamsimError, match="cannot go on"):
        grown.extend(increments(head, imu))


def test_a_moment_beyond_the_last_report_the_speed_goes_on() -> None:
    truth = drive(POINTS)
    end_ns = int(truth.stamps_ns[800])
    odometry = _odometry(PlanarTrajectory(truth.stamps_ns[:801], truth.poses[:801]))
    assert odometry.covers(end_ns, end_ns + 100_000_000)
    assert not odometry.covers(end_ns, end_ns + 10 * SECOND)
    step = odometry.step(end_ns - SECOND, end_ns + 100_000_000, NOMINAL)
    true = between(*truth.at(np.array([end_ns - SECOND, end_ns + 100_000_000])))
    np.testing.assert_allclose(step.T_first_last, true, atol=5e-3)


def test_a_robot_at_rest_does_not_drift_and_shows_its_bias() -> None:
    truth = drive(POINTS, rest_s=4.0)
    imu = noisy_gyro(truth, 1, bias_rad_s=0.01)
    odometry = _odometry(truth, imu)
    step = odometry.step(SECOND, 3 * SECOND, NOMINAL, bias_sigma_rad_s=0.02)
    np.testing.assert_array_equal(step.T_first_last, 0.0)
    assert step.rest_s == pytest.approx(2.0)
    assert step.rest_turn_rad / step.rest_s == pytest.approx(0.01, abs=1e-3)
    assert odometry.step(6 * SECOND, 7 * SECOND, NOMINAL, 0.02).rest_s == 0.0


def test_a_log_that_begins_at_rest_begins_without_drift() -> None:
    truth = drive(POINTS, rest_s=4.0)
    odometry = _odometry(truth, noisy_gyro(truth, 1, bias_rad_s=0.01))
    step = odometry.step(0, SECOND // 10, NOMINAL, 0.02)
    assert step.T_first_last.tolist() == [0.0, 0.0, 0.0]
    assert step.rest_s > 0.0


def test_what_a_robot_drives_as_it_sets_off_is_not_lost() -> None:
    stamps_ns = np.arange(0, 3 * SECOND, SECOND // 50)
    yaw = 1.5 * np.square(np.maximum(stamps_ns * 1e-9 - 1.98, 0.0))
    odometry = _odometry(PlanarTrajectory(stamps_ns, np.outer(yaw, [0.0, 0.0, 1.0])))
    setting_off = odometry.step(19 * SECOND // 10, 2 * SECOND, NOMINAL)
    assert setting_off.T_first_last[2] == pytest.approx(6e-4)
    assert odometry.step(17 * SECOND // 10, 18 * SECOND // 10, NOMINAL).T_first_last[2] == 0.0


def test_a_robot_that_is_turned_by_hand_does_not_rest() -> None:
    stamps_ns = np.arange(1000) * 5_000_000
    wheels = PlanarTrajectory(stamps_ns, np.zeros((1000, 3)))
    turning = np.zeros((1000, 3))
    turning[:, 2] = 0.3
    odometry = _odometry(wheels, ImuStream(stamps_ns, turning, np.zeros((1000, 3))))
    step = odometry.step(SECOND, 2 * SECOND, NOMINAL, 0.02)
    assert step.rest_s == 0.0
    assert step.T_first_last[2] == pytest.approx(0.3)


@pytest.mark.parametrize("step_m", [0.01, 0.001])
def test_the_rounding_of_poses_is_found(step_m: float) -> None:
    wheels = noisy_wheels(drive(POINTS), 0)
    rounded = np.round(wheels.poses / step_m) * step_m
    reading = pose_reading(PlanarTrajectory(wheels.stamps_ns, rounded))
    assert reading.step_m == pytest.approx(step_m)
    assert pose_reading(wheels).step_m < 1e-4


def test_covariance_grows_with_path_turn_and_time() -> None:
    config = MotionConfig()
    noise = OdometryNoise(config)
    none = OdometryStep.none(NOMINAL)
    short = noise.covariance(replace(none, path_m=0.1, seconds=0.2))
    long = noise.covariance(replace(none, path_m=1.0, seconds=2.0))
    turn = noise.covariance(replace(none, path_m=0.1, turned_rad=1.0, seconds=0.2))
    by_gyro = noise.covariance(replace(none, path_m=0.1, turned_rad=1.0, seconds=0.2, gyro_s=0.2))
    assert np.sqrt(long[0, 0]) == pytest.approx(config.slip_m_per_sqrt_m)
    assert np.all(np.diag(long) > np.diag(short))
    assert turn[2, 2] > short[2, 2]
    assert by_gyro[2, 2] < turn[2, 2]


def test_a_heading_that_walks_leads_aside_as_the_covariance_says() -> None:
    """Against many walks in small steps."""
    noise = replace(OdometryNoise(MotionConfig()), path=1e-12)
    step = replace(OdometryStep.none(NOMINAL), path_m=1.0, seconds=2.0)
    expected = noise.covariance(step)
    rng = np.random.default_rng(0)
    ends = np.zeros((4000, 3))
    for _ in range(50):
        turned = rng.normal(size=4000) * np.sqrt(expected[2, 2] / 50)
        onward = np.column_stack([np.full(4000, 0.02), np.zeros(4000), turned])
        ends = compose(ends, onward)
    error = between(np.array([1.0, 0.0, 0.0]), ends)
    np.testing.assert_allclose(np.cov(error[:, 1:].T), expected[1:, 1:], rtol=0.1)
