"""Repairs of the readings of an inertial unit, and of messages that hold no measurement."""

from __future__ import annotations

import numpy as np

from slamsim.core.geometry import matrix_from_rpy
from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.recording.edits.base import CannotEdit, Edit
from slamsim.recording.edits.imu import (
    OffsetReadings,
    RotateReadings,
    ScaleReadings,
    SetOrientation,
)
from slamsim.recording.edits.messages import SelectMessages
from slamsim.recording.edits.odometry import NormaliseRotations
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.heading import base_rotation
from slamsim.recording.soundness import finite_readings, sound_poses


def scale_acceleration(recording: Recording, repair: Repair) -> Edit:
    """Multiply accelerations by factor."""
    factor = repair.number("factor")
    return ScaleReadings(repair.target(RawImu), "linear_acceleration_m_s2", factor)


def scale_gyro(recording: Recording, repair: Repair) -> Edit:
    """Multiply rates of turn by factor."""
    factor = repair.number("factor")
    return ScaleReadings(repair.target(RawImu), "angular_velocity_rad_s", factor)


def subtract_gyro_bias(recording: Recording, repair: Repair) -> Edit:
    """Take bias_rad_s off the rate of turn about the base's vertical."""
    up = _base_rotation(recording, repair).T @ np.array([0.0, 0.0, 1.0])
    x, y, z = (-(repair.number("bias_rad_s") * up)).tolist()
    return OffsetReadings(repair.target(RawImu), "angular_velocity_rad_s", (x, y, z))


def rotate_imu(recording: Recording, repair: Repair) -> Edit:
    """Turn the readings, on the shortest way, until gravity stands upright in the base.

    up_x, up_y, up_z: where it stands in the base as declared.
    """
    up = np.array([repair.number(name) for name in ("up_x", "up_y", "up_z")])
    R_base_imu = _base_rotation(recording, repair)
    return RotateReadings(repair.target(RawImu), R_base_imu.T @ _upright(up) @ R_base_imu)


def turn_imu(recording: Recording, repair: Repair) -> Edit:
    """Turn the readings of an inertial unit by yaw_rad about the base's vertical."""
    R_base_imu = _base_rotation(recording, repair)
    turn = matrix_from_rpy(0.0, 0.0, repair.number("yaw_rad"))
    return RotateReadings(repair.target(RawImu), R_base_imu.T @ turn @ R_base_imu)


def drop_orientation(recording: Recording, repair: Repair) -> Edit:
    """Say that an inertial unit estimates no orientation."""
    return SetOrientation(repair.target(RawImu), None)


def drop_broken_readings(recording: Recording, repair: Repair) -> Edit:
    """Leave out the messages of an inertial unit that are not finite."""
    return SelectMessages(repair.target(RawImu), finite_readings)


def drop_broken_poses(recording: Recording, repair: Repair) -> Edit:
    """Leave out the messages of an odometry that hold no pose."""
    return SelectMessages(repair.target(RawOdometry), sound_poses)


def normalise_rotations(recording: Recording, repair: Repair) -> Edit:
    """Bring an odometry's quaternions to unit length."""
    return NormaliseRotations(repair.target(RawOdometry))


def _base_rotation(recording: Recording, repair: Repair) -> FloatArray:
    for imu in recording.imus:
        if imu.topic == repair.subject:
            return base_rotation(recording, imu)
    raise CannotEdit(f"{recording.name} has no inertial unit on {repair.subject!r}")


def _upright(up: FloatArray) -> FloatArray:
    """(3, 3) the least rotation that takes up to z (Rodrigues); half a turn about x if opposite."""
    up = up / np.linalg.norm(up)
    axis, cosine = np.cross(up, [0.0, 0.0, 1.0]), float(up[2])
    if cosine < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))
