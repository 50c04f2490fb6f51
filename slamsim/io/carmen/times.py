"""When the scans of a CARMEN log were taken: stamps, the logger's times, the order of lines."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from slamsim.core.geometry import wrap_angle
from slamsim.io.carmen.lines import LaserLine
from slamsim.recording.cleaning.rising_stamps import is_late, rising_times

_USUAL_SPEED_M_S, _USUAL_TURN_RAD_S = 0.5, 0.5
_LEAST_PERIOD_NS, _LONGEST_PERIOD_NS = 100_000_000, 10_000_000_000
_MOST_GROWTH = 1.05
"""Of the odometry path by sorting: by a few lines in the wrong place it grows no more."""


def timed(
    lines: list[LaserLine], channel: str, warnings: list[str]
) -> tuple[list[LaserLine], bool]:
    """(the lines in the order of rising stamps, whether these are other than written)."""
    stamps_ns = np.array([line.stamp_ns for line in lines], dtype=np.int64)
    logged = [line.logged_ns for line in lines if line.logged_ns is not None]
    times = rising_times(
        stamps_ns,
        np.array(logged, dtype=np.int64) if len(logged) == len(lines) else None,
        is_repeat=np.array([False, *(_is_repeat(a, b) for a, b in pairwise(lines))]),
        sorting=_is_sorting_right(lines),
        period_ns=_likely_period_ns(lines),
        what=f"{channel} scans",
    )
    warnings += times.told
    ordered = [lines[i] for i in times.order.tolist()]
    if times.made_anew:
        stamped = zip(ordered, times.stamps_ns.tolist(), strict=True)
        ordered = [replace(line, stamp_ns=stamp_ns) for line, stamp_ns in stamped]
    return ordered, times.made_anew


def _is_repeat(before: LaserLine, line: LaserLine) -> bool:
    """Whether a line says the same as the one above."""
    return before.fan == line.fan and _content(before) == _content(line)


def _content(line: LaserLine) -> list[bytes]:
    parts = (line.readings_m, line.T_odom_base, line.T_odom_laser)
    return [b"" if part is None else part.tobytes() for part in parts]


def _is_sorting_right(lines: list[LaserLine]) -> bool | None:
    """Whether stamps that fall back are right and the order of the lines is not.

    If so the odometry path does not grow by sorting. None where the lines carry no odometry, do
    not move, or are late by no more than transport explains.
    """
    as_written_m = _path_length_m(lines)
    if as_written_m == 0.0 or not is_late(np.array([line.stamp_ns for line in lines])):
        return None
    as_stamped_m = _path_length_m(sorted(lines, key=lambda line: line.stamp_ns))
    return as_stamped_m <= _MOST_GROWTH * as_written_m


def _likely_period_ns(lines: list[LaserLine]) -> int:
    """Between lines without any time: that of a robot at its usual speed."""
    poses = np.array([line.T_odom_base for line in lines if line.T_odom_base is not None])
    if len(poses) < 2:
        return _LEAST_PERIOD_NS
    turned_rad = float(np.abs(wrap_angle(np.diff(poses[:, 2]))).sum())
    moved_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    busy_s = max(moved_m / _USUAL_SPEED_M_S, turned_rad / _USUAL_TURN_RAD_S)
    return max(_LEAST_PERIOD_NS, min(round(1e9 * busy_s / (len(poses) - 1)), _LONGEST_PERIOD_NS))


def _path_length_m(lines: list[LaserLine]) -> float:
    positions = [line.T_odom_base[:2] for line in lines if line.T_odom_base is not None]
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(positions))
