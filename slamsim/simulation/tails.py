"""State that a recording keeps between two windows of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.arrays import Samples
from slamsim.core.geometry import matrix_from_xyzw, wrap_angle, xyzw_from_yaw
from slamsim.core.types import (
    BoolArray,
    Drive,
    EncoderStream,
    FloatArray,
    IntArray,
    Trajectory,
)
from slamsim.models.differential_drive import forward_and_turn, metres_per_tick, poses_along
from slamsim.recording import RawOdometry


def at_rate(stamps_ns: IntArray, previous_ns: int | None, rate_hz: float) -> BoolArray:
    """(n,) whether a stamp is the first of its period; the choice does not depend on windows.

    previous_ns is the stamp before the first one, None at the beginning, which always counts.
    """
    before = np.concatenate([[stamps_ns[0] if previous_ns is None else previous_ns], stamps_ns])
    period = np.floor(before * (rate_hz * 1e-9) + 1e-6)
    chosen = np.asarray(np.diff(period) > 0)
    if previous_ns is None:
        chosen[0] = True
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class WheelMotion(Samples):
    """One row per encoder reading.

    angles_rad, speeds_rad_s: (n, 2) of the wheels. positions_m (n, 3), quats_xyzw (n, 4):
    ``T_odom_base``. linear_m_s, angular_rad_s: (n, 3) in the base frame since the last reading.
    """

    angles_rad: FloatArray
    speeds_rad_s: FloatArray
    positions_m: FloatArray
    quats_xyzw: FloatArray
    linear_m_s: FloatArray
    angular_rad_s: FloatArray


class OdometryTail:
    """Wheel odometry over windows: each begins where the last reading left the robot."""

    def __init__(self) -> None:
        self._last: EncoderStream | None = None
        self._last_pose: FloatArray = np.zeros(3)  # its heading is not wrapped

    def extend(self, stream: EncoderStream) -> WheelMotion:
        """The wheels' motion at each reading of the next, non-empty, part of the stream."""
        first = self._last is None
        joined = stream if self._last is None else EncoderStream.joined([self._last, stream])
        radians_per_tick = 2.0 * np.pi / joined.ticks_per_revolution
        tick_m = metres_per_tick(joined.ticks_per_revolution, joined.wheel_radius_m)
        arcs = forward_and_turn(np.diff(joined.ticks, axis=0) * tick_m, joined.track_m)
        poses = poses_along(arcs, self._last_pose)
        elapsed_s = np.diff(joined.stamps_ns) * 1e-9
        moved = elapsed_s > 0.0
        speeds = np.zeros((elapsed_s.size, 2))
        turned_rad = np.diff(joined.ticks, axis=0) * radians_per_tick
        speeds[moved] = turned_rad[moved] / elapsed_s[moved, None]
        if first:
            speeds = np.concatenate([np.zeros((1, 2)), speeds])
        else:
            poses = poses[1:]
        self._last = stream.select(slice(-1, None))
        self._last_pose = poses[-1]
        zero = np.zeros(len(poses))
        forward_m_s = speeds.mean(axis=1) * stream.wheel_radius_m
        yaw_rate_rad_s = (speeds[:, 1] - speeds[:, 0]) * stream.wheel_radius_m / stream.track_m
        return WheelMotion(
            stream.ticks.astype(np.float64) * radians_per_tick,
            speeds,
            np.column_stack([poses[:, :2], zero]),
            xyzw_from_yaw(wrap_angle(poses[:, 2])),
            np.column_stack([forward_m_s, zero, zero]),
            np.column_stack([zero, zero, yaw_rate_rad_s]),
        )


class TruthTail:
    """Thins the true motion to a rate, and keeps its last sample so that the end is covered."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._unwritten: Drive | None = None

    def take(self, window: Drive, previous_ns: int | None) -> Drive:
        """The samples to record of the next, non-empty, window."""
        chosen = at_rate(window.stamps_ns, previous_ns, self._rate_hz)
        self._unwritten = None if chosen[-1] else window.select(np.array([len(window) - 1]))
        return window.select(np.flatnonzero(chosen))

    @property
    def rest(self) -> Drive | None:
        """The last sample of the drive, if it was thinned out."""
        return self._unwritten

    @staticmethod
    def twist_in_base(truth: Drive) -> tuple[FloatArray, FloatArray]:
        """(n, 3) linear in m/s and angular in rad/s, turned from the map into the base frame."""
        R_base_map = np.swapaxes(matrix_from_xyzw(truth.quats_xyzw), -1, -2)
        linear = np.einsum("nij,nj->ni", R_base_map, truth.linear_velocity_m_s)
        return linear, np.einsum("nij,nj->ni", R_base_map, truth.angular_velocity_rad_s)


def joined_path(parts: Sequence[Drive | RawOdometry | Trajectory]) -> Trajectory:
    """The poses of consecutive parts."""
    return Trajectory(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.positions_m for part in parts]),
        np.concatenate([part.quats_xyzw for part in parts]),
    )
