"""Numbers, sizes and durations as people read them: one way to write each, for all commands."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

_UNITS = ("B", "kB", "MB", "GB", "TB", "PB")
_DIGITS = 4
_LEAST = 1e-6
"""Below this a number has more zeros behind its point than are readable."""
_DAY_S = 86400


def as_number(value: float, digits: int = _DIGITS) -> str:
    """At most ``digits`` significant digits, without trailing zeros: ``0.01234``, ``35,617``.

    Digits before the point are never replaced by zeros, and nothing is ``-0``.
    """
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else ("∞" if value > 0 else "-∞")
    if value == 0.0:
        return "0"
    magnitude = math.floor(math.log10(abs(value)))
    if abs(value) < _LEAST:
        return f"{value:.{digits}g}"
    text = f"{value:,.{max(digits - 1 - magnitude, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def as_interval(value: float, sigma: float) -> str:
    """``35.18 ± 0.008``: the uncertainty to two digits, the value to the same place."""
    if not sigma > 0.0 or not math.isfinite(sigma):
        return as_number(value)
    rounded = float(f"{sigma:.1e}")  # 0.0996 is 0.1: its two digits are others
    places = max(1 - math.floor(math.log10(rounded)), 0)
    whole = 1 + math.floor(math.log10(abs(value) or rounded))
    return f"{as_number(value, max(min(whole + places, _DIGITS), 1))} ± {as_number(sigma, 2)}"


def as_count(count: int, noun: str) -> str:
    """``1 scan``, ``2,345 scans``."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def as_lengths(*lengths_m: float) -> list[str]:
    """Lengths that stand beside each other, in one unit: millimetres below 0.1 m, else metres."""
    in_mm = max(map(abs, lengths_m), default=0.0) < 0.1
    factor, unit = (1e3, "mm") if in_mm else (1.0, "m")
    return [f"{as_number(factor * length_m, 3)} {unit}" for length_m in lengths_m]


def as_size(size: float) -> str:
    """``5.5 GB``; in powers of ten, as disks are sold."""
    unit = 0
    while size >= 1000.0 and unit < len(_UNITS) - 1:
        size, unit = size / 1000.0, unit + 1
    return f"{size:.3g} {_UNITS[unit]}"


def as_time(seconds: float) -> str:
    """``0.42 s``, ``51 s``, ``3 min 12 s``, ``1 h 40 min``, ``4 days 3 h``."""
    if seconds < 9.95:
        return f"{as_number(seconds, 2)} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return _two(whole, 60, "min", 1, "s")
    minutes = round(seconds / 60.0)
    if minutes * 60 < 2 * _DAY_S:
        return _two(minutes * 60, 3600, "h", 60, "min")
    return _two(round(seconds / 3600.0) * 3600, _DAY_S, "days", 3600, "h")


def _two(seconds: int, large_s: int, large: str, small_s: int, small: str) -> str:
    """In two units, the smaller left out where there is none of it."""
    count, rest = divmod(seconds, large_s)
    return f"{count} {large}" + (f" {rest // small_s} {small}" if rest >= small_s else "")


def with_unit(key: str, value: object) -> tuple[str, str]:
    """The words of a key, and its value with the unit that the key ends in."""
    if isinstance(value, list | tuple):
        if any(isinstance(one, Mapping) for one in value):
            return words_of(key), f"{len(value)}, which --json lists"
        return words_of(key), ", ".join(with_unit(key, one)[1] for one in value) or "none"
    if isinstance(value, bool):
        return words_of(key), "yes" if value else "no"
    if not isinstance(value, int | float):
        return words_of(key), str(value)
    for suffix, write in _BY_ENDING.items():
        if key.endswith(suffix):
            kept = key if suffix == "_share" else key.removesuffix(suffix)
            return words_of(kept), write(value)
    return words_of(key), f"{value:,}" if isinstance(value, int) else as_number(value)


def words_of(key: str) -> str:
    """``map wall recall`` of ``map_wall_recall``."""
    return " ".join(_NAMES.get(word, word) for word in re.split(r"[_ ]+", key))


def _metres(value: float) -> str:
    return as_lengths(value)[0] if 0.0 < abs(value) < 0.01 else f"{as_number(value)} m"


def _in(unit: str, factor: float = 1.0) -> Callable[[float], str]:
    return lambda value: f"{as_number(factor * value)}{unit}"


_NAMES = {
    **{word: word.upper() for word in ("ate", "rpe", "rmse", "nees", "imu", "cpu", "mcap", "tf")},
    "iou": "IoU",
    "rot": "rotation",
    "trans": "translation",
}
"""How words of keys are written."""

_BY_ENDING: dict[str, Callable[[float], str]] = {
    "_ms_per_scan": _in(" ms per scan"),
    "_deg_per_m": _in("°/m"),
    "_rad_per_m": _in(" rad/m"),
    "_rad_m": _in(" rad/m"),
    "_per_s": _in(" per second"),
    "_rad_s2": _in(" rad/s²"),
    "_m_s2": _in(" m/s²"),
    "_rad_s": _in(" rad/s"),
    "_m_s": _in(" m/s"),
    "_percent": _in(" %"),
    "_share": _in(" %", 100.0),
    "_bytes": as_size,
    "_mrad": _in(" mrad"),
    "_deg": _in("°"),
    "_rad": _in(" rad"),
    "_factor": _in(" ×"),
    "_km": _in(" km"),
    "_mm": _in(" mm"),
    "_ms": _in(" ms"),
    "_ns": _in(" ns"),
    "_mb": _in(" MB"),
    "_hz": _in(" Hz"),
    "_kg": _in(" kg"),
    "_m": _metres,
    "_h": lambda hours: as_time(3600.0 * hours),
    "_s": as_time,
}
"""By the end of a key: how its value is written with the unit; the longest endings first."""
