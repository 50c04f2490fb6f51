"""One hostile input: how it is made, how it is read, and what must come of it."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

Read = Callable[[Path], object]
Fill = Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class Hostile:
    """name: of its folder in the corpus. file: which of the files below is handed over.

    fill: writes the files into the folder. words: of the refusal; empty where the input is odd
    but right, and must be read. command: what is typed before the path, where it is tried so.
    """

    name: str
    file: str
    fill: Fill
    read: Read
    words: str
    command: tuple[str, ...] = ()


Data = bytes | str | Callable[[], bytes] | Callable[[], str]
"""What is in a file; a function where it is large, so that it is made when it is written."""


def one(file: str, data: Data) -> Fill:
    """A single file."""

    def fill(folder: Path) -> None:
        made = data() if callable(data) else data
        (folder / file).write_bytes(made.encode() if isinstance(made, str) else made)

    return fill


def several(**files: Data) -> Fill:
    """Files by their names, the dot written as ``__``."""

    def fill(folder: Path) -> None:
        for name, data in files.items():
            one(name.replace("__", "."), data)(folder)

    return fill


def gz(data: bytes) -> bytes:
    return gzip.compress(data, 9, mtime=0)


def gz_of(block: bytes, times: int) -> bytes:
    """Much, packed member after member, so that little is held while it is made."""
    return gz(block) * times


def bz2_of(block: bytes, times: int) -> bytes:
    return bz2.compress(block) * times
