"""Motion prediction: wheels and gyroscope against exact truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import ScanList, ate_rmse_m, drive, noisy_gyro, noisy_wheels

from slamsim.config.slam import MotionConfig
from slamsim.geometry import between, matrix_from_rpy, se3_from_parts, wrap_angle
from slamsim.slam.motion import NoMotion, fuse_gyro, gyro_bias, motion_covariance, predict_motion
from slamsim.types import EncoderStream, FloatArray, ImuStream, Log, PlanarTrajectory
from slamsim.wheels import wheel_odometry

POINTS = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0], [0.0, 4.0], [3.0, 4.0]])


def _log(
    odometry: PlanarTrajectory | None,
    imu: ImuStream | None = None,
    encoders: EncoderStream | None = None,
    T_base_imu: FloatArray | None = None,
) -> Log:
    return Log("test", "simulation", ScanList([]), odometry, imu, encoders, np.eye(4), T_base_imu)


def test_without_a_gyroscope_the_wheels_are_taken_as_they_are() -> None:
    wheels = noisy_wheels(drive(POINTS), 0)
    assert predict_motion(_log(wheels)) is wheels


def test_a_log_without_any_motion_is_refused() -> None:
    with pytest.raises(NoMotion, match="neither odometry nor wheel encoders"):
        predict_motion(_log(None))


def test_encoders_go_before_odometry_that_was_derived_from_them() -> None:
    ticks = np.array([[0, 0], [100, 120], [220, 230]])
    encoders = EncoderStream(np.array([0, 10**8, 2 * 10**8]), ticks, 1000, 0.035, 0.23)
    wrong = PlanarTrajectory(encoders.stamps_ns, np.full((3, 3), 7.0))
    np.testing.assert_array_equal(
        predict_motion(_log(wrong, encoders=encoders)).poses, wheel_odometry(encoders).poses
    )


def test_perfect_sensors_give_back_the_truth() -> None:
    truth = drive(POINTS)
    perfect = noisy_gyro(truth, 0, bias_rad_s=0.0, noise_rad_s=0.0)
    fused = fuse_gyro(truth, perfect, np.eye(3))
    error = between(truth.poses, fused.at(truth.stamps_ns))
    assert np.abs(error[:, :2]).max() < 2e-3
    assert np.abs(error[:, 2]).max() < 3e-3


def test_the_gyroscope_takes_the_place_of_a_wrong_track_width() -> None:
    truth = drive(POINTS)
    wheels, imu = noisy_wheels(truth, 1), noisy_gyro(truth, 1)
    fused = predict_motion(_log(wheels, imu, T_base_imu=np.eye(4)))
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


def test_bias_is_found_at_rest_and_interpolated_between_rests() -> None:
    stamps_ns = np.arange(0, 30_000_000_001, 5_000_000)
    seconds = stamps_ns * 1e-9
    driving = (seconds > 5.0) & (seconds < 25.0)
    x = np.cumsum(np.where(driving, 0.0025, 0.0))
    yaw = np.cumsum(np.where(driving, 0.002, 0.0))
    wheels = PlanarTrajectory(stamps_ns, np.column_stack([x, np.zeros_like(x), yaw]))
    drifting = 0.01 + 0.001 * seconds
    rate = np.where(driving, 0.4, 0.0) + drifting
    bias = gyro_bias(wheels, stamps_ns, rate)
    middle = np.searchsorted(stamps_ns, 15 * 10**9)
    assert bias[middle] == pytest.approx(drifting[middle], abs=2e-4)
    assert bias[0] == pytest.approx(0.0125, abs=2e-4)


def test_bias_without_any_rest_comes_from_driving_straight() -> None:
    truth = drive(POINTS, rest_s=0.0)
    moving = PlanarTrajectory(truth.stamps_ns[200:], truth.poses[200:])
    wheels = noisy_wheels(moving, 3)
    rate = noisy_gyro(moving, 3, bias_rad_s=0.02).angular_velocity_rad_s[:, 2]
    assert gyro_bias(wheels, moving.stamps_ns, rate)[0] == pytest.approx(0.02, abs=4e-3)


def test_a_gap_in_the_imu_is_bridged_by_the_wheels() -> None:
    truth = drive(POINTS)
    imu = noisy_gyro(truth, 0, bias_rad_s=0.0, noise_rad_s=0.0)
    keep = (imu.stamps_ns < 6 * 10**9) | (imu.stamps_ns > 12 * 10**9)
    cut = ImuStream(
        imu.stamps_ns[keep],
        imu.angular_velocity_rad_s[keep],
        imu.linear_acceleration_m_s2[keep],
    )
    fused = fuse_gyro(truth, cut, np.eye(3))
    error = wrap_angle(fused.at(truth.stamps_ns)[:, 2] - truth.poses[:, 2])
    assert np.abs(error).max() < 5e-3


def test_the_prediction_covers_what_the_wheels_cover() -> None:
    truth = drive(POINTS)
    wheels, imu = noisy_wheels(truth, 0), noisy_gyro(truth, 0)
    late = ImuStream(
        imu.stamps_ns[300:], imu.angular_velocity_rad_s[300:], imu.linear_acceleration_m_s2[300:]
    )
    fused = fuse_gyro(wheels, late, np.eye(3))
    assert fused.stamps_ns[0] == wheels.stamps_ns[0]
    assert fused.stamps_ns[-1] == wheels.stamps_ns[-1]
    assert np.all(np.diff(fused.stamps_ns) > 0)


def test_covariance_grows_with_path_turn_and_time() -> None:
    config = MotionConfig()
    short = motion_covariance(np.array([0.1, 0.0, 0.0]), 0.2, False, config)
    long = motion_covariance(np.array([1.0, 0.0, 0.0]), 2.0, False, config)
    turn = motion_covariance(np.array([0.1, 0.0, 1.0]), 0.2, False, config)
    assert np.sqrt(long[0, 0]) == pytest.approx(config.slip_m_per_m)
    assert np.all(np.diag(long) > np.diag(short))
    assert turn[2, 2] > short[2, 2]
    by_gyro = motion_covariance(np.array([0.1, 0.0, 1.0]), 0.2, True, config)
    assert by_gyro[2, 2] < turn[2, 2]
