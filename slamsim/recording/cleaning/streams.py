"""Odometry, IMU and encoders as SLAM reads them: finite values in order of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np

from slamsim.core.geometry import (
    compose,
    matrix_from_xyzw,
    se2_from_se3,
    wrap_angle,
    xyzw_from_matrix,
    xyzw_from_yaw,
)
from slamsim.core.types import (
    BoolArray,
    EncoderStream,
    FloatArray,
    ImuStream,
    IntArray,
    PlanarTrajectory,
    Trajectory,
)
from slamsim.guard.numbers import LEAST_SIZE_M, MOST, is_sound
from slamsim.recording import RawImu, RawOdometry, RawTicks, TransformEdge
from slamsim.recording.cleaning.rising_stamps import NoTime, rising_times, unset

_UNIT_TOLERANCE = 0.1
"""A quaternion whose norm is off by more is none; within, rounding is taken out of it."""


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
    received_ns = None if received_ns is None else received_ns[rows]
    stamps_ns, told = unset(stamps_ns[rows], received_ns)
    warnings += [f"{what}: {words}" for words in told]
    backward = int((np.diff(stamps_ns) < 0).sum())
    unique_ns, first = np.unique(stamps_ns, return_index=True)
    if 2 * unique_ns.size < rows.size:
        with suppress(NoTime):
            times = rising_times(stamps_ns, received_ns, what="messages")
            told = [f"{what}: {words}" for words in times.told]
            return times.stamps_ns, rows[times.order], [*warnings, *told]
    if backward:
        warnings.append(f"{what}: {backward:,} of {rows.size:,} stamps run backwards: sorted")
    if unique_ns.size < rows.size:
        warnings.append(f"{what}: {rows.size - unique_ns.size} messages repeat a stamp: left out")
    return unique_ns, rows[first], warnings


def odometry_of(raw: RawOdometry) -> tuple[PlanarTrajectory, list[str]]:
    """(T_odom_base over time, what was odd)."""
    usable = _are_poses(raw.positions_m, raw.quats_xyzw)
    stamps_ns, rows, warnings = in_order(raw.stamps_ns, usable, raw.topic, raw.received_ns)
    return PlanarTrajectory(stamps_ns, planar_poses(raw, rows)), warnings


def in_base(odometry: PlanarTrajectory, T_moved_base: FloatArray) -> PlanarTrajectory:
    """Odometry of another frame on the robot; T_moved_base: 4 x 4."""
    return PlanarTrajectory(odometry.stamps_ns, compose(odometry.poses, se2_from_se3(T_moved_base)))


def trajectory_of(raw: RawOdometry) -> Trajectory:
    """The poses over time in space, such as those of a simulation's truth."""
    stamps_ns, positions_m, quats_xyzw = raw.stamps_ns, raw.positions_m, raw.quats_xyzw
    return _trajectory(stamps_ns, positions_m, quats_xyzw, raw.topic, raw.received_ns)[0]


def planar_poses(raw: RawOdometry, rows: IntArray) -> FloatArray:
    """(k, 3) of some rows, with the headings themselves where the format has them."""
    positions_m, yaws_rad = raw.positions_m[rows], raw.yaws_rad
    if yaws_rad is not None and np.array_equal(xyzw_from_yaw(yaws_rad), raw.quats_xyzw):
        return np.column_stack([positions_m[:, :2], wrap_angle(yaws_rad[rows])])
    quats_xyzw = _unit(raw.quats_xyzw[rows])
    return Trajectory(np.arange(rows.size), positions_m, quats_xyzw).planar().poses


def _are_poses(positions_m: FloatArray, quats_xyzw: FloatArray) -> BoolArray:
    sound = is_sound(np.hstack([positions_m, quats_xyzw]))
    return np.asarray(sound & (np.abs(_lengths(quats_xyzw) - 1.0) < _UNIT_TOLERANCE))


def _unit(quats_xyzw: FloatArray) -> FloatArray:
    return np.asarray(quats_xyzw / _lengths(quats_xyzw)[:, None])


def _lengths(vectors: FloatArray) -> FloatArray:
    """(n,) of the rows, however odd their numbers; ``inf`` where they are too large for one."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(vectors, axis=1))


def _trajectory(
    stamps_ns: IntArray,
    positions_m: FloatArray,
    quats_xyzw: FloatArray,
    what: str,
    received_ns: IntArray | None = None,
) -> tuple[Trajectory, list[str]]:
    """Of poses whose quaternions need not be unit."""
    usable = _are_poses(positions_m, quats_xyzw)
    unique_ns, rows, warnings = in_order(stamps_ns, usable, what, received_ns)
    return Trajectory(unique_ns, positions_m[rows], _unit(quats_xyzw[rows])), warnings


def chain_of(
    transforms: Iterable[TransformEdge], edges: Sequence[tuple[str, str]]
) -> Trajectory | None:
    """The pose over time along edges (parent, child) of moving transforms, None if one is missing.

    The instants are those of the first edge that all the others cover.
    """
    moving = [edge for edge in transforms if not edge.is_static]
    parts = []
    for parent, child in edges:
        mine = [edge for edge in moving if (edge.parent, edge.child) == (parent, child)]
        if not mine:
            return None
        stamps_ns, positions_m, quats_xyzw = (
            np.concatenate([getattr(edge, name) for edge in mine])
            for name in ("stamps_ns", "positions_m", "quats_xyzw")
        )
        received = [edge.received_ns for edge in mine if edge.received_ns is not None]
        received_ns = np.concatenate(received) if len(received) == len(mine) else None
        parts.append(_trajectory(stamps_ns, positions_m, quats_xyzw, "/tf", received_ns)[0])
    if not parts or any(len(part) == 0 for part in parts):
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


def imu_of(raw: RawImu) -> tuple[ImuStream | None, list[str]]:
    """(the stream, what was odd); None when no message has sound numbers."""
    rates_rad_s, forces_m_s2 = raw.angular_velocity_rad_s, raw.linear_acceleration_m_s2
    usable = np.asarray(is_sound(rates_rad_s) & is_sound(forces_m_s2))
    stamps_ns, rows, warnings = in_order(raw.stamps_ns, usable, raw.topic, raw.received_ns)
    if stamps_ns.size == 0:
        return None, warnings
    if rows.size < usable.size or (np.diff(rows) != 1).any():  # else no second copy of hours
        rates_rad_s, forces_m_s2 = rates_rad_s[rows], forces_m_s2[rows]
    return ImuStream(stamps_ns, rates_rad_s, forces_m_s2, raw.frame_ids[0]), warnings


def encoders_of(raw: RawTicks) -> tuple[EncoderStream | None, list[str]]:
    """(the stream, what was odd); None when its constants make no wheels."""
    constants = raw.ticks_per_revolution, raw.wheel_radius_m, raw.track_m
    are_wheels = all(LEAST_SIZE_M <= number <= MOST for number in constants)
    if raw.constants_change or not are_wheels:
        told = "{} ticks a turn, radius {} m, track {} m".format(*constants)
        return None, [f"{raw.topic}: {told} change or make no wheels: left out"]
    every = np.ones(raw.stamps_ns.size, dtype=np.bool_)
    stamps_ns, rows, warnings = in_order(raw.stamps_ns, every, raw.topic, raw.received_ns)
    return EncoderStream(stamps_ns, raw.ticks[rows], *constants), warnings


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
