"""Kinematics of a differential drive: from wheel counters to arcs, and from arcs to poses.

Between two readings both wheels turn at constant speeds, so that the robot drives a circular arc
(the chord at the mean heading is exact: Borenstein, Everett & Feng 1996).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from slamsim.core.geometry import between, wrap_angle
from slamsim.core.types import EncoderStream, FloatArray, PlanarTrajectory

_Number = TypeVar("_Number", float, FloatArray)


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
        """As ``lever_m2`` of the track."""
        return lever_m2(self.track_m)


def metres_per_tick(ticks_per_revolution: float, wheel_radius_m: float) -> float:
    """How far a wheel rolls from one tick of its counter to the next, m."""
    return 2.0 * np.pi * wheel_radius_m / ticks_per_revolution


def lever_m2(track_m: float) -> float:
    """How far wheels of unequal size drive forward per radian and difference in curvature, m^2."""
    return 0.25 * track_m**2


def forward_and_turn(rolled_m: FloatArray, track_m: float | FloatArray) -> FloatArray:
    """(n, 2) path of the base in m and its turn in rad, counter-clockwise, of wheels that rolled
    (n, 2) metres, left and right, on a track in m: one for all or (n,)."""
    turned_rad = (rolled_m[:, 1] - rolled_m[:, 0]) / track_m
    return np.column_stack([rolled_m.mean(axis=1), turned_rad])


def left_and_right(forward: _Number, turn: _Number, track_m: float) -> tuple[_Number, _Number]:
    """How far, or how fast, both wheels roll (m, or m/s) while the base goes forward (likewise) and
    turns (rad, or rad/s); the inverse of ``forward_and_turn``. Numbers, or arrays (n,)."""
    apart = 0.5 * track_m * turn
    return forward - apart, forward + apart


def calibrated_motion(
    motion: FloatArray, path_gain: float, turn_gain: float, curvature: float, lever: float
) -> FloatArray:
    """(n, 2) path in m and turn in rad of wheels whose sizes are not as their driver has them.

    motion: (n, 2) as reported, or its integral. path_gain, turn_gain: true over reported.
    curvature: rad/m on what is reported as straight. lever: ``lever_m2`` of the track. Equal to
    what ``wheel_gyro.walk`` does with path_gain = 1 + path scale error.
    """
    path_m, turned_rad = motion[:, 0], motion[:, 1]
    along_m = path_gain * path_m + curvature * lever * turned_rad
    return np.column_stack([along_m, turn_gain * turned_rad + curvature * path_m])


def chord_of(
    forward_m: FloatArray, turned_rad: FloatArray, heading_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n,) x and y, m, from the beginning of each arc to its end; heading (n,) at its beginning."""
    midway_rad = heading_rad + 0.5 * turned_rad
    chord_m = forward_m * np.sinc(turned_rad / (2.0 * np.pi))
    return chord_m * np.cos(midway_rad), chord_m * np.sin(midway_rad)


def poses_along(motion: FloatArray, start_pose: FloatArray) -> FloatArray:
    """(n + 1, 3) poses x, y in m and yaw in rad, not wrapped, of a base that drives n arcs.

    motion: (n, 2) path in m and turn in rad of each arc. start_pose: (3,). Sums begin at the start
    pose, so that a path which is cut in two gives the same bits as the whole.
    """
    forward_m, turned_rad = motion.T
    yaw = np.cumsum(np.concatenate([start_pose[2:], turned_rad]))
    steps = chord_of(forward_m, turned_rad, yaw[:-1])
    x, y = (
        np.cumsum(np.concatenate([start_pose[[axis]], step_m])) for axis, step_m in enumerate(steps)
    )
    return np.column_stack([x, y, yaw])


def arcs_between(poses: FloatArray) -> FloatArray:
    """(n - 1, 3) forward and sideways along the arc in m, and turn in rad, from each of n poses
    (n, 3) to the next; the inverse of ``poses_along`` for a base that may slide sideways."""
    step = between(poses[:-1], poses[1:])
    half = 0.5 * step[:, 2]
    # The inverse of the integral of a rotation: the chord turned back by half, and stretched.
    stretch = 1.0 / np.sinc(half / np.pi)
    cos, sin = np.cos(half), np.sin(half)
    along = (cos * step[:, 0] + sin * step[:, 1]) * stretch
    across = (-sin * step[:, 0] + cos * step[:, 1]) * stretch
    return np.column_stack([along, across, step[:, 2]])


def encoder_reading(encoders: EncoderStream) -> Reading:
    """Of two counters that round down to whole ticks (uniform errors at both ends)."""
    tick_m = metres_per_tick(encoders.ticks_per_revolution, encoders.wheel_radius_m)
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

    start_pose: (3,) x, y in m and yaw in rad, the origin if None.
    """
    start = np.zeros(3) if start_pose is None else np.asarray(start_pose, dtype=np.float64)
    tick_m = metres_per_tick(encoders.ticks_per_revolution, encoders.wheel_radius_m)
    rolled_m = np.diff(encoders.ticks, axis=0) * tick_m
    return PlanarTrajectory(encoders.stamps_ns, rolled_poses(rolled_m, encoders.track_m, start))


def rolled_poses(rolled_m: FloatArray, track_m: float, start_pose: FloatArray) -> FloatArray:
    """(n + 1, 3) ``T_odom_base`` of wheels that roll (n, 2) m, left and right, arc by arc."""
    poses = poses_along(forward_and_turn(rolled_m, track_m), start_pose)
    return np.column_stack([poses[:, :2], wrap_angle(poses[:, 2])])


def _least_step(values: FloatArray) -> float:
    """The least distance of different values; 0 of fewer than two."""
    apart = np.diff(np.unique(values))
    return float(apart[apart > 1e-9].min(initial=np.inf)) if (apart > 1e-9).any() else 0.0
