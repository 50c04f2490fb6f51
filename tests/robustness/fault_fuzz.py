"""What is fed to a loader until it breaks: a function of bytes, and some bytes that are right."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

Read = Callable[[Path], object]


@dataclass(frozen=True, slots=True)
class Target:
    """run: takes any bytes. seeds: some that are right. tokens: words of the format."""

    name: str
    run: Callable[[bytes], object]
    seeds: Callable[[], Iterable[bytes]]
    tokens: tuple[str, ...] = ()


@cache
def folder() -> Path:
    """Of this process, gone with it."""
    made = tempfile.mkdtemp(prefix="slamsim-fuzz-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def as_file(name: str, read: Read) -> Callable[[bytes], object]:
    def run(data: bytes) -> object:
        path = folder() / name
        path.unlink(missing_ok=True)
        path.write_bytes(data)
        return read(path)

    return run


def made(name: str, make: Callable[[Path], Path]) -> Callable[[], Iterable[bytes]]:
    """The bytes of the file that is made in a folder."""

    def seeds() -> Iterable[bytes]:
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder) / name)
            yield path.read_bytes() if path.is_file() else next(path.glob("*.db3")).read_bytes()

    return seeds


def texts(*texts: str) -> Callable[[], Iterable[bytes]]:
    return lambda: [text.encode() for text in texts]
