"""Sizes and durations as readable text."""

from __future__ import annotations

_UNITS = ("B", "kB", "MB", "GB", "TB", "PB")


def as_size(size: float) -> str:
    """``5.5 GB``; in powers of ten, as disks are sold."""
    unit = 0
    while size >= 1000.0 and unit < len(_UNITS) - 1:
        size, unit = size / 1000.0, unit + 1
    return f"{size:.3g} {_UNITS[unit]}"


def as_time(seconds: float) -> str:
    """``1 h 40 min``, ``12 min``, ``8 s``."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    if minutes < 100:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours < 100 else f"{hours / 24.0:.1f} days"
