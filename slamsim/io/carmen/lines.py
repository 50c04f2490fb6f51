"""Parses one line of a CARMEN log into a typed record, or raises ValueError; collects the lines of
a log.

Formats as the CARMEN logger writes them (its ``readlog``/``writelog`` modules):
``FLASER n r1..rn laser_x laser_y laser_theta odom_x odom_y odom_theta time host logger_time``,
``ROBOTLASER1 type start fov step max_range accuracy remission_mode n r1..rn m i1..im laser_x
laser_y laser_theta odom_x odom_y odom_theta tv rv forward side turn_axis time host logger_time``,
``RAWLASER1`` as that up to the remissions and then the time,
``ODOM x y theta tv rv accel time host logger_time``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.errors import InputRefused, printable
from slamsim.guard.numbers import is_sound
from slamsim.guard.unpacking import open_lines
from slamsim.io.input_errors import damaged
from slamsim.io.text.tum import stamp_ns_from_decimal

_MOST_BEAMS = 100_000
_SICK_STEPS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}
_SICK_STARTS_DEG = {400: -50.0, 401: -50.0}
"""Fans of the SICK LMS 200 by its number of beams, as CARMEN and its converters take them where a
line tells of none."""


@dataclass(frozen=True, slots=True)
class Fan:
    """Where the beams of a laser look. range_max_m is None where the line does not declare it."""

    angle_min_rad: float
    angle_step_rad: float
    beam_count: int
    range_max_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class LaserLine:
    """readings_m: (n,) as written. T_odom_laser, T_odom_base: planar, None in raw lines.

    logged_ns: the logger's time since its own start, None if it is missing.
    """

    stamp_ns: int
    fan: Fan
    readings_m: FloatArray
    intensities: Float32Array | None
    T_odom_laser: FloatArray | None
    T_odom_base: FloatArray | None
    logged_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class OdomLine:
    """T_odom_base: planar. twist: (2,) forward m/s and yaw rate rad/s. logged_ns as above."""

    stamp_ns: int
    T_odom_base: FloatArray
    twist: FloatArray
    logged_ns: int | None


def sick_fan(beam_count: int) -> Fan:
    """The fan of a line that only tells its number of beams.

    180 or 181 beams are 1 degree apart, 360 or 361 half a degree, both from -90 degrees; 400 or
    401 a quarter from -50: the modes of a SICK LMS, as CARMEN has it. Any other number is spread
    over 180 degrees with a beam at each end.
    """
    step_deg = _SICK_STEPS_DEG.get(beam_count, 180.0 / (beam_count - 1))
    start_deg = _SICK_STARTS_DEG.get(beam_count, -90.0)
    return Fan(math.radians(start_deg), math.radians(step_deg), beam_count, None)


def _finite(words: list[str]) -> FloatArray:
    values = np.array(words, dtype=np.float64)
    if not is_sound(values).all():
        raise ValueError("a number that is not finite, or too large")
    return values


def _take(words: list[str], start: int, count: int) -> list[str]:
    if start + count > len(words):
        raise ValueError(f"{len(words)} words where at least {start + count} belong")
    return words[start : start + count]


def _count(word: str, least: int) -> int:
    count = int(word)
    if not least <= count <= _MOST_BEAMS:
        raise ValueError(f"{count} beams, where {least} to {_MOST_BEAMS} are possible")
    return count


def _logged_ns(words: list[str], stamp_at: int) -> int | None:
    """The last of ``time host logger_time``, of which the first stands at stamp_at."""
    with suppress(IndexError, ValueError):
        return stamp_ns_from_decimal(words[stamp_at + 2])
    return None


def parse_odom(words: list[str]) -> OdomLine:
    """An ODOM line."""
    pose, twist = _finite(_take(words, 1, 3)), np.array(_take(words, 4, 2), dtype=np.float64)
    return OdomLine(stamp_ns_from_decimal(_take(words, 7, 1)[0]), pose, twist, _logged_ns(words, 7))


def parse_flaser(words: list[str]) -> LaserLine:
    """FLASER and RLASER lines. Raises ValueError for a wrong number of words."""
    count = _count(_take(words, 1, 1)[0], least=2)
    readings = np.array(_take(words, 2, count), dtype=np.float64)
    poses = _finite(_take(words, 2 + count, 6))
    stamp_ns = stamp_ns_from_decimal(_take(words, 8 + count, 1)[0])
    if len(words) > 11 + count:
        raise ValueError(f"{len(words)} words where {11 + count} belong")
    fan, logged_ns = sick_fan(count), _logged_ns(words, 8 + count)
    return LaserLine(stamp_ns, fan, readings, None, poses[:3], poses[3:], logged_ns)


def parse_configured(words: list[str]) -> LaserLine:
    """ROBOTLASER and RAWLASER lines, which describe their own fan.

    Raises ValueError for what describes no fan.
    """
    start, _fov, step, range_max, _accuracy = _finite(_take(words, 2, 5)).tolist()
    count = _count(_take(words, 8, 1)[0], least=2)
    if not (step > 0.0 and step * (count - 1) < 2.0 * math.pi + step and range_max > 0.0):
        raise ValueError(
            f"a step of {step} rad over {count} beams and a maximum of {range_max} m make no laser"
        )
    readings = np.array(_take(words, 9, count), dtype=np.float64)
    at = 9 + count
    remissions = _count(_take(words, at, 1)[0], least=0)
    intensities = np.array(_take(words, at + 1, remissions), dtype=np.float32)
    at += 1 + remissions
    poses = _finite(_take(words, at, 6)) if words[0].startswith("ROBOT") else None
    at += 0 if poses is None else 11
    return LaserLine(
        stamp_ns_from_decimal(_take(words, at, 1)[0]),
        Fan(start, step, count, range_max),
        readings,
        intensities if remissions == count else None,
        None if poses is None else poses[:3],
        None if poses is None else poses[3:],
        _logged_ns(words, at),
    )


_OTHER_MESSAGES = ("SYNC", "TRUEPOS", "NMEAGGA", "NMEARMC", "SONAR", "BUMPER", "MARKER", "IMU")
_LASERS = ("FLASER", "RLASER", *(f"{kind}LASER{i}" for kind in ("ROBOT", "RAW") for i in "12345"))
MEASURING = frozenset((*_LASERS, "ODOM"))


@dataclass(slots=True)
class CarmenContent:
    """lasers: the lines of each laser message, in file order. odometry: ODOM lines likewise.

    malformed: how many lines could not be read. first_malformed: the first of them, in words.
    """

    lasers: dict[str, list[LaserLine]] = field(default_factory=dict)
    odometry: list[OdomLine] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    ignored: Counter[str] = field(default_factory=Counter)
    malformed: int = 0
    first_malformed: str = ""


def parse_line(words: list[str]) -> LaserLine | OdomLine | None:
    """What a line measures, None for one of another kind; ValueError if it is no CARMEN line."""
    name = words[0]
    if name == "ODOM":
        return parse_odom(words)
    if name in _LASERS:
        return (parse_flaser if name in ("FLASER", "RLASER") else parse_configured)(words)
    if name == "PARAM" and len(words) < 3:
        raise ValueError("a PARAM without a value")
    if not (name.rstrip("0123456789-").isupper() or name.startswith(_OTHER_MESSAGES)):
        raise ValueError(f"{name[:30]!r} is not a CARMEN message")
    return None


def _take_line(content: CarmenContent, words: list[str]) -> None:
    name, line = words[0], parse_line(words)
    if isinstance(line, OdomLine):
        content.odometry.append(line)
    elif line is not None:
        content.lasers.setdefault(name, []).append(line)
    elif name == "PARAM":
        content.parameters[words[1]] = words[2]
    else:
        content.ignored[printable(name[:30])] += 1


def collect(path: Path) -> CarmenContent:
    """Reads every line of a file; raises as ``open_lines`` does, and InputRefused when nothing is
    a CARMEN message.

    A line that cannot be read is counted and left out.
    """
    content = CarmenContent()
    number = 0
    for number, line in _lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            _take_line(content, words)
        except ValueError as error:
            content.malformed += 1
            if content.malformed == 1:
                content.first_malformed = f"line {number}: {error}"
    if not (content.lasers or content.odometry):
        if number == 0:
            raise InputRefused(path, "the file is empty; a CARMEN log has FLASER and ODOM lines")
        seen = content.first_malformed or f"{number} lines without a laser or odometry message"
        raise InputRefused(path, f"this is not a CARMEN log with FLASER and ODOM lines ({seen})")
    return content


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        yield from open_lines(path)
    except InputRefused as refusal:
        if not refusal.where:
            raise
        raise damaged(path, refusal.reason, refusal.where, refusal) from None
