"""Finds messages without a valid measurement."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu, RawOdometry

UNIT_TOLERANCE = 0.01
"""Of a quaternion's length: what single precision rounds is far less."""


def sound_poses(odometry: RawOdometry) -> BoolArray:
    """(n,) which messages hold a pose and a twist."""
    return finite_poses(odometry) & has_unit_length(odometry.quats_xyzw)


def finite_poses(odometry: RawOdometry) -> BoolArray:
    """(n,) whose numbers are all finite, but for twists that no message has, as in CARMEN logs."""
    twists = (odometry.linear_m_s, odometry.angular_rad_s)
    numbers = (odometry.positions_m, *(one for one in twists if np.isfinite(one).any()))
    return is_sound(np.concatenate(numbers, axis=1))


def finite_readings(imu: RawImu) -> BoolArray:
    """(n,) whose rates and accelerations are all finite."""
    numbers = (imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2)
    return is_sound(np.concatenate(numbers, axis=1))


def has_unit_length(quats_xyzw: FloatArray) -> BoolArray:
    """(n,) whether each quaternion (n, 4) is a rotation."""
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(quats_xyzw, axis=1)
        return np.asarray(np.abs(length - 1.0) < UNIT_TOLERANCE)
