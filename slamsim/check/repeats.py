"""Scans that repeat the one before while the robot moves: a driver that is stuck."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.scan_sample import ScanSample
from slamsim.recording import RawScans, Recording
from slamsim.types import BoolArray, FloatArray, IntArray

MAX_REPEATED_SHARE = 2e-3
MIN_REPEATED = 3
MOVING_RAD_S, MOVING_M_S = 0.05, 0.02
_PERFECT_SHARE = 0.5
"""More repeats than this are a simulation without noise, not a driver that is stuck."""


def check_repeats(recording: Recording, scans: RawScans, sample: ScanSample) -> Finding:
    """Noise alone makes any two scans of a real lidar differ."""
    moving = _moving_at(recording, scans.stamps_ns)
    if moving is None:
        share = float(sample.repeats.mean())
        told, count = sample.repeats, int(sample.repeats.sum())
        if share > _PERFECT_SHARE:
            words = "most scans repeat the one before, and nothing says whether the robot moved"
            return Finding("ranges.stuck", scans.topic, "cannot tell", words)
    else:
        told = sample.repeats & moving
        count = int(told.sum())
        share = count / max(int(moving.sum()), 1)
    estimate = Estimate(100.0 * share, 0.0, "%")
    if count >= MIN_REPEATED and share > MAX_REPEATED_SHARE:
        first_s = (int(scans.stamps_ns[np.argmax(told)]) - int(scans.stamps_ns[0])) * 1e-9
        return Finding(
            "ranges.stuck",
            scans.topic,
            "bad",
            f"{count} scans repeat the ranges of the one before bit for bit while the robot "
            f"moves, first after {first_s:.1f} s",
            "scan_stuck",
            "Look for a driver that publishes its last buffer again, or a republisher.",
            estimate,
            100.0 * MAX_REPEATED_SHARE,
            (Mend("drop_repeated_scans", scans.topic),),
        )
    words = "no scan repeats the one before while the robot moves"
    return Finding("ranges.stuck", scans.topic, "ok", words, estimate=estimate)


def _moving_at(recording: Recording, query_ns: IntArray) -> BoolArray | None:
    """(n,) whether any other stream says that the robot moves then, None if there is none."""
    speeds = [
        *((s.stamps_ns, np.abs(s.angular_velocity_rad_s).max(axis=1) > MOVING_RAD_S)
          for s in recording.imus),
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
