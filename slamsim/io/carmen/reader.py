"""A CARMEN log as it was written: its lines in their order, with the logger's times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slamsim.core.geometry import xyzw_from_matrix, xyzw_from_yaw
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.io.carmen.content import CarmenContent, collect
from slamsim.io.carmen.lines import Fan, LaserLine, OdomLine
from slamsim.io.carmen.log import mounting_of, oddities, range_limit_of, to_single
from slamsim.io.text.stamps import epoch_of
from slamsim.recording import (
    RawOdometry,
    RawScans,
    Recording,
    ScanLayout,
    TransformEdge,
    UnreadTopic,
)

_ODOM_FRAME, _BASE_FRAME = "odom", "base_link"
_ODOM = "ODOM"
_SAME_CLOCK_NS = 1_000_000_000


def read_carmen_recording(path: Path, scan_topic: str | None = None) -> Recording:
    """What a CARMEN file says. Topics are the names of the messages, such as ``FLASER``.

    The odometry is that of the laser lines, under their topic; ``ODOM`` lines, which another
    process stamps, are read only where the laser lines carry none. Raises InputRefused for
    a file of another kind.
    """
    content = collect(path)
    if scan_topic is not None and scan_topic not in content.lasers:
        there = ", ".join(content.lasers) or "none"
        raise InputRefused(path, f"no laser message {scan_topic!r}; there is {there}")
    odd = oddities(content)
    origin_ns = _logger_start_ns(content)
    lasers = {n: lines for n, lines in content.lasers.items() if scan_topic in (None, n)}
    odometries = [
        _odometry(name, lines, origin_ns) for name, lines in lasers.items() if _has_poses(lines)
    ]
    unread = _unread(content) if odometries else ()
    if content.odometry and not odometries:
        odometries.append(_odometry(_ODOM, content.odometry, origin_ns))
    scans = [_scans(name, lines, content, origin_ns, odd) for name, lines in lasers.items()]
    return Recording(
        name=path.name.split(".")[0],
        format="carmen",
        streams=(*scans, *odometries),
        transforms=tuple(_edge(name, lines, content, odd) for name, lines in lasers.items()),
        epoch=epoch_of(int(np.median((*scans, *odometries)[0].stamps_ns))),
        unread=unread,
        odd=tuple(odd),
    )


def _unread(content: CarmenContent) -> tuple[UnreadTopic, ...]:
    if not content.odometry:
        return ()
    reason = "the laser lines carry the odometry"
    return (UnreadTopic(_ODOM, _ODOM, len(content.odometry), reason),)


def _has_poses(lines: Sequence[LaserLine]) -> bool:
    return all(line.T_odom_base is not None for line in lines)


def _logger_start_ns(content: CarmenContent) -> int | None:
    """When the logger was started, which the format does not say, None without its times.

    It is put as early as leaves no line logged before its stamp; lines that are a second and
    more away from the rest do not count.
    """
    lines = [line for laser in content.lasers.values() for line in laser] + content.odometry
    ahead = [line.stamp_ns - line.logged_ns for line in lines if line.logged_ns is not None]
    if len(ahead) < len(lines):
        return None
    offsets = np.array(ahead, dtype=np.int64)
    middle_ns = np.sort(offsets)[(offsets.size - 1) // 2]  # one of them, unlike the median
    near = np.abs(offsets - middle_ns) < _SAME_CLOCK_NS
    return int(offsets[near].max())


def _received_ns(
    lines: Sequence[LaserLine] | Sequence[OdomLine], origin_ns: int | None
) -> IntArray | None:
    logged = [line.logged_ns for line in lines if line.logged_ns is not None]
    return None if origin_ns is None else np.array(logged, dtype=np.int64) + origin_ns


def _stamps_ns(lines: Sequence[LaserLine] | Sequence[OdomLine]) -> IntArray:
    return np.array([line.stamp_ns for line in lines], dtype=np.int64)


def _scans(
    name: str,
    lines: Sequence[LaserLine],
    content: CarmenContent,
    origin_ns: int | None,
    odd: list[str],
) -> RawScans:
    limit = range_limit_of(lines, content)
    odd.append(f"{name}: {limit.words}")
    fans = {fan: i for i, fan in enumerate(dict.fromkeys(line.fan for line in lines))}
    rows = [to_single(line.readings_m) for line in lines]
    bright = [line.intensities for line in lines if line.intensities is not None]
    same = len({row.size for row in rows}) == 1
    return RawScans(
        topic=name,
        frame_ids=(name.lower(),),
        stamps_ns=_stamps_ns(lines),
        received_ns=_received_ns(lines, origin_ns),
        layouts=tuple(_layout(fan, limit.maximum_m(fan)) for fan in fans),
        layout_of=np.array([fans[line.fan] for line in lines], dtype=np.int32),
        ranges_m=np.stack(rows) if same else rows,
        intensities=None if len(bright) < len(lines) else np.stack(bright) if same else bright,
    )


def _layout(fan: Fan, range_max_m: float) -> ScanLayout:
    return ScanLayout(
        angle_min_rad=fan.angle_min_rad,
        angle_max_rad=fan.angle_min_rad + (fan.beam_count - 1) * fan.angle_step_rad,
        angle_step_rad=fan.angle_step_rad,
        beam_dt_s=0.0,
        scan_time_s=0.0,
        range_min_m=0.0,
        range_max_m=range_max_m,
    )


def _odometry(
    name: str, lines: Sequence[LaserLine] | Sequence[OdomLine], origin_ns: int | None
) -> RawOdometry:
    """Twists are nan where the lines have none."""
    poses = np.array([line.T_odom_base for line in lines])
    linear, angular = np.full((len(lines), 3), np.nan), np.full((len(lines), 3), np.nan)
    for i, line in enumerate(lines):
        if isinstance(line, OdomLine):
            linear[i], angular[i] = (line.twist[0], 0.0, 0.0), (0.0, 0.0, line.twist[1])
    return RawOdometry(
        topic=name,
        frame_ids=(_ODOM_FRAME,),
        stamps_ns=_stamps_ns(lines),
        received_ns=_received_ns(lines, origin_ns),
        child_frame_ids=(_BASE_FRAME,),
        positions_m=_flat(poses),
        quats_xyzw=xyzw_from_yaw(poses[:, 2]),
        linear_m_s=linear,
        angular_rad_s=angular,
    )


def _flat(poses: FloatArray) -> FloatArray:
    return np.column_stack([poses[:, :2], np.zeros(len(poses))])


def _edge(
    name: str, lines: list[LaserLine], content: CarmenContent, odd: list[str]
) -> TransformEdge:
    T_base_laser = mounting_of(lines, content, odd)
    return TransformEdge(
        topic=name,
        parent=_BASE_FRAME,
        child=name.lower(),
        is_static=True,
        stamps_ns=_stamps_ns(lines[:1]),
        received_ns=None,
        positions_m=T_base_laser[None, :3, 3],
        quats_xyzw=xyzw_from_matrix(T_base_laser[:3, :3])[None],
    )
