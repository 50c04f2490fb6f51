"""Strings inside binary records: found by the length of four bytes before them, and changed."""

from __future__ import annotations

import struct

import numpy as np
from fault_seeds import Unfit

STRINGS = (
    b"",
    b"\0",
    b"/",
    b"odom",
    b"laser",
    b"base_footprint",
    b"a\nb",
    b"\x1b[31mred",
    b"\xff\xfe",
    "\u202eü".encode(),
    b"x" * 5000,
    b"%s%n{0}",
    b"../../etc/passwd",
)


def change_string(data: bytes, rng: np.random.Generator) -> bytes:
    """One string of a record replaced; its length repaired."""
    found = _strings(data)
    if not found:
        raise Unfit
    place, length = found[int(rng.integers(len(found)))]
    text = STRINGS[int(rng.integers(len(STRINGS)))]
    if data[place + 4 : place + 4 + length].endswith(b"\0"):
        text += b"\0"
    return data[:place] + struct.pack("<I", len(text)) + text + data[place + 4 + length :]


def _strings(data: bytes) -> list[tuple[int, int]]:
    """(place of the length, length) of all that looks like a string."""
    found = []
    for place in range(min(len(data) - 4, 4000)):
        (length,) = struct.unpack_from("<I", data, place)
        text = data[place + 4 : place + 4 + length]
        if 1 <= length == len(text) and text.rstrip(b"\0").decode("latin-1").isprintable():
            found.append((place, length))
    return found
