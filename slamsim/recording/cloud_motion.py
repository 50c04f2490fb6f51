"""Points of clouds as a sensor that neither moves nor leans would have seen them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_se2
from slamsim.core.types import FloatArray, Trajectory
from slamsim.recording.sweeps import Points, Sweep

LEVEL = math.cos(math.radians(0.1))
"""Leaning less, a return 10 m away is 17 mm higher or lower than it seems."""
_LEANING = math.cos(math.radians(45.0))
"""A base that leans more most of the time has other axes than a robot's."""
_STEP_S, _MOST_STEPS = 5e-3, 200
"""Between instants of a cloud at which odometry is asked; the chord in between is 0.03 mm off for
what is 1 m away and turns at 3 rad/s."""


class CloudMotion:
    """How a sensor moved while it measured clouds, by odometry.

    path: T_odom_base, not empty. T_base_sensor: 4 x 4 of the frame that points are given in.
    """

    def __init__(self, path: Trajectory, T_base_sensor: FloatArray) -> None:
        self._path, self._T_base_sensor = path, T_base_sensor
        up = matrix_from_xyzw(path.quats_xyzw)[:, 2, 2]
        self._leans = bool(up.min() < LEVEL and np.median(up) > _LEANING)

    def note(self, sweep: Sweep | None) -> str:
        """What is done to clouds, in words."""
        done = ["moved there"] * _is_unordered(sweep) + ["levelled"] * self._leans
        return f"; {' and '.join(done)} by odometry" if done else ""

    def undone(self, cloud: Points, sweep: Sweep | None) -> Points:
        """Points with times that make no turn are put where the middle of the cloud would have seen
        them, which a scan can say of all its beams; others keep their instants. All are seen from a
        base that stands upright. Before odometry begins and after its end the robot stands."""
        timed = sweep is not None and cloud.time is not None
        to_middle = timed and _is_unordered(sweep)
        if not len(cloud.xyz_m) or not (to_middle or self._leans):
            return cloud
        after_s = np.zeros(len(cloud.xyz_m))
        if sweep is not None and cloud.time is not None:
            after_s = sweep.after_stamp_s(cloud.time, cloud.stamp_ns)
        middle_s = float(np.median(after_s))
        first_s, last_s = float(after_s.min()), float(after_s.max())
        steps = int(np.clip(math.ceil((last_s - first_s) / _STEP_S), 1, _MOST_STEPS))
        T_odom_base = self._poses(
            cloud.stamp_ns, np.append(np.linspace(first_s, last_s, steps + 1), middle_s)
        )
        seen_from = T_odom_base[-1:] if to_middle else T_odom_base[:-1]
        seen_from = _upright(seen_from) if self._leans else seen_from
        T_each = np.linalg.inv(seen_from @ self._T_base_sensor)
        T_each = T_each @ T_odom_base[:-1] @ self._T_base_sensor
        step = (after_s - first_s) * (steps / max(last_s - first_s, 1e-9))
        before = np.minimum(step.astype(np.int64), steps - 1)
        share = (step - before)[:, None, None]
        T = (1.0 - share) * T_each[before, :3] + share * T_each[before + 1, :3]
        seen = replace(cloud, xyz_m=np.einsum("nij,nj->ni", T[:, :, :3], cloud.xyz_m) + T[:, :, 3])
        if not to_middle:
            return seen
        return replace(seen, stamp_ns=cloud.stamp_ns + round(1e9 * middle_s), time=None)

    def _poses(self, stamp_ns: int, after_s: FloatArray) -> FloatArray:
        """(k, 4, 4) T_odom_base so long after (k,) a stamp."""
        stamps_ns = self._path.stamps_ns
        first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
        since_s = np.clip(after_s + 1e-9 * (stamp_ns - first_ns), 0.0, 1e-9 * (last_ns - first_ns))
        at_ns = np.minimum(first_ns + np.rint(1e9 * since_s).astype(np.int64), last_ns)
        found = self._path.at(at_ns)
        T = np.tile(np.eye(4), (len(found), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = matrix_from_xyzw(found.quats_xyzw), found.positions_m
        return T


def _is_unordered(sweep: Sweep | None) -> bool:
    return sweep is not None and sweep.s_per_rad == 0.0


def _upright(T_odom_base: FloatArray) -> FloatArray:
    """(k, 4, 4) at the same places, with the same headings."""
    yaw_rad = np.arctan2(T_odom_base[:, 1, 0], T_odom_base[:, 0, 0])
    upright = se3_from_se2(np.column_stack([T_odom_base[:, :2, 3], yaw_rad]))
    upright[:, 2, 3] = T_odom_base[:, 2, 3]
    return upright
