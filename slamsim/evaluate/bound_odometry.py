"""Information about motion from wheels and gyroscope: the odometry part of the bound.

The heading is the gyroscope's: white noise of its density, its bias taken as known, which it
nearly is after a whole run. The wheels' is joined to it. How far the wheels slip is no setting
but physics, so it is measured: what is left of the true motion over short stretches after the
best linear calibration of the wheel odometry has been taken off. What the encoders' resolution
adds is in it. Both are taken as independent from stretch to stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import between
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory

STRETCH_M = 1.0
"""Of rolling of the wheels, over which their slip is measured."""

_MIN_STRETCHES, _MOST_STRETCHES = 12, 1_000_000
_LEAST_ROLLED_M = 1e-6
"""Wheels that rolled less tell nothing of the motion."""
_LEAST_VARIANCE = 1e-14
_UNKNOWN_VARIANCE = 1e6
"""Of a sensor without noise, so that it can be inverted, and of one that is not there."""


@dataclass(frozen=True, slots=True)
class BoundOdometryNoise:
    """forward, sideways: m^2 per metre rolled. wheel_yaw: rad^2 per metre rolled, gyro_yaw:
    rad^2 per second. Huge for a sensor that is not there."""

    forward: float
    sideways: float
    wheel_yaw: float
    gyro_yaw: float

    def covariances(
        self, rolled_m: FloatArray, length_m: FloatArray, seconds: FloatArray
    ) -> FloatArray:
        """(n, 3, 3) of steps whose chords of length_m (n,) are their x axes; rolled_m: (n,) how far
        the wheels rolled. The heading's random walk on the way adds its integral sideways."""
        yaw = 1.0 / (1.0 / (self.gyro_yaw * seconds) + 1.0 / (self.wheel_yaw * rolled_m))
        covariance = np.zeros((rolled_m.size, 3, 3))
        covariance[:, 0, 0] = self.forward * rolled_m
        covariance[:, 1, 1] = self.sideways * rolled_m + yaw * length_m * length_m / 3.0
        covariance[:, 1, 2] = covariance[:, 2, 1] = 0.5 * yaw * length_m
        covariance[:, 2, 2] = yaw
        return covariance


def odometry_noise(
    truth: PlanarTrajectory, wheels: PlanarTrajectory, sensors: SensorsConfig, track_m: float
) -> BoundOdometryNoise:
    """truth: ``T_map_base``, covering all of wheels, ``T_odom_base``, which moves."""
    gyro, slip = _UNKNOWN_VARIANCE, np.full(3, _UNKNOWN_VARIANCE)
    if sensors.imu.enabled:
        gyro = max(sensors.imu.gyro.noise_density**2, _LEAST_VARIANCE)
    if sensors.encoders.enabled:
        slip = np.maximum(_slip_per_metre(truth, wheels, track_m), _LEAST_VARIANCE)
    forward, sideways, yaw = slip.tolist()
    return BoundOdometryNoise(forward, sideways, yaw, gyro)


def rolled_between(poses: FloatArray, track_m: float) -> FloatArray:
    """(n - 1,) how far the wheels roll from pose to pose, turns on the spot included."""
    step = between(poses[:-1], poses[1:])
    return np.asarray(np.hypot(step[:, 0], step[:, 1]) + 0.5 * track_m * np.abs(step[:, 2]))


def _slip_per_metre(
    truth: PlanarTrajectory, wheels: PlanarTrajectory, track_m: float
) -> FloatArray:
    """(3,) variance of what the calibrated wheels err, forward, sideways and in yaw.

    Steps from sample to sample are short enough for their errors to add up in their own axes.
    """
    true_poses = truth.at(wheels.stamps_ns)
    true_step = between(true_poses[:-1], true_poses[1:])
    wheel_step = between(wheels.poses[:-1], wheels.poses[1:])
    fitted = np.linalg.lstsq(wheel_step, true_step, rcond=None)[0]
    error = np.cumsum(np.vstack([np.zeros(3), true_step - wheel_step @ fitted]), axis=0)
    rolled_m = np.concatenate([[0.0], np.cumsum(rolled_between(wheels.poses, track_m))])
    if rolled_m[-1] < _LEAST_ROLLED_M:
        return np.full(3, _UNKNOWN_VARIANCE)
    stretch_m = min(STRETCH_M, float(rolled_m[-1]) / _MIN_STRETCHES)
    stretch_m = max(stretch_m, float(rolled_m[-1]) / _MOST_STRETCHES)
    cuts: IntArray = np.searchsorted(rolled_m, np.arange(0.0, rolled_m[-1], stretch_m))
    cuts = np.unique(np.append(cuts, len(rolled_m) - 1))
    return np.asarray(np.square(np.diff(error[cuts], axis=0)).sum(axis=0) / rolled_m[-1])
