"""Planar motion of odometry and wheel counters, split into increments and recombined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between, compose, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream, FloatArray, IntArray, PlanarTrajectory
from slamsim.core.wheels import wheel_odometry
from slamsim.recording import RawOdometry, RawTicks, TransformEdge
from slamsim.recording.edits.messages import select

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


def repaced(
    odometry: RawOdometry, path: float, turn: float, curvature_rad_m: float = 0.0
) -> RawOdometry:
    """``scaled_odometry`` as repairs have it, each step taken in the heading at its beginning.

    Equal to 1e-16 where turns are kept; one of the two formulas would do if the bytes of what
    ``fix`` writes might change.
    """
    steps = planar_steps(odometry)
    curved_rad = curvature_rad_m * steps[:, 0]
    steps = steps * np.array([path, path, turn])
    steps[:, 2] += curved_rad
    angular_rad_s = odometry.angular_rad_s * turn
    angular_rad_s[:, 2] += curvature_rad_m * odometry.linear_m_s[:, 0]
    return replace(
        with_steps(odometry, steps),
        linear_m_s=odometry.linear_m_s * path,
        angular_rad_s=angular_rad_s,
    )


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
    positions[1:, :2] = positions[0, :2] + np.cumsum(rotated(steps[:, :2], yaw[:-1]), axis=0)
    return replace(odometry, positions_m=positions, quats_xyzw=xyzw_from_yaw(yaw))


def counted(odometry: RawOdometry, ticks: RawTicks) -> RawOdometry:
    """The counters' poses and speeds at the odometry's stamps, from its first pose on.

    As ``along_path`` and ``with_twists``, which faults take, but for the speed to the side that
    the chord of an arc has (1e-4 m/s): what ``fix`` writes keeps it.
    """
    poses = _poses_at(ticks, odometry)
    placed = compose(_planar(odometry)[0], between(poses[0], poses))
    positions = odometry.positions_m.copy()
    positions[:, :2] = placed[:, :2]
    seconds = np.maximum(np.diff(odometry.stamps_ns) * 1e-9, 1e-9)
    steps = between(placed[:-1], placed[1:]) / seconds[:, None]
    speeds = np.concatenate([np.zeros((1, 3)), steps])
    zero = np.zeros(len(speeds))
    return replace(
        odometry,
        positions_m=positions,
        quats_xyzw=xyzw_from_yaw(placed[:, 2]),
        linear_m_s=np.column_stack([speeds[:, 0], speeds[:, 1], zero]),
        angular_rad_s=np.column_stack([zero, zero, speeds[:, 2]]),
    )


def encoder_stream(ticks: RawTicks) -> EncoderStream:
    """Counters with the driver's numbers, in the order of the file."""
    numbers = ticks.ticks_per_revolution, ticks.wheel_radius_m, ticks.track_m
    return EncoderStream(ticks.stamps_ns, ticks.ticks, *numbers)


def ordered_encoder_stream(ticks: RawTicks) -> EncoderStream:
    """The same by increasing stamps, the first message of each."""
    order = np.unique(ticks.stamps_ns, return_index=True)[1]
    return encoder_stream(select(ticks, order))


def _scaled(
    positions_m: FloatArray, quats_xyzw: FloatArray, path: Gain, turn: Gain
) -> tuple[FloatArray, FloatArray]:
    """The path driven anew: each step seen from the heading midway, then multiplied."""
    headings = np.unwrap(yaw_from_xyzw(quats_xyzw))
    turned = np.diff(headings)
    step = rotated(np.diff(positions_m[:, :2], axis=0), -(headings[:-1] + 0.5 * turned))
    anew = headings[0] + np.concatenate([[0.0], np.cumsum(turned * turn)])
    midway = anew[:-1] + 0.5 * turned * turn
    driven = rotated(step * np.reshape(path, (-1, 1)), midway)
    positions = positions_m.copy()
    positions[1:, :2] = positions_m[0, :2] + np.cumsum(driven, axis=0)
    return positions, xyzw_from_yaw(anew)


def along_path(
    one: RawOdometry | TransformEdge, path: PlanarTrajectory
) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 3) and quaternions (n, 4) along the path, from the first pose that it has."""
    x, y = (np.interp(one.stamps_ns, path.stamps_ns, path.poses[:, column]) for column in (0, 1))
    yaw = np.interp(one.stamps_ns, path.stamps_ns, np.unwrap(path.poses[:, 2]))
    along = np.column_stack([x, y, yaw])
    start = np.append(one.positions_m[0, :2], yaw_from_xyzw(one.quats_xyzw[0]))
    poses = compose(start, between(along[0], along))
    positions = one.positions_m.copy()
    positions[:, :2] = poses[:, :2]
    return positions, xyzw_from_yaw(poses[:, 2])


def with_twists(odometry: RawOdometry) -> RawOdometry:
    """Speeds by the steps between poses; a wheeled robot has none to the side."""
    heading = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
    elapsed_s = np.maximum(np.diff(odometry.stamps_ns), 1) * 1e-9
    moved = np.diff(odometry.positions_m[:, :2], axis=0)
    linear, angular = np.zeros_like(odometry.linear_m_s), np.zeros_like(odometry.angular_rad_s)
    linear[1:, 0] = rotated(moved, -heading[:-1])[:, 0] / elapsed_s
    angular[1:, 2] = np.diff(heading) / elapsed_s
    return replace(odometry, linear_m_s=linear, angular_rad_s=angular)


def _planar(odometry: RawOdometry) -> FloatArray:
    return np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])


def _poses_at(ticks: RawTicks, odometry: RawOdometry) -> FloatArray:
    """(m, 3) the counters' poses at the odometry's stamps, held at the ends."""
    path = wheel_odometry(ordered_encoder_stream(ticks))
    return path.at(np.clip(odometry.stamps_ns, path.stamps_ns[0], path.stamps_ns[-1]))


def follows(odometry: RawOdometry, ticks: RawTicks) -> bool:
    """Whether an odometry goes as far and turns as much as these counters say."""
    if len(odometry) < 2:
        return False
    poses = _poses_at(ticks, odometry)
    amounts = [
        np.array([np.abs(steps[:, 0]).sum(), np.abs(steps[:, 2]).sum()])
        for steps in (between(poses[:-1], poses[1:]), planar_steps(odometry))
    ]
    return bool((np.abs(amounts[0] - amounts[1]) <= _SAME_PATH * amounts[0] + 1e-6).all())


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


def rotated(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """(n, 2) vectors turned by (n,) angles."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    x = cos * vectors[:, 0] - sin * vectors[:, 1]
    y = sin * vectors[:, 0] + cos * vectors[:, 1]
    return np.column_stack([x, y])
