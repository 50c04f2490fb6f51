"""The door through which every recording enters, whatever its format."""

from __future__ import annotations

from pathlib import Path

from slamsim.logs.carmen import read_carmen
from slamsim.safe.errors import InputRefused, NotFound
from slamsim.types import Log, Trajectory

_CARMEN_SUFFIXES = (".clf", ".log")
_COMPRESSIONS = (".gz", ".bz2")


def _suffix(path: Path) -> str:
    name = path.with_suffix("") if path.suffix.lower() in _COMPRESSIONS else path
    return name.suffix.lower()


def read_log(path: Path, scan_topic: str | None = None) -> Log:
    """The log at path: a CARMEN file. The truth in it, if any, is never read.

    scan_topic chooses one of several lidars; without it the one with the most scans is taken and
    ``Log.warnings`` says so. Raises NotFound, or InputRefused naming file, place and reason.
    """
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    if _suffix(path) in _CARMEN_SUFFIXES:
        return read_carmen(path, scan_topic)
    raise InputRefused(path, "no known log: .clf and .log (CARMEN, also .gz and .bz2)")


def read_truth(path: Path) -> Trajectory | None:
    """``T_map_base`` as the simulator recorded it, or None for a log without truth."""
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    return None
