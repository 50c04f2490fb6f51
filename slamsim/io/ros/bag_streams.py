"""Odometry, IMU, encoders and truth of a ROS recording, each as one array over time."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, xyzw_from_matrix
from slamsim.core.types import BoolArray, EncoderStream, FloatArray, ImuStream, IntArray, Trajectory
from slamsim.guard.numbers import LEAST_SIZE_M, MOST, is_sound
from slamsim.io.ros.bag import Bag
from slamsim.io.ros.columns import read_columns, stamp_ns_of
from slamsim.recording.cleaning.rising_stamps import NoTime, rising_times
from slamsim.recording.frames import frame_name
from slamsim.recording.schemas import IMU, ODOMETRY, TICKS


def in_order(
    stamps_ns: IntArray, usable: BoolArray, what: str, received_ns: IntArray | None = None
) -> tuple[IntArray, IntArray, list[str]]:
    """(strictly increasing stamps, index of the row of each, what was odd).

    received_ns: when each row was received, if known. Of equal stamps the first row is kept,
    unless most are equal; rows that are not usable are left out.
    """
    warnings = []
    if not usable.all():
        warnings.append(f"{what}: {int((~usable).sum())} messages without sound numbers left out")
    rows = np.flatnonzero(usable)
    backward = int((np.diff(stamps_ns[rows]) < 0).sum())
    unique_ns, first = np.unique(stamps_ns[rows], return_index=True)
    if 2 * unique_ns.size < rows.size:
        with suppress(NoTime):
            received_ns = None if received_ns is None else received_ns[rows]
            times = rising_times(stamps_ns[rows], received_ns, what="messages")
            told = [f"{what}: {words}" for words in times.told]
            return times.stamps_ns, rows[times.order], [*warnings, *told]
    if backward:
        warnings.append(f"{what}: {backward} of {rows.size} stamps run backwards: sorted")
    if unique_ns.size < rows.size:
        warnings.append(f"{what}: {rows.size - unique_ns.size} messages repeat a stamp: left out")
    return unique_ns, rows[first], warnings


def lengths(vectors: FloatArray) -> FloatArray:
    """(n,) of the rows, however odd their numbers; ``inf`` where they are too large for one."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(vectors, axis=1))


def are_wheels(*constants: float) -> bool:
    """Whether ticks a turn, radius and track can be those of a robot."""
    return all(LEAST_SIZE_M <= number <= MOST for number in constants)


def read_odometry(bag: Bag, topic: str) -> tuple[Trajectory, str, list[str]]:
    """(pose over time, child frame, what was odd) of a nav_msgs/Odometry topic."""
    read = read_columns(bag, topic, ODOMETRY)
    poses = np.hstack([read.values["positions_m"], read.values["quats_xyzw"]])
    trajectory, warnings = _trajectory(read.stamps_ns, poses, topic, read.received_ns)
    return trajectory, frame_name(read.first.child_frame_id), warnings


def _trajectory(
    stamps_ns: IntArray, poses: FloatArray, what: str, received_ns: IntArray | None = None
) -> tuple[Trajectory, list[str]]:
    """From (n, 7) x, y, z and a quaternion x, y, z, w, which need not be unit."""
    norms = lengths(poses[:, 3:])
    usable = is_sound(poses) & (np.abs(norms - 1.0) < 0.1)
    unique_ns, kept, warnings = in_order(stamps_ns, np.asarray(usable), what, received_ns)
    quats = poses[kept, 3:] / norms[kept, None]
    return Trajectory(unique_ns, poses[kept, :3], quats), warnings


def read_chain(bag: Bag, topics: Iterable[str], edges: list[tuple[str, str]]) -> Trajectory | None:
    """The pose over time along edges (parent, child) of /tf, None if one is missing.

    The instants are those of the first edge that all the others cover.
    """
    stamps: dict[tuple[str, str], list[int]] = {edge: [] for edge in edges}
    rows: dict[tuple[str, str], list[tuple[float, ...]]] = {edge: [] for edge in edges}
    for message in bag.messages(topics):
        for moving in message.transforms:
            edge = (frame_name(moving.header.frame_id), frame_name(moving.child_frame_id))
            if edge in rows:
                t, q = moving.transform.translation, moving.transform.rotation
                stamps[edge].append(stamp_ns_of(moving.header))
                rows[edge].append((t.x, t.y, t.z, q.x, q.y, q.z, q.w))
    if not edges or not all(rows.values()):
        return None
    parts = [_trajectory(np.array(stamps[edge]), np.array(rows[edge]), "/tf")[0] for edge in edges]
    if any(len(part) == 0 for part in parts):
        return None
    first_ns = max(int(part.stamps_ns[0]) for part in parts)
    last_ns = min(int(part.stamps_ns[-1]) for part in parts)
    stamps_ns = parts[0].stamps_ns
    stamps_ns = stamps_ns[(stamps_ns >= first_ns) & (stamps_ns <= last_ns)]
    return _composed([part.at(stamps_ns) for part in parts]) if stamps_ns.size else None


def _composed(parts: list[Trajectory]) -> Trajectory:
    """T_a_c at each instant from T_a_b, T_b_c, ... at the same instants."""
    rotation, position = matrix_from_xyzw(parts[0].quats_xyzw), parts[0].positions_m
    for part in parts[1:]:
        position = position + np.einsum("nij,nj->ni", rotation, part.positions_m)
        rotation = rotation @ matrix_from_xyzw(part.quats_xyzw)
    quats = np.array([xyzw_from_matrix(one) for one in rotation])
    return Trajectory(parts[0].stamps_ns, position, quats)


def read_imu(bag: Bag, topic: str) -> tuple[ImuStream | None, list[str]]:
    """A sensor_msgs/Imu topic; None when no message has sound numbers."""
    read = read_columns(bag, topic, IMU)
    angular_rad_s = read.values["angular_velocity_rad_s"]
    linear_m_s2 = read.values["linear_acceleration_m_s2"]
    usable = np.asarray(is_sound(angular_rad_s) & is_sound(linear_m_s2))
    unique_ns, kept, warnings = in_order(read.stamps_ns, usable, topic, read.received_ns)
    if unique_ns.size == 0:
        return None, warnings
    frame = frame_name(read.first.header.frame_id)
    return ImuStream(unique_ns, angular_rad_s[kept], linear_m_s2[kept], frame), warnings


def read_encoders(bag: Bag, topic: str) -> tuple[EncoderStream | None, list[str]]:
    """A slamsim_msgs/EncoderTicks topic; None when its constants make no wheels."""
    read = read_columns(bag, topic, TICKS)
    driver = [read.values[field.name] for field in TICKS.fields if field.is_constant]
    per_revolution, radius_m, track_m = (values[0].item() for values in driver)
    steady = all((values == values[0]).all() for values in driver)
    if not steady or not are_wheels(per_revolution, radius_m, track_m):
        constants = f"{per_revolution} ticks a turn, radius {radius_m} m, track {track_m} m"
        return None, [f"{topic}: {constants} change or make no wheels: left out"]
    every = np.ones(read.stamps_ns.size, dtype=np.bool_)
    unique_ns, kept, warnings = in_order(read.stamps_ns, every, topic, read.received_ns)
    ticks = read.values["ticks"][kept]
    return EncoderStream(unique_ns, ticks, per_revolution, radius_m, track_m), warnings
