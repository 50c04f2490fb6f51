"""The planar motion of odometry and wheel counters, taken apart into steps and put together."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from slamsim.core.geometry import between, compose, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream, FloatArray, IntArray, PlanarTrajectory
from slamsim.core.wheels import wheel_odometry
from slamsim.recording import RawOdometry, RawTicks, TransformEdge
from slamsim.recording.edits.messages import select

Moving = TypeVar("Moving", RawOdometry, TransformEdge)
Gain = float | FloatArray
"""A factor of all steps, or (n - 1,) of each step between n messages."""
_SAME_PATH = 0.1
"""Of path and turn, by which an odometry that is made from counters may differ from them."""


def scaled_odometry(odometry: RawOdometry, path: Gain, turn: Gain) -> RawOdometry:
    """Poses and twists with distances and turns multiplied."""
    positions, quats = _scaled(odometry.positions_m, odometry.quats_xyzw, path, turn)
    return replace(
        odometry,
        positions_m=positions,
        quats_xyzw=quats,
        linear_m_s=odometry.linear_m_s * per_message(path, len(odometry)),
        angular_rad_s=odometry.angular_rad_s * per_message(turn, len(odometry)),
    )


def scaled_edge(edge: TransformEdge, path: Gain, turn: Gain) -> TransformEdge:
    """A moving transform with distances and turns multiplied."""
    positions, quats = _scaled(edge.positions_m, edge.quats_xyzw, path, turn)
    return replace(edge, positions_m=positions, quats_xyzw=quats)


def without_jumps(odometry: RawOdometry, longest_m: float) -> RawOdometry:
    """Moving on as before where a step is longer than longest_m; one at the begin is left out."""
    steps = planar_steps(odometry)
    jumps = np.hypot(steps[:, 0], steps[:, 1]) > longest_m
    steps[jumps & (np.arange(jumps.size) == 0)] = 0.0
    before = np.maximum.accumulate(np.where(jumps, 0, np.arange(jumps.size)))
    return with_steps(odometry, steps[before])


def planar_steps(odometry: RawOdometry) -> FloatArray:
    """(n - 1, 3) x, y, yaw from each of n poses to the next, seen from it."""
    poses = _planar(odometry)
    return between(poses[:-1], poses[1:]) if len(poses) > 1 else np.zeros((0, 3))


def with_steps(odometry: RawOdometry, steps: FloatArray) -> RawOdometry:
    """The odometry that begins as before and takes these steps (n - 1, 3)."""
    yaw = _planar(odometry)[0, 2] + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    positions = odometry.positions_m.copy()
    positions[1:, :2] = positions[0, :2] + np.cumsum(_rotated(steps[:, :2], yaw[:-1]), axis=0)
    return replace(odometry, positions_m=positions, quats_xyzw=xyzw_from_yaw(yaw))


def driven_path(ticks: RawTicks) -> PlanarTrajectory:
    """``T_odom_base`` by the counters and the driver's numbers, at increasing stamps."""
    ordered = select(ticks, np.unique(ticks.stamps_ns, return_index=True)[1])
    numbers = ticks.ticks_per_revolution, ticks.wheel_radius_m, ticks.track_m
    return wheel_odometry(EncoderStream(ordered.stamps_ns, ordered.ticks, *numbers))


def following(one: Moving, path: PlanarTrajectory) -> Moving:
    """Odometry, or its transform, along a path: at its own stamps, from its first pose on.

    Speeds are those of the steps between poses; a wheeled robot has none to the side.
    """
    along = _poses_at(path, one.stamps_ns)
    start = np.append(one.positions_m[0, :2], yaw_from_xyzw(one.quats_xyzw[0]))
    poses = compose(start, between(along[0], along))
    positions = one.positions_m.copy()
    positions[:, :2] = poses[:, :2]
    quats = xyzw_from_yaw(poses[:, 2])
    if isinstance(one, TransformEdge):
        return replace(one, positions_m=positions, quats_xyzw=quats)
    return _with_twists(replace(one, positions_m=positions, quats_xyzw=quats))


def follows(odometry: RawOdometry, path: PlanarTrajectory) -> bool:
    """Whether an odometry goes about as far and turns as much as a path."""
    if len(odometry) < 2:
        return False
    poses = _poses_at(path, odometry.stamps_ns)
    amounts = [
        np.array([np.abs(steps[:, 0]).sum(), np.abs(steps[:, 2]).sum()])
        for steps in (between(poses[:-1], poses[1:]), planar_steps(odometry))
    ]
    return bool((np.abs(amounts[0] - amounts[1]) <= _SAME_PATH * amounts[0] + 1e-6).all())


def _scaled(
    positions_m: FloatArray, quats_xyzw: FloatArray, path: Gain, turn: Gain
) -> tuple[FloatArray, FloatArray]:
    """The path driven anew: each step seen from the heading midway, then multiplied."""
    headings = np.unwrap(yaw_from_xyzw(quats_xyzw))
    turned = np.diff(headings)
    step = _rotated(np.diff(positions_m[:, :2], axis=0), -(headings[:-1] + 0.5 * turned))
    anew = headings[0] + np.concatenate([[0.0], np.cumsum(turned * turn)])
    midway = anew[:-1] + 0.5 * turned * turn
    driven = _rotated(step * np.reshape(path, (-1, 1)), midway)
    positions = positions_m.copy()
    positions[1:, :2] = positions_m[0, :2] + np.cumsum(driven, axis=0)
    return positions, xyzw_from_yaw(anew)


def _with_twists(odometry: RawOdometry) -> RawOdometry:
    """With the speeds that its poses have."""
    heading = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
    elapsed_s = np.maximum(np.diff(odometry.stamps_ns), 1) * 1e-9
    moved = np.diff(odometry.positions_m[:, :2], axis=0)
    linear, angular = np.zeros_like(odometry.linear_m_s), np.zeros_like(odometry.angular_rad_s)
    linear[1:, 0] = _rotated(moved, -heading[:-1])[:, 0] / elapsed_s
    angular[1:, 2] = np.diff(heading) / elapsed_s
    return replace(odometry, linear_m_s=linear, angular_rad_s=angular)


def _planar(odometry: RawOdometry) -> FloatArray:
    return np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])


def _poses_at(path: PlanarTrajectory, stamps_ns: IntArray) -> FloatArray:
    """(m, 3) poses of a path at (m,) stamps, held at its ends; the heading is unwrapped."""
    x, y = (np.interp(stamps_ns, path.stamps_ns, path.poses[:, column]) for column in (0, 1))
    yaw = np.interp(stamps_ns, path.stamps_ns, np.unwrap(path.poses[:, 2]))
    return np.column_stack([x, y, yaw])


def stepped(values: FloatArray | IntArray, gains: FloatArray) -> FloatArray:
    """(n, columns) with the steps between rows multiplied."""
    steps = np.diff(values, axis=0) * gains[:, None]
    return np.asarray(values[:1] + np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, 0)]))


def per_message(gain: Gain, count: int) -> FloatArray:
    """(count, 1) or (1, 1): the first message repeats the second one's."""
    if np.ndim(gain) == 0:
        return np.reshape(np.asarray(gain, dtype=np.float64), (1, 1))
    gains = np.asarray(gain, dtype=np.float64)
    return np.concatenate([gains[:1], gains])[:count, None]


def _rotated(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """(n, 2) vectors turned by (n,) angles."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    x = cos * vectors[:, 0] - sin * vectors[:, 1]
    y = sin * vectors[:, 0] + cos * vectors[:, 1]
    return np.column_stack([x, y])
