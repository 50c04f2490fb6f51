"""What a driver makes of its wheels: odometry with other distances and turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between, compose, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream, FloatArray, IntArray, PlanarTrajectory
from slamsim.core.wheels import wheel_odometry
from slamsim.recording import RawJoints, RawOdometry, RawTicks, Recording, TransformEdge
from slamsim.sensors.faults.base import CannotInject
from slamsim.sensors.faults.edit import is_odometry, require_wheels

Gain = float | FloatArray


def with_odometry(recording: Recording, forward: Gain, turn: Gain) -> Recording:
    """Odometry, and the transform that goes with it, with distances and turns multiplied.

    forward, turn: one number, or one for each message but the first. Raises CannotInject for a
    recording without wheels.
    """
    require_wheels(recording)
    return replace(
        recording.changed(RawOdometry, lambda one: scaled_odometry(one, forward, turn)),
        transforms=tuple(
            scaled_edge(edge, forward, turn) if is_odometry(edge) else edge
            for edge in recording.transforms
        ),
    )


def scaled_odometry(odometry: RawOdometry, forward: Gain, turn: Gain) -> RawOdometry:
    positions, quats = _scaled(odometry.positions_m, odometry.quats_xyzw, forward, turn)
    return replace(
        odometry,
        positions_m=positions,
        quats_xyzw=quats,
        linear_m_s=odometry.linear_m_s * _per_message(forward, len(odometry)),
        angular_rad_s=odometry.angular_rad_s * _per_message(turn, len(odometry)),
    )


def scaled_edge(edge: TransformEdge, forward: Gain, turn: Gain) -> TransformEdge:
    positions, quats = _scaled(edge.positions_m, edge.quats_xyzw, forward, turn)
    return replace(edge, positions_m=positions, quats_xyzw=quats)


def _scaled(
    positions_m: FloatArray, quats_xyzw: FloatArray, forward: Gain, turn: Gain
) -> tuple[FloatArray, FloatArray]:
    """The path driven anew: each step seen from the heading midway, then multiplied."""
    headings = np.unwrap(yaw_from_xyzw(quats_xyzw))
    turned = np.diff(headings)
    step = _rotated(np.diff(positions_m[:, :2], axis=0), -(headings[:-1] + 0.5 * turned))
    anew = headings[0] + np.concatenate([[0.0], np.cumsum(turned * turn)])
    midway = anew[:-1] + 0.5 * turned * turn
    driven = _rotated(step * np.reshape(forward, (-1, 1)), midway)
    positions = positions_m.copy()
    positions[1:, :2] = positions_m[0, :2] + np.cumsum(driven, axis=0)
    return positions, xyzw_from_yaw(anew)


def with_wheel_steps(recording: Recording, gain: Callable[[IntArray], FloatArray]) -> Recording:
    """Counters, joints and odometry with each of their steps multiplied.

    gain: from (n,) stamps of one topic to the (n - 1,) factors of its steps. Raises CannotInject
    for a recording without wheels.
    """
    require_wheels(recording)
    return replace(
        recording.changed(
            RawTicks,
            lambda one: replace(
                one, ticks=_stepped(one.ticks, gain(one.stamps_ns)).astype(np.int64)
            ),
        )
        .changed(
            RawJoints,
            lambda one: replace(
                one,
                positions_rad=_stepped(one.positions_rad, gain(one.stamps_ns)),
                velocities_rad_s=one.velocities_rad_s * _per_message(gain(one.stamps_ns), len(one)),
            ),
        )
        .changed(
            RawOdometry, lambda one: scaled_odometry(one, gain(one.stamps_ns), gain(one.stamps_ns))
        ),
        transforms=tuple(
            scaled_edge(edge, gain(edge.stamps_ns), gain(edge.stamps_ns))
            if is_odometry(edge)
            else edge
            for edge in recording.transforms
        ),
    )


def rewired(recording: Recording, change: Callable[[FloatArray], FloatArray]) -> Recording:
    """The wheels' counters changed, and what the driver makes of them.

    change: from (n, 2) angles or counts of the (left, right) wheel to others, linearly. Raises
    CannotInject for a recording without counters.
    """
    require_ticks(recording)
    ticks = tuple(
        replace(one, ticks=change(one.ticks.astype(np.float64)).astype(np.int64))
        for one in recording.ticks
    )
    path = _driven(ticks[0])
    return replace(
        recording.with_streams(RawTicks, ticks)
        .changed(
            RawJoints,
            lambda one: replace(
                one,
                positions_rad=change(one.positions_rad),
                velocities_rad_s=change(one.velocities_rad_s),
            ),
        )
        .changed(RawOdometry, lambda one: _following(one, path)),
        transforms=tuple(
            _edge_following(edge, path) if is_odometry(edge) else edge
            for edge in recording.transforms
        ),
    )


def require_ticks(recording: Recording) -> None:
    """Raises CannotInject for a recording without counters."""
    if not any(len(ticks) for ticks in recording.ticks):
        raise CannotInject(f"{recording.name} has no wheel counters")


def _driven(ticks: RawTicks) -> PlanarTrajectory:
    return wheel_odometry(
        EncoderStream(
            ticks.stamps_ns,
            ticks.ticks,
            ticks.ticks_per_revolution,
            ticks.wheel_radius_m,
            ticks.track_m,
        )
    )


def _following(odometry: RawOdometry, path: PlanarTrajectory) -> RawOdometry:
    poses, quats = _at(odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw, path)
    heading = np.unwrap(yaw_from_xyzw(quats))
    elapsed_s = np.maximum(np.diff(odometry.stamps_ns), 1) * 1e-9
    ahead = _rotated(np.diff(poses[:, :2], axis=0), -heading[:-1])[:, 0] / elapsed_s
    linear, angular = np.zeros_like(odometry.linear_m_s), np.zeros_like(odometry.angular_rad_s)
    linear[1:, 0], angular[1:, 2] = ahead, np.diff(heading) / elapsed_s
    return replace(
        odometry, positions_m=poses, quats_xyzw=quats, linear_m_s=linear, angular_rad_s=angular
    )


def _edge_following(edge: TransformEdge, path: PlanarTrajectory) -> TransformEdge:
    positions, quats = _at(edge.stamps_ns, edge.positions_m, edge.quats_xyzw, path)
    return replace(edge, positions_m=positions, quats_xyzw=quats)


def _at(
    stamps_ns: IntArray, positions_m: FloatArray, quats_xyzw: FloatArray, path: PlanarTrajectory
) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 3) and quaternions (n, 4) along the path, from the first pose given."""
    x, y = (np.interp(stamps_ns, path.stamps_ns, path.poses[:, column]) for column in (0, 1))
    yaw = np.interp(stamps_ns, path.stamps_ns, np.unwrap(path.poses[:, 2]))
    along = np.column_stack([x, y, yaw])
    start = np.append(positions_m[0, :2], yaw_from_xyzw(quats_xyzw[0]))
    poses = compose(start, between(along[0], along))
    positions = positions_m.copy()
    positions[:, :2] = poses[:, :2]
    return positions, xyzw_from_yaw(poses[:, 2])


def _stepped(values: FloatArray | IntArray, gains: FloatArray) -> FloatArray:
    """(n, columns) with the steps between rows multiplied."""
    steps = np.diff(values, axis=0) * gains[:, None]
    return np.asarray(values[:1] + np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, 0)]))


def _per_message(gain: Gain, count: int) -> FloatArray:
    """(count, 1) or (1, 1): the first message repeats the second one's."""
    if np.ndim(gain) == 0:
        return np.reshape(np.asarray(gain, dtype=np.float64), (1, 1))
    gains = np.asarray(gain, dtype=np.float64)
    return np.concatenate([gains[:1], gains])[:count, None]


def _rotated(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    x = cos * vectors[:, 0] - sin * vectors[:, 1]
    y = sin * vectors[:, 0] + cos * vectors[:, 1]
    return np.column_stack([x, y])
