"""CARMEN logs: the classic 2-D laser recordings."""

from __future__ import annotations

from pathlib import Path

from slamsim.guard.unpacking import is_packed, open_lines
from slamsim.io.carmen.reader import read_carmen
from slamsim.io.formats import Contents, Format, Truth, register


def _read(path: Path, _: Truth) -> Contents:
    return Contents(read_carmen(path))


def _checksums(path: Path) -> str:
    for _ in open_lines(path):
        pass
    if is_packed(path):
        return "the packed text has checksums, and they hold"
    return "nothing: plain text has no checksums"


CARMEN = Format(
    name="carmen",
    rank=0,
    read=_read,
    suffixes=(".clf", ".log"),
    is_packable=True,
    about_files=".clf or .log (CARMEN, also .gz, .bz2 and .zst)",
    checksums=_checksums,
)
register(CARMEN)
