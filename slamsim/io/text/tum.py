"""Trajectories in the format of the TUM RGB-D benchmark, ``time x y z qx qy qz qw`` per line;
stamps as exact integers, parsed from any notation."""

from __future__ import annotations

import math
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.types import PlanarTrajectory, Trajectory
from slamsim.guard.errors import InputRefused, shown
from slamsim.guard.numbers import MOST_NS, is_sound
from slamsim.guard.output import write_atomic
from slamsim.guard.unpacking import open_lines

_ROWS_TOGETHER = 10_000
"""All 888,000 poses of two hours at once, as Python numbers, took 0.45 GB more."""


def write_tum(path: Path, trajectory: Trajectory | PlanarTrajectory) -> None:
    """Seconds with nine decimals (nothing of a stamp is lost), metres and quaternions likewise."""
    spatial = _spatial(trajectory) if isinstance(trajectory, PlanarTrajectory) else trajectory
    parts = [b"# time_s x_m y_m z_m qx qy qz qw\n"]
    for begin in range(0, len(spatial), _ROWS_TOGETHER):
        parts.append(_lines(spatial, slice(begin, begin + _ROWS_TOGETHER)))
    write_atomic(path, b"".join(parts))


def _lines(spatial: Trajectory, rows: slice) -> bytes:
    poses = np.column_stack([spatial.positions_m[rows], spatial.quats_xyzw[rows]]).tolist()
    return "".join(
        f"{decimal_from_stamp_ns(stamp_ns)} {' '.join(f'{value:.9f}' for value in pose)}\n"
        for stamp_ns, pose in zip(spatial.stamps_ns[rows].tolist(), poses, strict=True)
    ).encode()


def _spatial(trajectory: PlanarTrajectory) -> Trajectory:
    flat = np.column_stack([trajectory.poses[:, :2], np.zeros(len(trajectory))])
    return Trajectory(trajectory.stamps_ns, flat, xyzw_from_yaw(trajectory.poses[:, 2]))


def read_tum(path: Path) -> Trajectory:
    """Raises InputRefused, naming the line, for anything but poses in increasing time."""
    stamps_ns: list[int] = []
    rows: list[list[float]] = []
    for number, line in open_lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamps_ns.append(stamp_ns_from_decimal(words[0]))
            rows.append(_pose(words[1:]))
            if len(stamps_ns) > 1 and stamps_ns[-1] <= stamps_ns[-2]:
                raise ValueError(f"{words[0]} s is not after the line before")
        except ValueError as error:
            reason = f"a pose is 'time x y z qx qy qz qw', times increase ({error})"
            raise InputRefused(path, reason, f"line {number}") from None
    if not rows:
        raise InputRefused(path, "there is no pose in it")
    poses = np.array(rows)
    quats = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps_ns, dtype=np.int64), poses[:, :3], quats)


def _pose(words: list[str]) -> list[float]:
    values = [float(word) for word in words]
    if len(values) != 7:
        raise ValueError(f"{len(values) + 1} numbers")
    norm = math.hypot(*values[3:])
    if not (is_sound(np.array(values)).all() and abs(norm - 1.0) < 1e-2):
        raise ValueError(f"a quaternion of length {norm:.3g}")
    return values


def stamp_ns_from_decimal(seconds: str) -> int:
    """Decimal seconds to nanoseconds without passing through a float; digits beyond are cut.

    Raises ValueError for anything that is not a finite decimal number within ``MOST_NS`` of 0.
    """
    whole, _, fraction = seconds.partition(".")
    if whole.isdecimal() and (fraction.isdecimal() or not fraction) and len(whole) < 10 + 1:
        stamp_ns = int(whole) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    else:
        stamp_ns = _from_decimal(seconds)
    if abs(stamp_ns) > MOST_NS:
        raise ValueError(f"{shown(seconds)} s does not fit into nanoseconds of 64 bits")
    return stamp_ns


def _from_decimal(seconds: str) -> int:
    try:
        value = Decimal(seconds)
        if not value.is_finite() or value.adjusted() > 11:
            raise ValueError(f"{shown(seconds)} is not a stamp in seconds")
        return 0 if value.adjusted() < -9 else int(value.scaleb(9))
    except InvalidOperation:
        raise ValueError(f"{shown(seconds)} is not a stamp in seconds") from None


def decimal_from_stamp_ns(stamp_ns: int) -> str:
    """Seconds with all nine decimals: the inverse of ``stamp_ns_from_decimal``."""
    sign, magnitude = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{magnitude // 1_000_000_000}.{magnitude % 1_000_000_000:09d}"
