"""Damaged recordings: lists their files, walks over their records, collects what lies between
chunks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, ClassVar, Generic, Literal, Protocol, TypeVar

from slamsim.core.progress import Progress
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.files import open_as_found, own_file
from slamsim.guard.lock import staging_of
from slamsim.guard.staging import NEW
from slamsim.guard.unpacking import PACKINGS
from slamsim.io import LOG, TABLES
from slamsim.io.formats.carmen import CARMEN
from slamsim.io.ros.parts import natural_order
from slamsim.io.salvage.report import PATIENCE

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
            files = [file for file in _files(folder) if _SUFFIXES.get(_suffix(file)) == kind]
            if files:
                return Damaged(folder, kind, tuple(sorted(files, key=natural_order)))
    raise InputRefused(path, "there is no .mcap, .db3 or .parquet file in this folder")


def has_packed_name(path: Path) -> bool:
    """Whether a file is packed as a whole, as its name says."""
    return path.suffix.lower() in PACKINGS


def _suffix(path: Path) -> str:
    return Path(path.stem).suffix if has_packed_name(path) else path.suffix


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


@dataclass(frozen=True, slots=True)
class LoneMessage:
    """record: of a message outside of all compressed chunks, whole, as it is in the file."""

    record: bytes


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that are of no use. messages: how many by channel or connection id, None where
    nothing tells."""

    first_byte: int
    bytes: int
    reason: str
    messages: dict[int, int] | None = None


class FoundRecord(Protocol):
    """A record whose head is sound. begin, end: its bytes in the file."""

    @property
    def begin(self) -> int: ...

    @property
    def end(self) -> int: ...


_Record = TypeVar("_Record", bound=FoundRecord)
_Piece = TypeVar("_Piece")


class DamagedFile(ABC, Generic[_Record, _Piece]):
    """A damaged file of records open for reading; the caller closes ``file``.

    MAGIC, KIND: the first bytes of the format, and what it is called. ended: whether the walk came
    to the end of the data.
    """

    MAGIC: ClassVar[bytes]
    KIND: ClassVar[str]

    def __init__(self, path: Path) -> None:
        self.file: BinaryIO = open_as_found(path)
        self.size = self.file.seek(0, 2)
        self.ended = False
        self._wasted_bytes = 0

    def pieces(self, progress: Progress) -> Iterator[tuple[int, _Piece | Gap]]:
        """(byte from which on it was looked for, piece), in the order of the file; progress counts
        bytes that have been dealt with."""
        begun = 0
        for reached, piece in self._reached():
            yield begun, piece
            begun = reached
            progress(reached, self.size)

    def _reached(self) -> Iterator[tuple[int, _Piece | Gap]]:
        """(byte reached, piece)."""
        position = len(self.MAGIC)
        if self._at(0, position) != self.MAGIC:
            position = self._next_place(0)
            yield position, Gap(0, position, f"the first bytes are not those of {self.KIND}")
        while position < self.size and not self.ended:
            piece, end = self._piece_at(position)
            if piece is not None:
                yield end, piece
            position = end

    def _piece_at(self, position: int) -> tuple[_Piece | Gap | None, int]:
        """(what is there, where to go on)."""
        found = self._record_at(position)
        if isinstance(found, str):
            end = self._next_place(position + 1)
            return Gap(position, end - position, found), end
        try:
            return self._piece(found), found.end
        except Exception as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            after, counts = self._after_damaged(found)
            if not self._may_begin(after) and self._is_patient(found.end - found.begin):
                after, counts = self._next_place(position + 1), None  # its length is wrong too
            return Gap(position, after - position, reason, counts), after

    def _is_patient(self, size: int) -> bool:
        """Whether to look for records inside one that is damaged: a hostile file nests them."""
        self._wasted_bytes += size
        return self._wasted_bytes < PATIENCE * self.size

    def _at(self, position: int, length: int) -> bytes:
        self.file.seek(position)
        return self.file.read(length)

    @abstractmethod
    def _record_at(self, position: int) -> _Record | str:
        """The record there, which ends within the file; or why there is none."""

    @abstractmethod
    def _piece(self, record: _Record) -> _Piece | None:
        """What is made of a record; raises whatever the libraries raise on damage."""

    @abstractmethod
    def _after_damaged(self, record: _Record) -> tuple[int, dict[int, int] | None]:
        """(where a damaged record ends with its indexes, messages in it by channel)."""

    @abstractmethod
    def _may_begin(self, position: int) -> bool:
        """Whether a record can begin there, or the file ends before that can be told."""

    @abstractmethod
    def _next_place(self, position: int) -> int:
        """Where the walk can go on, from there; else the end of the file."""
