"""Records the state at each physics step and returns it in windows."""

from __future__ import annotations

from array import array

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, xyzw_from_matrix
from slamsim.core.types import Drive, FloatArray, IntArray
from slamsim.guard.numbers import is_sound

STATE_COLUMNS, TICK_COLUMNS = 17, 3


START_NS = 1_000_000_000_000
"""True time at which every drive begins: 1000 s.

ROS 1 takes the time 0 for none and has no earlier one, so a recording that began there would lose
its latched messages in a conversion. The thousand seconds leave room for clocks that are behind,
are whole periods of every stream, and are few enough that seconds in double precision still tell
nanoseconds apart.
"""


def stamps_ns(first_step: int, count: int, rate_hz: int) -> IntArray:
    """(count,) true time of steps: START_NS + round(k * 1e9 / rate), exact for any length."""
    steps = np.arange(first_step, first_step + count, dtype=np.int64)
    return START_NS + (2 * steps * 1_000_000_000 + rate_hz) // (2 * rate_hz)


class Recorder:
    """Flat rows of what PyBullet returns; made into arrays once per window.

    Extending a flat buffer takes a fraction of the time of writing into an array, and keeps no
    small objects alive that would push the physics out of the processor's cache.
    """

    def __init__(self, T_base_com: FloatArray, rate_hz: int, steps_per_tick: int) -> None:
        self._T_com_base: FloatArray = np.linalg.inv(T_base_com).astype(np.float64)
        self._quat_com_base = xyzw_from_matrix(self._T_com_base[:3, :3])
        self._rate_hz, self._steps_per_tick = rate_hz, steps_per_tick
        self._first_step = 0
        self.states = array("d")
        """Each step: position (3) and quaternion (4) of the base link's centre of mass, its
        linear (3) and angular (3) velocity, angle and speed of the left, then the right wheel."""
        self.ticks = array("d")
        """Each control tick: commanded speed and yaw rate, and 1 if a wall was touched."""

    def take_window(self) -> Drive:
        """Everything since the last window, up to the first step that is not a number: physics
        that fails stays failed."""
        states = _sound_part(np.array(self.states).reshape(-1, STATE_COLUMNS))
        ticks = np.array(self.ticks).reshape(-1, TICK_COLUMNS)
        ticks = np.repeat(ticks, self._steps_per_tick, axis=0)[: len(states)]
        positions_m, quats_xyzw = self._base_poses(states)
        spin = states[:, 10:13].copy()
        window = Drive(
            stamps_ns=stamps_ns(self._first_step, len(states), self._rate_hz),
            positions_m=positions_m,
            quats_xyzw=quats_xyzw,
            linear_velocity_m_s=states[:, 7:10] + np.cross(spin, positions_m - states[:, :3]),
            angular_velocity_rad_s=spin,
            wheel_angles_rad=states[:, 13:17:2].copy(),
            wheel_speeds_rad_s=states[:, 14:17:2].copy(),
            commands=ticks[:, :2].copy(),
            wall_contact=ticks[:, 2] > 0.0,
        )
        self._first_step += len(states)
        self.states, self.ticks = array("d"), array("d")
        return window

    def _base_poses(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of base_footprint, from those of the centre of mass that PyBullet reports."""
        quats = states[:, 3:7]
        offset_m = matrix_from_xyzw(quats) @ self._T_com_base[:3, 3]
        return states[:, :3] + offset_m, _hamilton(quats, self._quat_com_base)


def _sound_part(states: FloatArray) -> FloatArray:
    """The rows before the first that holds what is no number, or one that no robot reaches."""
    bad = np.flatnonzero(~is_sound(states))
    return states[: bad[0]] if bad.size else states


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
