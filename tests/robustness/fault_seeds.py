"""Valid inputs that are to be damaged: how each is made, read and changed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import numpy as np

Read = Callable[[Path], object]
"""Reads an input as deep as a user would. Gives a value that ``digest`` takes; raises
AssertionError for one that is not sane, and whatever the reader raises."""
Change = Callable[[bytes, np.random.Generator], bytes]
"""Other bytes for those of a file; raises Unfit where it can make nothing of them."""


class Unfit(Exception):
    """A change that these bytes do not allow."""


@dataclass(frozen=True, slots=True)
class Seed:
    """One kind of input.

    make: writes it into an empty folder and gives the path to be read; equal at each call.
    sealed: its checksums cover all that is read, so that a result other than that of the whole
    input is damage passed on. changes: those that know the structure and repair the checksums; what
    they make counts as another input, not as damage. rarely: (n, read): one case in n is read so
    instead of by ``read``.
    """

    name: str
    make: Callable[[Path], Path]
    read: Read
    sealed: bool = False
    changes: tuple[Change, ...] = ()
    rarely: tuple[tuple[int, Read], ...] = ()


def digest(value: object) -> str:
    """One hash of numbers, texts, arrays, mappings, sequences and dataclasses of them."""
    found = hashlib.sha256()
    for part in _parts(value):
        found.update(part)
    return found.hexdigest()[:16]


def _parts(value: object) -> Iterable[bytes]:
    if isinstance(value, np.ndarray) and value.dtype != object:
        yield f"{value.dtype}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value) and not isinstance(value, type):
        yield type(value).__name__.encode()
        for field in fields(value):
            yield field.name.encode()
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key, held in value.items():
            yield repr(key).encode()
            yield from _parts(held)
    elif isinstance(value, Iterable) and not isinstance(value, str | bytes):
        yield b"["
        for held in value:
            yield from _parts(held)
        yield b"]"
    else:
        yield repr(value).encode("utf-8", "backslashreplace")
