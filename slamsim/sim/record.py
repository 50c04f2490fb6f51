"""What was measured at each physics step, collected cheaply and handed on in windows."""

from __future__ import annotations

import numpy as np

from slamsim.geometry import matrix_from_xyzw, xyzw_from_matrix
from slamsim.types import Drive, FloatArray, IntArray

Vector = tuple[float, ...]


def stamps_ns(first_step: int, count: int, rate_hz: int) -> IntArray:
    """(count,) true time of steps: round(k * 1e9 / rate), exact for any length of drive."""
    steps = np.arange(first_step, first_step + count, dtype=np.int64)
    return (2 * steps * 1_000_000_000 + rate_hz) // (2 * rate_hz)


class Recorder:
    """Lists of what PyBullet returns; turned into arrays once per window.

    Appending a tuple costs a tenth of writing its numbers into an array.
    """

    def __init__(self, T_base_com: FloatArray, rate_hz: int, steps_per_tick: int) -> None:
        self._T_com_base: FloatArray = np.linalg.inv(T_base_com).astype(np.float64)
        self._quat_com_base = xyzw_from_matrix(self._T_com_base[:3, :3])
        self._rate_hz, self._steps_per_tick = rate_hz, steps_per_tick
        self._first_step = 0
        self.poses: list[tuple[Vector, Vector]] = []
        """(position, quaternion) of the base link's centre of mass, each step."""
        self.velocities: list[tuple[Vector, Vector]] = []
        """(linear, angular) of the same point, each step."""
        self.wheels: list[tuple[tuple[float, float], tuple[float, float]]] = []
        """PyBullet's states of (left, right) wheel, beginning with angle and speed, each step."""
        self.commands: list[tuple[float, float]] = []
        """(forward, yaw rate), each control tick."""
        self.contacts: list[bool] = []
        """Whether a wall was touched, each control tick."""

    def __len__(self) -> int:
        return len(self.poses)

    def take_window(self) -> Drive:
        """Everything since the last window, as one; raises ValueError if there is nothing."""
        count = len(self.poses)
        wheels = np.array([(left[0], right[0], left[1], right[1]) for left, right in self.wheels])
        positions_m, quats_xyzw = self._base_poses()
        arm_m = positions_m - np.array([pose[0] for pose in self.poses])
        spin = np.array([velocity[1] for velocity in self.velocities])
        window = Drive(
            stamps_ns=stamps_ns(self._first_step, count, self._rate_hz),
            positions_m=positions_m,
            quats_xyzw=quats_xyzw,
            linear_velocity_m_s=np.array([velocity[0] for velocity in self.velocities])
            + np.cross(spin, arm_m),
            angular_velocity_rad_s=spin,
            wheel_angles_rad=wheels[:, :2].copy(),
            wheel_speeds_rad_s=wheels[:, 2:].copy(),
            commands=np.repeat(np.array(self.commands), self._steps_per_tick, axis=0)[:count],
            wall_contact=np.repeat(np.array(self.contacts), self._steps_per_tick)[:count],
        )
        self._first_step += count
        for column in (self.poses, self.velocities, self.wheels, self.commands, self.contacts):
            column.clear()
        return window

    def _base_poses(self) -> tuple[FloatArray, FloatArray]:
        """Of base_footprint, from those of the centre of mass that PyBullet reports."""
        centres_m = np.array([pose[0] for pose in self.poses])
        quats = np.array([pose[1] for pose in self.poses])
        offset_m = matrix_from_xyzw(quats) @ self._T_com_base[:3, 3]
        return centres_m + offset_m, _hamilton(quats, self._quat_com_base)


def _hamilton(left_xyzw: FloatArray, right_xyzw: FloatArray) -> FloatArray:
    """(n, 4) products of quaternions (n, 4) with one (4,), of unit length."""
    x, y, z, w = left_xyzw.T
    a, b, c, d = right_xyzw
    product = np.column_stack(
        [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ]
    )
    return np.asarray(product / np.linalg.norm(product, axis=1, keepdims=True))
