"""Repairs of the readings of an inertial unit, and of messages that hold no measurement; the
heading of the robot from any one of its streams."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slamsim.core.geometry import matrix_from_rpy, yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.differential_drive import wheel_odometry
from slamsim.models.wheel_gyro import turn_at_samples
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.recording.cleaning.streams import finite_readings, sound_poses
from slamsim.recording.edits.base import CannotEdit, Edit
from slamsim.recording.edits.imu import (
    OffsetReadings,
    RotateReadings,
    ScaleReadings,
    SetOrientation,
)
from slamsim.recording.edits.messages import SelectMessages
from slamsim.recording.edits.motion import ordered_encoder_stream
from slamsim.recording.edits.odometry import NormaliseRotations
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair


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


Heading = Callable[[IntArray], FloatArray]


def heading_from(
    recording: Recording, topic: str, correction: tuple[float, float] | None = None
) -> Heading:
    """Heading in rad, without jumps, at any stamps, from odometry, wheel counters or gyroscope.

    correction: of what the stream turns since its first message, to take off each second, and
    then to add; without one, a gyroscope is freed of what wheels or odometry say that it turns
    too far. Beyond the ends it stays what it was there. Raises CannotEdit for another topic.
    """
    for odometry in recording.odometries:
        if odometry.topic == topic:
            yaw_rad = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
            return _corrected(odometry.stamps_ns, yaw_rad, correction)
    for ticks in recording.ticks:
        if ticks.topic == topic:
            path = wheel_odometry(ordered_encoder_stream(ticks))
            return _corrected(path.stamps_ns, np.unwrap(path.poses[:, 2]), correction)
    for imu in recording.imus:
        if imu.topic == topic:
            return _integrated(recording, imu, correction)
    raise CannotEdit(f"{topic!r} tells no heading")


def base_rotation(recording: Recording, imu: RawImu) -> FloatArray:
    """(3, 3) R_base_imu as declared; the identity where no transform declares it."""
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.base_frames)
    T_base_imu = graph.between(base, imu.frame_ids[0]) if imu.frame_ids else None
    return np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]


def _corrected(
    stamps_ns: IntArray, heading_rad: FloatArray, correction: tuple[float, float] | None
) -> Heading:
    if correction is None:
        return _between(stamps_ns, heading_rad)
    drift_rad_s, offset_rad = correction
    since_s = (stamps_ns - stamps_ns.min(initial=stamps_ns[0])) * 1e-9
    turned = heading_rad - heading_rad[0]
    return _between(stamps_ns, turned - drift_rad_s * since_s + offset_rad)


def _integrated(
    recording: Recording, imu: RawImu, correction: tuple[float, float] | None
) -> Heading:
    """Rates about the base's vertical, less what wheels or odometry say that they are too high."""
    rates = imu.angular_velocity_rad_s @ base_rotation(recording, imu).T[:, 2]
    order = np.argsort(imu.stamps_ns, kind="stable")
    stamps_ns, rates = imu.stamps_ns[order], np.nan_to_num(rates[order])
    turned = turn_at_samples(stamps_ns, rates)
    if correction is not None:
        return _corrected(stamps_ns, turned, correction)
    others = [stream.topic for stream in (*recording.odometries, *recording.ticks)]
    if others and stamps_ns.size > 1:
        apart = turned - heading_from(recording, others[0])(stamps_ns)
        since_s = (stamps_ns - stamps_ns[0]) * 1e-9
        turned = turned - since_s * (apart[-1] - apart[0]) / max(float(since_s[-1]), 1e-9)
    return _between(stamps_ns, turned)


def _between(stamps_ns: IntArray, heading_rad: FloatArray) -> Heading:
    order = np.unique(stamps_ns, return_index=True)[1]
    known_ns, known_rad = stamps_ns[order], heading_rad[order]

    def at(query_ns: IntArray) -> FloatArray:
        origin_ns = known_ns[0]
        since_s = (known_ns - origin_ns) * 1e-9
        return np.asarray(np.interp((query_ns - origin_ns) * 1e-9, since_s, known_rad))

    return at
