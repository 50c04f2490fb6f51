"""Wheel odometry: from encoder ticks to where the wheels say the robot is."""

from __future__ import annotations

import numpy as np

from slamsim.geometry import wrap_angle
from slamsim.types import EncoderStream, FloatArray, PlanarTrajectory


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
    forward_m = rolled_m.mean(axis=1)
    turned_rad = (rolled_m[:, 1] - rolled_m[:, 0]) / encoders.track_m

    yaw = start[2] + np.concatenate([[0.0], np.cumsum(turned_rad)])
    mid_yaw = yaw[:-1] + 0.5 * turned_rad
    chord_m = forward_m * np.sinc(turned_rad / (2.0 * np.pi))
    x = start[0] + np.concatenate([[0.0], np.cumsum(chord_m * np.cos(mid_yaw))])
    y = start[1] + np.concatenate([[0.0], np.cumsum(chord_m * np.sin(mid_yaw))])
    return PlanarTrajectory(encoders.stamps_ns, np.column_stack([x, y, wrap_angle(yaw)]))
