"""Lists the files of a damaged recording."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.files import open_as_found, own_file
from slamsim.guard.lock import staging_of
from slamsim.guard.staging import NEW
from slamsim.io.formats.carmen import CARMEN
from slamsim.io.names import LOG, TABLES

Kind = Literal["ROS 2", "ROS 1", "CARMEN", "Parquet"]

_SUFFIXES: dict[str, Kind] = {
    ".mcap": "ROS 2",
    ".db3": "ROS 2",
    ".bag": "ROS 1",
    ".parquet": "Parquet",
}
_FIRST_BYTES: dict[bytes, Kind] = {
    b"\x89MCAP": "ROS 2",
    b"SQLite": "ROS 2",
    b"#ROSBA": "ROS 1",
}
_IN_FOLDERS: tuple[Kind, ...] = ("ROS 2", "Parquet")
_PLACES = ("", LOG, TABLES)


@dataclass(frozen=True, slots=True)
class Damaged:
    """path: the file or folder. files: in the order in which they were written."""

    path: Path
    kind: Kind
    files: tuple[Path, ...]

    @property
    def bytes(self) -> int:
        return sum(file.stat().st_size for file in self.files)


def damaged_recording(path: Path) -> Damaged:
    """What can be looked through at ``path``: a file, a folder with or without metadata.yaml, or
    what a killed run left of the folder it was to make. Raises NotFound or InputRefused.
    """
    if not path.exists():
        staging = staging_of(path) if path.name else None
        if staging is None or not (staging / NEW).is_dir():
            raise NotFound(f"{path}: there is no such file or folder")
        path = own_file(staging.parent, f"{staging.name}/{NEW}")
    if not path.is_dir():
        return Damaged(path, _kind(path), (path,))
    for place in _PLACES:
        folder = own_file(path, place)
        for kind in _IN_FOLDERS:
            files = [file for file in _files(folder) if _SUFFIXES.get(file.suffix) == kind]
            if files:
                return Damaged(folder, kind, tuple(sorted(files, key=_natural)))
    raise InputRefused(path, "there is no .mcap, .db3 or .parquet file in this folder")


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [own_file(folder, file.name) for file in folder.iterdir() if file.is_file()]


def _kind(path: Path) -> Kind:
    if CARMEN.is_file(path):
        return "CARMEN"
    for suffix in reversed(path.suffixes):  # a recorder that was killed leaves a .bag.active
        if suffix.lower() in _SUFFIXES:
            return _SUFFIXES[suffix.lower()]
    with open_as_found(path) as file:
        first = file.read(6)
    if first not in _FIRST_BYTES:
        raise InputRefused(path, "is not a known recording format: MCAP, .db3, .bag, CARMEN")
    return _FIRST_BYTES[first]


def is_sqlite(path: Path) -> bool:
    """Of the files of ROS 2 recordings, by the name, else by the first bytes."""
    if path.suffix.lower() in _SUFFIXES:
        return path.suffix.lower() == ".db3"
    with open_as_found(path) as file:
        return file.read(6) == b"SQLite"


def _natural(path: Path) -> list[int | str]:
    """``log_10`` after ``log_9``."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if number % 2 else part for number, part in enumerate(parts)]
