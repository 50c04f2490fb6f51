"""SE(2) and SE(3) algebra on plain arrays.

A planar transform is ``(..., 3)``: x, y in metres and yaw in radians; it is written
``T_target_source`` as everywhere. Quaternions are ``(..., 4)`` in x, y, z, w order (as ROS).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float64]


def wrap_angle(angle_rad: _FloatArray) -> _FloatArray:
    """The same angles, of any shape, in [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2.0 * np.pi) - np.pi


def compose(T_a_b: _FloatArray, T_b_c: _FloatArray) -> _FloatArray:
    """``T_a_c`` of planar transforms, broadcasting over leading axes."""
    T_a_b, T_b_c = np.asarray(T_a_b, dtype=np.float64), np.asarray(T_b_c, dtype=np.float64)
    if T_a_b.ndim == 1 and T_b_c.ndim == 1:
        return _compose_two(T_a_b, T_b_c)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = T_a_b[..., 0] + cos * T_b_c[..., 0] - sin * T_b_c[..., 1]
    y = T_a_b[..., 1] + sin * T_b_c[..., 0] + cos * T_b_c[..., 1]
    return np.stack([x, y, wrap_angle(T_a_b[..., 2] + T_b_c[..., 2])], axis=-1)


def inverse(T_a_b: _FloatArray) -> _FloatArray:
    """``T_b_a`` (..., 3) of planar transforms (..., 3)."""
    T_a_b = np.asarray(T_a_b, dtype=np.float64)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = -cos * T_a_b[..., 0] - sin * T_a_b[..., 1]
    y = sin * T_a_b[..., 0] - cos * T_a_b[..., 1]
    return np.stack([x, y, wrap_angle(-T_a_b[..., 2])], axis=-1)


def between(T_a_b: _FloatArray, T_a_c: _FloatArray) -> _FloatArray:
    """``T_b_c`` (..., 3): where c stands as seen from b. T_a_b, T_a_c: (..., 3)."""
    T_a_b, T_a_c = np.asarray(T_a_b, dtype=np.float64), np.asarray(T_a_c, dtype=np.float64)
    if T_a_b.ndim == 1 and T_a_c.ndim == 1:
        return _between_two(T_a_b, T_a_c)
    return compose(inverse(T_a_b), T_a_c)


# Two single transforms, a hundred thousand times a log: plain floats take a tenth of the time.


def _compose_two(T_a_b: _FloatArray, T_b_c: _FloatArray) -> _FloatArray:
    (ax, ay, a_yaw), (bx, by, b_yaw) = T_a_b.tolist(), T_b_c.tolist()
    cos, sin = math.cos(a_yaw), math.sin(a_yaw)
    yaw = (a_yaw + b_yaw + math.pi) % (2.0 * math.pi) - math.pi
    return np.array([ax + cos * bx - sin * by, ay + sin * bx + cos * by, yaw])


def _between_two(T_a_b: _FloatArray, T_a_c: _FloatArray) -> _FloatArray:
    (bx, by, b_yaw), (cx, cy, c_yaw) = T_a_b.tolist(), T_a_c.tolist()
    cos, sin = math.cos(b_yaw), math.sin(b_yaw)
    yaw = (c_yaw - b_yaw + math.pi) % (2.0 * math.pi) - math.pi
    x, y = cx - bx, cy - by
    return np.array([cos * x + sin * y, -sin * x + cos * y, yaw])


def adjoint(T_a_b: _FloatArray) -> _FloatArray:
    """(..., 3, 3): takes a small step (x, y, yaw) seen in frame b to the same step in frame a."""
    T_a_b = np.asarray(T_a_b, dtype=np.float64)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = [
        np.stack([cos, -sin, T_a_b[..., 1]], axis=-1),
        np.stack([sin, cos, -T_a_b[..., 0]], axis=-1),
        np.stack([zero, zero, one], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def rotation(yaw_rad: _FloatArray) -> _FloatArray:
    """(..., 3, 3): turns x and y of a step (x, y, yaw), leaving yaw as it is."""
    turn = np.zeros((*np.shape(yaw_rad), 3))
    turn[..., 2] = yaw_rad
    return adjoint(turn)


def transform_points(T_a_b: _FloatArray, points_b: _FloatArray) -> _FloatArray:
    """(..., 2) planar points in frame a; one transform for all, or one for each."""
    T_a_b, points_b = np.asarray(T_a_b), np.asarray(points_b)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = T_a_b[..., 0] + cos * points_b[..., 0] - sin * points_b[..., 1]
    y = T_a_b[..., 1] + sin * points_b[..., 0] + cos * points_b[..., 1]
    return np.stack([x, y], axis=-1)


def chained(start: _FloatArray, steps: _FloatArray) -> _FloatArray:
    """(n + 1, 3) poses from a start (3,) along steps (n, 3), each seen from the pose before."""
    yaw = start[2] + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    x = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    y = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    path = np.vstack([np.zeros(2), np.column_stack([x, y])]) + start[:2]
    return np.column_stack([path, wrap_angle(yaw)])


def interpolate_se2(start: _FloatArray, end: _FloatArray, fraction: _FloatArray) -> _FloatArray:
    """Straight line in x and y, shortest turn in yaw, the given fraction (n,) of the way."""
    step = end - start
    step[..., 2] = wrap_angle(step[..., 2])
    pose = start + fraction[..., None] * step
    pose[..., 2] = wrap_angle(pose[..., 2])
    return np.asarray(pose, dtype=np.float64)


def slerp_xyzw(start: _FloatArray, end: _FloatArray, fraction: _FloatArray) -> _FloatArray:
    """(n, 4) unit quaternions the given fraction (n,) of the shortest way (Shoemake 1985)."""
    cos = np.sum(start * end, axis=-1)
    end = np.where(cos[..., None] < 0.0, -end, end)
    angle = np.arccos(np.clip(np.abs(cos), 0.0, 1.0))
    sin = np.sin(angle)
    near = sin < 1e-6
    safe_sin = np.where(near, 1.0, sin)
    weight_start = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe_sin)
    weight_end = np.where(near, fraction, np.sin(fraction * angle) / safe_sin)
    mixed = weight_start[..., None] * start + weight_end[..., None] * end
    return np.asarray(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True), dtype=np.float64)


