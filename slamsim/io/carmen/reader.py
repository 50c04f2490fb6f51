"""Reads a CARMEN log as written: lines in file order, with the logger's times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.geometry import (
    between,
    matrix_from_rpy,
    se3_from_parts,
    xyzw_from_matrix,
    xyzw_from_yaw,
)
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.io.carmen.lines import CarmenContent, Fan, LaserLine, OdomLine, collect
from slamsim.recording import (
    RawOdometry,
    RawScans,
    Recording,
    ScanLayout,
    TransformEdge,
    UnreadTopic,
)
from slamsim.recording.cleaning.no_return import RangeLimit, RangeSample
from slamsim.recording.cleaning.rising_stamps import epoch_of

_ODOM_FRAME, _BASE_FRAME = "odom", "base_link"
_ODOM = "ODOM"
_SAME_CLOCK_NS = 1_000_000_000
_MAXIMUM_PARAMETERS = ("robot_front_laser_max", "robot_laser_max", "laser_front_laser_max")
_OFFSET_PARAMETER = "robot_frontlaser_offset"
_LMS_CODES_FROM_M = 81.83
"""Readings of a SICK LMS have 13 bits, of which 8183 to 8191 are codes of errors; in units of 1 cm
these begin here."""
_RIGID_TOLERANCE = 2e-3
"""In metres and radians: poses of robot and laser have six decimals, but some writers round to
three."""


def read_carmen(path: Path) -> Recording:
    """What a CARMEN file says. Topics are the names of the messages, such as ``FLASER``.

    The odometry is that of the laser lines, under their topic; ``ODOM`` lines, which another
    process stamps, are read only where the laser lines carry none. Raises InputRefused for
    a file of another kind.
    """
    content = collect(path)
    anomalies = _anomalies(content)
    origin_ns = _logger_start_ns(content)
    lasers = content.lasers
    odometries = [
        _odometry(name, lines, origin_ns)
        for name, lines in lasers.items()
        if all(line.T_odom_base is not None for line in lines)
    ]
    unread = _unread(content, origin_ns) if odometries else ()
    if content.odometry and not odometries:
        odometries.append(_odometry(_ODOM, content.odometry, origin_ns))
    scans = [_scans(name, lines, content, origin_ns, anomalies) for name, lines in lasers.items()]
    return Recording(
        name=path.name.split(".")[0],
        format="carmen",
        streams=(*scans, *odometries),
        transforms=tuple(_edge(name, lines, content, anomalies) for name, lines in lasers.items()),
        epoch=epoch_of(int(np.median((*scans, *odometries)[0].stamps_ns))),
        unread=unread,
        anomalies=tuple(anomalies),
    )


def _unread(content: CarmenContent, origin_ns: int | None) -> tuple[UnreadTopic, ...]:
    if not content.odometry:
        return ()
    reason = "the laser lines carry the odometry"
    stream = _odometry(_ODOM, content.odometry, origin_ns)
    return (UnreadTopic(_ODOM, _ODOM, len(content.odometry), reason, stream),)


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
    anomalies: list[str],
) -> RawScans:
    limit = _range_limit_of(lines, content)
    anomalies.append(f"{name}: {limit.words}")
    fans = {fan: i for i, fan in enumerate(dict.fromkeys(line.fan for line in lines))}
    rows = [_to_single(line.readings_m) for line in lines]
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
        range_is_estimated=True,
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
        positions_m=np.column_stack([poses[:, :2], np.zeros(len(poses))]),
        quats_xyzw=xyzw_from_yaw(poses[:, 2]),
        linear_m_s=linear,
        angular_rad_s=angular,
        yaws_rad=poses[:, 2],
    )


def _edge(
    name: str, lines: list[LaserLine], content: CarmenContent, anomalies: list[str]
) -> TransformEdge:
    T_base_laser = _mounting_of(lines, content, anomalies)
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


def _anomalies(content: CarmenContent) -> list[str]:
    """What stands in the file besides laser and odometry lines, in words."""
    warnings = []
    if content.malformed:
        warnings.append(
            f"{content.malformed} malformed lines left out, the first at {content.first_malformed}"
        )
    if content.ignored:
        ignored = ", ".join(f"{name} ({n})" for name, n in sorted(content.ignored.items()))
        warnings.append(f"messages without a use here: {ignored}")
    return warnings


@dataclass(frozen=True, slots=True)
class _Limit:
    """From where on readings are no return. declared_m: by a PARAM line, or the codes of a SICK
    LMS, for lines that declare nothing themselves."""

    declared_m: float
    found: RangeLimit
    words: str

    def maximum_m(self, fan: Fan) -> float:
        """For the readings of a fan."""
        declared_m = self.declared_m if fan.range_max_m is None else fan.range_max_m
        return self.found.maximum_m(declared_m)


def _range_limit_of(lines: Sequence[LaserLine], content: CarmenContent) -> _Limit:
    """What the lines declare, as far as their readings bear it out."""
    declared_m, known_from = _declared_max(lines[0], content)
    sample = RangeSample()
    for line in lines:
        sample.add(_to_single(line.readings_m), line.fan.angle_step_rad)
    poses = [lines[number].T_odom_base for number in sample.numbers]
    known = [pose[:2] for pose in poses if pose is not None]
    found = sample.limit(declared_m, np.array(known) if len(known) == len(poses) else None)
    told = found.warnings(declared_m)
    words = "; ".join(told) or f"readings from {declared_m:g} m on are no return ({known_from})"
    return _Limit(declared_m, found, words)


def _declared_max(line: LaserLine, content: CarmenContent) -> tuple[float, str]:
    if line.fan.range_max_m is not None:
        return line.fan.range_max_m, "declared by the laser lines"
    declared = _parameter(content, *_MAXIMUM_PARAMETERS)
    if declared is not None and declared > 0.0:
        return declared, "declared by a PARAM line"
    return _LMS_CODES_FROM_M, "where the codes of a SICK LMS begin"


def _mounting_of(lines: list[LaserLine], content: CarmenContent, warnings: list[str]) -> FloatArray:
    """4 x 4 T_base_laser: laser pose against odometry pose, if the same in all lines."""
    offset_x_m = _parameter(content, _OFFSET_PARAMETER) or 0.0
    mounting = np.array([offset_x_m, 0.0, 0.0])
    pairs = [(a.T_odom_base, a.T_odom_laser) for a in lines if a.T_odom_laser is not None]
    if pairs:
        T_base_laser = between(np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]))
        T_base_laser[:, 2] = np.unwrap(T_base_laser[:, 2])  # one that looks back may be at +-pi
        middle = np.median(T_base_laser, axis=0)
        if np.abs(T_base_laser - middle).max() <= _RIGID_TOLERANCE:
            mounting = np.round(middle, 6)  # the log has six decimals
        else:
            warnings.append(
                "the laser pose moves against the odometry pose (a corrected log): "
                f"the laser is taken to sit at x = {offset_x_m} m ({_OFFSET_PARAMETER})"
            )
    return se3_from_parts(
        matrix_from_rpy(0.0, 0.0, float(mounting[2])), np.array([mounting[0], mounting[1], 0.0])
    )


def _parameter(content: CarmenContent, *names: str) -> float | None:
    for name in names:
        try:
            value = float(content.parameters[name])
        except (KeyError, ValueError):
            continue
        if np.isfinite(value):
            return value
    return None


def _to_single(readings_m: FloatArray) -> Float32Array:
    """As ranges are kept; ``inf`` where a reading is too large for that."""
    with np.errstate(over="ignore"):
        return readings_m.astype(np.float32)
