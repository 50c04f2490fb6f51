"""Parts of a ROS 2 recording in a folder that has no metadata.yaml to tell their order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from slamsim.guard.errors import InputRefused
from slamsim.guard.files import own_file
from slamsim.guard.unpacking import PACKINGS

METADATA = "metadata.yaml"
_SUFFIXES = (".mcap", ".db3")
_LONGEST_BREAK_NS, _LONGEST_OVERLAP_NS = 10_000_000_000, 1_000_000_000
"""A recorder begins the next part with the message after the last of the one before, but for what
its threads have yet to write. A robot sends something at least this often; a drive that is started
by hand after another comes later, and one of a simulator begins at the same time."""
_MOST_NAMES = 8


def part_files(folder: Path) -> list[Path]:
    """The files of ROS 2 recordings in a folder, packed or not, in the order of their numbers."""
    found = [file for file in folder.iterdir() if _plain(file).suffix.lower() in _SUFFIXES]
    return [own_file(folder, file.name) for file in sorted(found, key=natural_order)]


def numbered_parts(folder: Path) -> list[Path]:
    """``part_files``; InputRefused, with a list, if their names are not those of one recording:
    one name and consecutive numbers, as recorders give them."""
    files = part_files(folder)
    names = [re.fullmatch(r"(.*?)(\d+)", _plain(file).stem) for file in files]
    known = [(name[1], int(name[2])) for name in names if name is not None]
    follow = all(b == (a[0], a[1] + 1) for a, b in pairwise(known))
    if len(known) < len(files) or not follow:
        raise several_recordings(folder, files)
    return files


def require_one_recording(
    folder: Path, files: Sequence[Path], spans_ns: Sequence[tuple[int, int] | None]
) -> None:
    """Raises InputRefused, with a list, for files that do not follow each other in time.

    spans_ns: when the first and the last message of each was received, None if not known.
    """
    told = [span for span in spans_ns if span is not None]
    breaks_ns = [after[0] - before[1] for before, after in pairwise(told)]
    if any(not -_LONGEST_OVERLAP_NS <= each <= _LONGEST_BREAK_NS for each in breaks_ns):
        raise several_recordings(folder, files)


def several_recordings(folder: Path, files: Sequence[Path]) -> InputRefused:
    """The error for a folder with recordings of which one must be named."""
    more = len(files) - _MOST_NAMES
    names = ", ".join(file.name for file in files[:_MOST_NAMES])
    names += f" and {more:,} more" if more > 0 else ""
    reason = f"holds several recordings, not the parts of one: {names}; name the one that is meant"
    return InputRefused(folder, reason)


def natural_order(path: Path) -> list[int | str]:
    """A key for sorting: ``log_10`` after ``log_9``."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if number % 2 else part for number, part in enumerate(parts)]


def _plain(file: Path) -> Path:
    """Its name as it was before it was packed as a whole."""
    return file.with_suffix("") if file.suffix.lower() in PACKINGS else file
