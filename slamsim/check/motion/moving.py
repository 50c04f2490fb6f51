"""Intervals of motion, estimated from inertial units and odometry."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import Recording
from slamsim.recording.cleaning.scans import MOVING_M_S, MOVING_RAD_S


def moving_at(recording: Recording, query_ns: IntArray, ask_imus: bool = True) -> BoolArray | None:
    """(n,) whether any inertial unit or odometry says that the robot moves, None without any."""
    speeds = [
        *((s.stamps_ns, np.abs(s.angular_velocity_rad_s).max(axis=1) > MOVING_RAD_S)
          for s in recording.imus if ask_imus),
        *((s.stamps_ns, (np.abs(s.angular_rad_s[:, 2]) > MOVING_RAD_S)
           | (np.hypot(s.linear_m_s[:, 0], s.linear_m_s[:, 1]) > MOVING_M_S)
           | _displaced(s.stamps_ns, s.positions_m)) for s in recording.odometries),
    ]  # fmt: skip
    found = [_nearest(stamps, flags, query_ns) for stamps, flags in speeds if stamps.size]
    return np.logical_or.reduce(found) if found else None


def _displaced(stamps_ns: IntArray, positions_m: FloatArray) -> BoolArray:
    """Whether the position changes at that speed, for odometry that leaves its twist empty."""
    if stamps_ns.size < 2:
        return np.zeros(stamps_ns.size, dtype=np.bool_)
    elapsed_s = np.maximum(np.diff(stamps_ns) * 1e-9, 1e-6)
    speed = np.linalg.norm(np.diff(positions_m[:, :2], axis=0), axis=1) / elapsed_s
    return np.asarray(np.append(speed, speed[-1]) > MOVING_M_S)


def _nearest(stamps_ns: IntArray, flags: BoolArray, query_ns: IntArray) -> BoolArray:
    order = np.argsort(stamps_ns, kind="stable")
    place = np.clip(np.searchsorted(stamps_ns[order], query_ns), 0, stamps_ns.size - 1)
    return np.asarray(flags[order][place])
