"""Recording formats: one module each, found automatically.

A module of this folder calls ``register`` with a ``Format``; nothing else has to know of it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal

from slamsim.recording import RawOdometry, Recording

PACKINGS = (".gz", ".bz2")
Truth = Literal["without", "with", "only"]
"""What of a recording is read: all but the truth in it, all, or the truth alone."""


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """What was read of a file.

    truth: as a simulator recorded it, if it was asked for and is there. truth_damage: where it is
    and why it cannot be decoded.
    """

    recording: Recording
    truth: RawOdometry | None = None
    truth_damage: tuple[str, str] | None = None


def _not_found(_: Path) -> Path | None:
    return None


def _unchecked(_: Path) -> str:
    return "nothing: the format has no checksums"


@dataclass(frozen=True, slots=True)
class Format:
    """A format of files or folders that hold a recording.

    rank: of several recordings in one folder that of the lowest is read. suffixes: of its files,
    in lower case. is_packable: whether they may end in one of ``PACKINGS`` besides. about_files,
    about_folders: what it takes, as a user is told. in_folder: the recording in a folder, None for
    none. read: of (path, what of the truth). has_truth: whether recordings may hold one.
    checksums: reads a recording to its last byte and says in words what its checksums prove.
    """

    name: str
    rank: int
    read: Callable[[Path, Truth], Contents]
    suffixes: tuple[str, ...] = ()
    is_packable: bool = False
    about_files: str = ""
    about_folders: str = ""
    in_folder: Callable[[Path], Path | None] = _not_found
    has_truth: bool = False
    checksums: Callable[[Path], str] = _unchecked

    def is_file(self, path: Path) -> bool:
        """Whether the name is that of one of its files."""
        packed = self.is_packable and path.suffix.lower() in PACKINGS
        suffix = (path.with_suffix("") if packed else path).suffix.lower()
        return suffix in self.suffixes and path.is_file()

    def is_at(self, path: Path) -> bool:
        """Whether a path is a recording of this format."""
        return self.in_folder(path) == path if path.is_dir() else self.is_file(path)


_REGISTERED: dict[str, Format] = {}


def register(one: Format) -> None:
    """Read recordings of this format from now on."""
    _REGISTERED[one.name] = one


def formats() -> tuple[Format, ...]:
    """All of them, by rank."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return tuple(sorted(_REGISTERED.values(), key=lambda each: each.rank))
