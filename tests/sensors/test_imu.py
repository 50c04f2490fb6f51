"""The inertial unit: integrates back to the truth, feels gravity and its lever arm, and errs
with the constants it is given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from sensing_example import Robot, drive_along, figure_eight, standing

from slamsim.config.sensors import AccelerometerConfig, GyroConfig, ImuConfig
from slamsim.core.types import GRAVITY_M_S2, Drive, FloatArray
from slamsim.sensors.imu import Imu
from slamsim.sensors.motion import joined
from slamsim.sensors.readings import ImuBatch

NO_ERROR = {"noise_density": 0.0, "bias_random_walk": 0.0, "turn_on_bias": 0.0}


def imu_config(
    gyro: dict[str, Any] | None = None, accelerometer: dict[str, Any] | None = None, **more: Any
) -> ImuConfig:
    """A perfect unit but for these settings."""
    return ImuConfig(
        gyro=GyroConfig.model_validate({**NO_ERROR, **(gyro or {})}),
        accelerometer=AccelerometerConfig.model_validate({**NO_ERROR, **(accelerometer or {})}),
        **more,
    )


def sensed(
    config: ImuConfig, drive: Drive, T_base_imu: FloatArray | None = None, seed: int = 0
) -> ImuBatch:
    mount = np.eye(4) if T_base_imu is None else T_base_imu
    return Imu(config, mount, seed, int(drive.stamps_ns[0])).sense(joined(None, drive))


@pytest.mark.parametrize("rate_hz", [37.0, 200.0, 1000.0])
def test_samples_integrate_back_to_the_true_rotation_and_velocity(rate_hz: float) -> None:
    drive, mount = figure_eight(4.0), Robot().T_base_imu
    batch = sensed(imu_config(rate_hz=rate_hz), drive, mount)
    half_ns = round(0.5e9 / rate_hz)
    first_ns, last_ns = batch.true_stamps_ns[0] - half_ns, batch.true_stamps_ns[-1] + half_ns

    t = drive.stamps_ns * 1e-9
    ends = np.array([first_ns, last_ns]) * 1e-9
    bases = Slerp(t, Rotation.from_quat(drive.quats_xyzw))(ends)
    turning = np.column_stack([np.interp(ends, t, w) for w in drive.angular_velocity_rad_s.T])
    moving = np.column_stack([np.interp(ends, t, v) for v in drive.linear_velocity_m_s.T])
    velocities = moving + np.cross(turning, bases.apply(mount[:3, 3]))
    units = bases * Rotation.from_matrix(mount[:3, :3])

    attitude, velocity, dt = units[0], velocities[0], 1.0 / rate_hz
    gravity = np.array([0.0, 0.0, -GRAVITY_M_S2])
    for rate, force in zip(
        batch.stream.angular_velocity_rad_s, batch.stream.linear_acceleration_m_s2, strict=True
    ):
        midway = attitude * Rotation.from_rotvec(0.5 * dt * rate)
        velocity = velocity + dt * (midway.apply(force) + gravity)
        attitude = attitude * Rotation.from_rotvec(dt * rate)
    assert (attitude.inv() * units[1]).magnitude() < 1e-6
    np.testing.assert_allclose(velocity, velocities[1], atol=1e-5)


def test_at_rest_it_feels_gravity_along_its_own_axes() -> None:
    mount = Robot().T_base_imu
    batch = sensed(imu_config(), standing(0.5), mount)
    np.testing.assert_allclose(batch.stream.angular_velocity_rad_s, 0.0, atol=1e-12)
    expected = mount[:3, :3].T @ [0.0, 0.0, GRAVITY_M_S2]
    np.testing.assert_allclose(
        batch.stream.linear_acceleration_m_s2, np.tile(expected, (len(batch), 1)), atol=1e-9
    )
    level = sensed(imu_config(), standing(0.5)).stream.linear_acceleration_m_s2
    assert level[:, 2].mean() == pytest.approx(9.80665)


def test_away_from_the_middle_it_feels_the_centripetal_force() -> None:
    mount = np.eye(4)
    mount[:3, 3] = [0.2, -0.1, 0.3]
    spinning = drive_along(1.0, 240.0, yaw_rate_rad_s=2.0)
    batch = sensed(imu_config(), spinning, mount)
    np.testing.assert_allclose(
        batch.stream.linear_acceleration_m_s2.mean(axis=0), [-0.8, 0.4, GRAVITY_M_S2], atol=2e-3
    )
    np.testing.assert_allclose(
        batch.stream.angular_velocity_rad_s,
        np.tile([0.0, 0.0, 2.0], (len(batch), 1)),
        atol=1e-9,
    )


def test_it_is_the_same_gravity_that_the_physics_falls_with() -> None:
    from slamsim.config.drive import PhysicsConfig
    from slamsim.sim.engine import engine_parameters

    assert engine_parameters(PhysicsConfig())["gravityAccelerationZ"] == -GRAVITY_M_S2


def test_samples_are_not_late() -> None:
    """In a steady change of the turning rate the mean over a centred period is the rate then."""
    drive = drive_along(1.0, 1000.0)
    t = drive.stamps_ns * 1e-9
    quats = Rotation.from_euler("z", 1.5 * t[:, None] ** 2).as_quat()
    drive = Drive(**{**{n: getattr(drive, n) for n in drive.__slots__}, "quats_xyzw": quats})
    batch = sensed(imu_config(rate_hz=100.0), drive)
    expected = 3.0 * batch.true_stamps_ns * 1e-9
    np.testing.assert_allclose(batch.stream.angular_velocity_rad_s[:, 2], expected, atol=1e-5)


def long_rest(config: ImuConfig, seconds: float, seed: int = 0) -> ImuBatch:
    return sensed(config, drive_along(seconds, 1.0), seed=seed)


def allan_deviation(values: FloatArray, size: int) -> float:
    """Overlapping Allan deviation at an averaging length of ``size`` samples (IEEE 1139)."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    means = (total[size:] - total[:-size]) / size
    return float(np.sqrt(0.5 * np.mean((means[size:] - means[:-size]) ** 2)))


