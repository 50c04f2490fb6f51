"""Planar motion of odometry and wheel counters, split into increments and recombined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between, compose, wrap_angle, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream, FloatArray, IntArray, PlanarTrajectory
from slamsim.models.differential_drive import wheel_odometry
from slamsim.recording import RawOdometry, RawTicks, TransformEdge
from slamsim.recording.edits.messages import select

Gain = float | FloatArray
"""A factor of all steps, or (n - 1,) of each step between n messages."""
_BESIDE = 2
"""Steps on either side."""
_SAME_PATH = 0.1
"""Of path and turn, by which an odometry that is made from counters may differ from them."""


def scaled_odometry(
    odometry: RawOdometry, path: Gain, turn: Gain, curvature_rad_m: float = 0.0
) -> RawOdometry:
    """Poses and twists with distances and turns multiplied.

    curvature_rad_m: by how much the robot turns more on each metre of the path as it was.
    """
    positions, quats = _scaled(
        odometry.positions_m, odometry.quats_xyzw, path, turn, curvature_rad_m
    )
    angular_rad_s = odometry.angular_rad_s * per_message(turn, len(odometry))
    angular_rad_s[:, 2] += curvature_rad_m * odometry.linear_m_s[:, 0]
    return replace(
        odometry,
        positions_m=positions,
        quats_xyzw=quats,
        linear_m_s=odometry.linear_m_s * per_message(path, len(odometry)),
        angular_rad_s=angular_rad_s,
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
    positions[1:, :2] = positions[0, :2] + np.cumsum(rotated(steps[:, :2], yaw[:-1]), axis=0)
    return replace(odometry, positions_m=positions, quats_xyzw=xyzw_from_yaw(yaw))


def counted(odometry: RawOdometry, ticks: RawTicks) -> RawOdometry:
    """The counters' poses and speeds at the odometry's stamps, from its first pose on."""
    positions, quats = along_path(odometry, wheel_odometry(ordered_encoder_stream(ticks)))
    return with_twists(replace(odometry, positions_m=positions, quats_xyzw=quats))


def encoder_stream(ticks: RawTicks) -> EncoderStream:
    """Counters with the driver's numbers, in the order of the file."""
    numbers = ticks.ticks_per_revolution, ticks.wheel_radius_m, ticks.track_m
    return EncoderStream(ticks.stamps_ns, ticks.ticks, *numbers)


def ordered_encoder_stream(ticks: RawTicks) -> EncoderStream:
    """The same by increasing stamps, the first message of each."""
    order = np.unique(ticks.stamps_ns, return_index=True)[1]
    return encoder_stream(select(ticks, order))


def _scaled(
    positions_m: FloatArray,
    quats_xyzw: FloatArray,
    path: Gain,
    turn: Gain,
    curvature_rad_m: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """The path driven anew: each step seen from the heading midway, then multiplied."""
    headings = np.unwrap(yaw_from_xyzw(quats_xyzw))
    turned = np.diff(headings)
    step = rotated(np.diff(positions_m[:, :2], axis=0), -(headings[:-1] + 0.5 * turned))
    made = turned * turn + curvature_rad_m * step[:, 0]
    anew = headings[0] + np.concatenate([[0.0], np.cumsum(made)])
    midway = anew[:-1] + 0.5 * made
    driven = rotated(step * np.reshape(path, (-1, 1)), midway)
    positions = positions_m.copy()
    positions[1:, :2] = positions_m[0, :2] + np.cumsum(driven, axis=0)
    return positions, xyzw_from_yaw(anew)


def along_path(
    one: RawOdometry | TransformEdge, path: PlanarTrajectory
) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 3) and quaternions (n, 4) along the path, from the first pose that it has."""
    # Since the path's begin: nanoseconds since 1970 are no exact floating-point numbers.
    asked, known = (stamps_ns - path.stamps_ns[0] for stamps_ns in (one.stamps_ns, path.stamps_ns))
    columns = (*path.poses[:, :2].T, np.unwrap(path.poses[:, 2]))
    along = np.column_stack([np.interp(asked, known, column) for column in columns])
    poses = compose(_planar(one)[0], between(along[0], along))
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


def continuous_heading(quats_xyzw: FloatArray) -> FloatArray:
    """(n,) yaw that turns from one message to the next about as fast as beside it.

    Headings in degrees that were taken for radians turn by more than half a turn at once, and by
    360 radians more where they begin anew.
    """
    yaw = yaw_from_xyzw(quats_xyzw)
    steps = np.unwrap(np.diff(yaw))
    if steps.size > 2 * _BESIDE:
        beside = np.pad(steps, _BESIDE, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(beside, 2 * _BESIDE + 1)
        usual = np.median(windows, axis=1)
        anew = usual[:, None] + wrap_angle(steps[:, None] - usual[:, None] + [0.0, 360.0, -360.0])
        nearest = np.abs(anew - usual[:, None]).argmin(axis=1)
        steps = np.take_along_axis(anew, nearest[:, None], axis=1)[:, 0]
    return np.asarray(yaw[0] + np.concatenate([[0.0], np.cumsum(steps)]))


def scaled_heading(odometry: RawOdometry, factor: float) -> RawOdometry:
    """The heading multiplied, the path as it is: what the robot drives along, mostly ahead, tells
    which of all headings it begins with that a whole turn before leaves open."""
    heading = factor * continuous_heading(odometry.quats_xyzw)
    moved = np.diff(odometry.positions_m[:, :2], axis=0)
    ahead = (moved[:, 0] + 1j * moved[:, 1]) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
    turn = 2.0 * np.pi * factor
    heading += turn * round(float(np.angle(np.nansum(ahead))) / turn)
    return replace(odometry, quats_xyzw=xyzw_from_yaw(heading))


def _planar(one: RawOdometry | TransformEdge) -> FloatArray:
    """(n, 3) x, y, yaw."""
    return np.column_stack([one.positions_m[:, :2], yaw_from_xyzw(one.quats_xyzw)])


def follows(odometry: RawOdometry, ticks: RawTicks) -> bool:
    """Whether an odometry goes as far and turns as much as these counters say."""
    if len(odometry) < 2:
        return False
    both = (planar_steps(counted(odometry, ticks)), planar_steps(odometry))
    amounts = [np.abs(steps[:, [0, 2]]).sum(axis=0) for steps in both]
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