def parts_xyzw(quat_xyzw: _FloatArray) -> tuple[_FloatArray, _FloatArray, _FloatArray, _FloatArray]:
    """The four parts, each (...), of quaternions (..., 4)."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    return quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]


def yaw_from_xyzw(quat_xyzw: _FloatArray) -> _FloatArray:
    """(...) heading of the rotated x axis in the x-y plane. quat_xyzw: (..., 4)."""
    x, y, z, w = parts_xyzw(quat_xyzw)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def xyzw_from_yaw(yaw_rad: _FloatArray) -> _FloatArray:
    """(..., 4) rotation by yaw about z."""
    half = 0.5 * np.asarray(yaw_rad, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def matrix_from_xyzw(quat_xyzw: _FloatArray) -> _FloatArray:
    """(..., 3, 3) rotation matrices."""
    x, y, z, w = parts_xyzw(quat_xyzw)
    # Entry by entry: stacking costs more than the products for the few poses of a live window.
    rotation = np.empty((*x.shape, 3, 3))
    rotation[..., 0, 0] = 1 - 2 * (y * y + z * z)
    rotation[..., 0, 1] = 2 * (x * y - w * z)
    rotation[..., 0, 2] = 2 * (x * z + w * y)
    rotation[..., 1, 0] = 2 * (x * y + w * z)
    rotation[..., 1, 1] = 1 - 2 * (x * x + z * z)
    rotation[..., 1, 2] = 2 * (y * z - w * x)
    rotation[..., 2, 0] = 2 * (x * z - w * y)
    rotation[..., 2, 1] = 2 * (y * z + w * x)
    rotation[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return rotation


def xyzw_from_matrix(rotation: _FloatArray) -> _FloatArray:
    """(..., 4) unit quaternions of (..., 3, 3) rotations, w >= 0 (Shepperd 1978).

    Each is taken from the column of 4 q q^T with the largest diagonal. No solver is asked: the last
    bits of LAPACK depend on its threads, and these numbers are written into recordings.
    """
    r = np.asarray(rotation, dtype=np.float64)
    (a, b, c), (d, e, f), (g, h, i) = (np.moveaxis(r, (-2, -1), (0, 1))[row] for row in range(3))
    columns = np.stack(
        [
            np.stack([1.0 + a - e - i, b + d, c + g, h - f], axis=-1),
            np.stack([b + d, 1.0 - a + e - i, f + h, c - g], axis=-1),
            np.stack([c + g, f + h, 1.0 - a - e + i, d - b], axis=-1),
            np.stack([h - f, c - g, d - b, 1.0 + a + e + i], axis=-1),
        ],
        axis=-2,
    )
    largest = np.argmax(np.diagonal(columns, axis1=-2, axis2=-1), axis=-1)[..., None, None]
    quat = np.take_along_axis(columns, largest, axis=-2)[..., 0, :]
    quat = quat / np.sqrt((quat * quat).sum(axis=-1, keepdims=True))
    return np.asarray(np.where(quat[..., 3:] < 0.0, -quat, quat), dtype=np.float64)


def matrix_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> _FloatArray:
    """3 x 3 rotation about fixed x, then y, then z (URDF and ROS convention)."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def se3_from_parts(rotation: _FloatArray, translation_m: _FloatArray) -> _FloatArray:
    """4 x 4 transform from a 3 x 3 rotation and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


def se2_from_se3(T_a_b: _FloatArray) -> _FloatArray:
    """(x, y, yaw) of a 4 x 4 transform projected onto the plane."""
    return np.array([T_a_b[0, 3], T_a_b[1, 3], np.arctan2(T_a_b[1, 0], T_a_b[0, 0])])


def se3_from_se2(T_a_b: _FloatArray) -> _FloatArray:
    """(..., 4, 4) of planar transforms (..., 3) x, y, yaw."""
    T = np.zeros((*T_a_b.shape[:-1], 4, 4))
    T[..., :3, :3] = rotation(T_a_b[..., 2])
    T[..., :2, 3] = T_a_b[..., :2]
    T[..., 3, 3] = 1.0
    return T


class MountParameters(Protocol):
    """Six degrees of freedom: metres, and degrees about fixed x, then y, then z."""

    @property
    def x_m(self) -> float: ...

    @property
    def y_m(self) -> float: ...

    @property
    def z_m(self) -> float: ...

    @property
    def roll_deg(self) -> float: ...

    @property
    def pitch_deg(self) -> float: ...

    @property
    def yaw_deg(self) -> float: ...


def mount_transform(mount: MountParameters) -> _FloatArray:
    """``T_base_sensor`` (4 x 4)."""
    roll, pitch, yaw = np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg])
    return se3_from_parts(
        matrix_from_rpy(roll, pitch, yaw), np.array([mount.x_m, mount.y_m, mount.z_m])
    )


@dataclass(frozen=True, slots=True, eq=False)
class StaticTransform:
    """An edge of the transform tree that never moves: ``T_parent_child`` is 4 x 4."""

    parent: str
    child: str
    T_parent_child: _FloatArray