@pytest.mark.parametrize("which", ["gyro", "accelerometer"])
def test_noise_density_is_what_the_allan_deviation_reads_at_one_second(which: str) -> None:
    for rate_hz in (50.0, 200.0):
        config = imu_config(**{which: {"noise_density": 0.02}}, rate_hz=rate_hz)
        stream = long_rest(config, 600.0).stream
        values = (
            stream.angular_velocity_rad_s if which == "gyro" else stream.linear_acceleration_m_s2
        )
        for axis in range(3):
            read = allan_deviation(values[:, axis], int(rate_hz))
            assert read == pytest.approx(0.02, rel=0.1)
        assert values.std(axis=0) == pytest.approx(0.02 * np.sqrt(rate_hz), rel=0.03)


@pytest.mark.parametrize("which", ["gyro", "accelerometer"])
def test_bias_random_walk_is_what_the_allan_deviation_reads_at_three_seconds(which: str) -> None:
    for rate_hz in (20.0, 100.0):
        config = imu_config(**{which: {"bias_random_walk": 0.03}}, rate_hz=rate_hz)
        stream = long_rest(config, 3000.0).stream
        values = (
            stream.angular_velocity_rad_s if which == "gyro" else stream.linear_acceleration_m_s2
        )
        read = [allan_deviation(values[:, axis], int(3 * rate_hz)) for axis in range(3)]
        assert np.mean(read) == pytest.approx(0.03, rel=0.1)


def test_turn_on_bias_is_constant_and_differs_by_axis_and_seed() -> None:
    config = imu_config(gyro={"turn_on_bias": 0.1})
    biases = []
    for seed in range(200):
        rates = sensed(config, standing(0.05), seed=seed).stream.angular_velocity_rad_s
        assert np.ptp(rates, axis=0).max() < 1e-12
        biases.append(rates[0])
    assert np.std(biases) == pytest.approx(0.1, rel=0.1)
    assert np.unique(biases).size == 600


def test_scale_saturation_and_resolution_act() -> None:
    drive = drive_along(0.5, 240.0, yaw_rate_rad_s=2.0)
    scaled = sensed(imu_config(gyro={"scale_error": [0.0, 0.0, 0.1]}), drive)
    np.testing.assert_allclose(scaled.stream.angular_velocity_rad_s[:, 2], 2.2)
    stopped = sensed(imu_config(gyro={"saturation": 1.5}), drive)
    np.testing.assert_allclose(stopped.stream.angular_velocity_rad_s[:, 2], 1.5)
    stepped = sensed(imu_config(gyro={"resolution": 0.3}), drive)
    np.testing.assert_allclose(stepped.stream.angular_velocity_rad_s[:, 2], 2.1)
    heavy = sensed(imu_config(accelerometer={"saturation": 5.0}), drive)
    np.testing.assert_allclose(heavy.stream.linear_acceleration_m_s2[:, 2], 5.0)
    coarse = sensed(imu_config(accelerometer={"resolution": 4.0}), drive)
    np.testing.assert_allclose(coarse.stream.linear_acceleration_m_s2[:, 2], 8.0)
    light = sensed(imu_config(accelerometer={"scale_error": [0.0, 0.0, -0.5]}), drive)
    np.testing.assert_allclose(
        light.stream.linear_acceleration_m_s2[:, 2], 0.5 * GRAVITY_M_S2, atol=1e-6
    )


def test_noise_of_one_kind_leaves_the_draws_of_the_others() -> None:
    both = {"noise_density": 0.01, "bias_random_walk": 0.01}
    drive = standing(2.0)
    full = sensed(imu_config(gyro=both, accelerometer=both), drive).stream
    only_gyro = sensed(imu_config(gyro=both), drive).stream
    np.testing.assert_array_equal(full.angular_velocity_rad_s, only_gyro.angular_velocity_rad_s)
    white = sensed(imu_config(gyro={"noise_density": 0.01}), drive).stream.angular_velocity_rad_s
    walk = sensed(imu_config(gyro={"bias_random_walk": 0.01}), drive).stream.angular_velocity_rad_s
    np.testing.assert_allclose(full.angular_velocity_rad_s, white + walk, atol=1e-12)
