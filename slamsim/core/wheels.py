"""Wheel odometry: from encoder ticks to the pose of the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import wrap_angle
from slamsim.core.types import EncoderStream, FloatArray, PlanarTrajectory


@dataclass(frozen=True, slots=True)
class Reading:
    """How finely the wheels are read: the steps in which path and turn are reported.

    sigma_m, sigma_rad: what that adds to any difference of two readings. wheel_radius_m, track_m:
    nominal; 0 for odometry whose wheels are not known.
    """

    step_m: float
    step_rad: float
    sigma_m: float
    sigma_rad: float
    wheel_radius_m: float = 0.0
    track_m: float = 0.0

    @property
    def lever_m2(self) -> float:
        """How far wheels of unequal size drive forward per radian and difference in curvature."""
        return 0.25 * self.track_m**2


def encoder_reading(encoders: EncoderStream) -> Reading:
    """Of two counters that round down to whole ticks (uniform errors at both ends)."""
    tick_m = 2.0 * np.pi * encoders.wheel_radius_m / encoders.ticks_per_revolution
    return Reading(
        step_m=tick_m,
        step_rad=tick_m / encoders.track_m,
        sigma_m=tick_m / np.sqrt(12.0),
        sigma_rad=tick_m / (np.sqrt(3.0) * encoders.track_m),
        wheel_radius_m=encoders.wheel_radius_m,
        track_m=encoders.track_m,
    )


def pose_reading(odometry: PlanarTrajectory) -> Reading:
    """Of poses rounded to some digit: the least distance of any two different values."""
    step_m = max(_least_step(odometry.poses[:, 0]), _least_step(odometry.poses[:, 1]))
    step_rad = _least_step(odometry.poses[:, 2])
    return Reading(step_m, step_rad, step_m / np.sqrt(6.0), step_rad / np.sqrt(6.0))


def wheel_odometry(
    encoders: EncoderStream, start_pose: FloatArray | None = None
) -> PlanarTrajectory:
    """``T_odom_base`` at each encoder stamp, from the nominal wheel radius and track.

    Each interval is driven as a circular arc (the chord at the mean heading is exact for
    constant wheel speeds: Borenstein, Everett & Feng 1996). start_pose: (3,), the origin if None.
    """
    start = np.zeros(3) if start_pose is None else np.asarray(start_pose, dtype=np.float64)
    metres_per_tick = 2.0 * np.pi * encoders.wheel_radius_m / encoders.ticks_per_revolution
    rolled_m = np.diff(encoders.ticks, axis=0) * metres_per_tick
    return PlanarTrajectory(encoders.stamps_ns, rolled_poses(rolled_m, encoders.track_m, start))


def rolled_poses(rolled_m: FloatArray, track_m: float, start_pose: FloatArray) -> FloatArray:
    """(n + 1, 3) ``T_odom_base`` of wheels that roll (n, 2), left and right, arc by arc."""
    forward_m = rolled_m.mean(axis=1)
    turned_rad = (rolled_m[:, 1] - rolled_m[:, 0]) / track_m

    yaw = start_pose[2] + np.concatenate([[0.0], np.cumsum(turned_rad)])
    mid_yaw = yaw[:-1] + 0.5 * turned_rad
    chord_m = forward_m * np.sinc(turned_rad / (2.0 * np.pi))
    x = start_pose[0] + np.concatenate([[0.0], np.cumsum(chord_m * np.cos(mid_yaw))])
    y = start_pose[1] + np.concatenate([[0.0], np.cumsum(chord_m * np.sin(mid_yaw))])
    return np.column_stack([x, y, wrap_angle(yaw)])


def _least_step(values: FloatArray) -> float:
    """The least distance of different values; 0 of fewer than two."""
    apart = np.diff(np.unique(values))
    return float(apart[apart > 1e-9].min(initial=np.inf)) if (apart > 1e-9).any() else 0.0
