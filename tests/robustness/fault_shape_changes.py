"""Changes that know numbers in text, meshes and pictures, lengths and checksums repaired."""

from __future__ import annotations

import json
import re
import struct
import zlib
from typing import Any

import numpy as np
from fault_changes import PLAIN
from fault_corpus_images import chunk
from fault_corpus_meshes import glb, glb_parts
from fault_seeds import Change, Unfit

_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_NUMBERS = (
    *("0", "-0.0", "1", "-1", "2", "3", "7", "0.5", "1e-3", "1e-9", "5e-324", "1e3", "99999"),
    *("1e9", "-1e9", "1e38", "1e308", "1e999", "nan", ".nan", "inf", "-.inf", "2147483648"),
    *("9223372036854775808", "-2147483649", "0x7f", "''", "[]", "true", "null", "9" * 50),
)
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-30, 5e-324, 1e5, 1e6, -1e30, 3e38, float("nan"), float("inf"))
_WHOLES = (0, 1, 2, 3, 254, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1)


def change_numbers(data: bytes, rng: np.random.Generator) -> bytes:
    """One to three numbers of a text: others, or scaled, or one digit more or less."""
    for _ in range(int(rng.integers(1, 4))):
        found = list(_NUMBER.finditer(data))
        if not found:
            raise Unfit
        match = found[int(rng.integers(len(found)))]
        old, kind = match[0].decode(), int(rng.integers(4))
        if kind == 0:
            new = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
        elif kind == 1:
            new = repr(float(old) * float(rng.choice([-1.0, 0.1, 0.9, 1.1, 10.0, 1e3])))
        elif kind == 2:
            new = old[:-1] or "0"
        else:
            new = old + str(int(rng.integers(10)))
        data = data[: match.start()] + new.encode() + data[match.end() :]
    return data


def change_elements(data: bytes, rng: np.random.Generator) -> bytes:
    """An element of XML lost, doubled or moved elsewhere."""
    whole = re.compile(rb"<(\w+)\b[^<>]*/>|<(\w+)\b[^<>]*>(?:(?!<\2\b).)*?</\2>", re.DOTALL)
    found = list(whole.finditer(data))
    if not found:
        raise Unfit
    match, other = (found[int(i)] for i in rng.integers(0, len(found), 2))
    kind = int(rng.integers(3))
    if kind == 0:
        return data[: match.start()] + data[match.end() :]
    moved = data[: other.end()] + match[0] + data[other.end() :]
    return moved if kind == 1 else moved.replace(match[0], b"", 1)


def change_triangles(data: bytes, rng: np.random.Generator) -> bytes:
    """Corners of a binary STL, or fewer or more triangles with their number repaired."""
    count = (len(data) - 84) // 50
    if count < 1:
        raise Unfit
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        place = 84 + 50 * int(rng.integers(count)) + 4 * int(rng.integers(12))
        struct.pack_into("<f", changed, place, _FLOATS[int(rng.integers(len(_FLOATS)))])
    kept = int(rng.integers(1, count + 1)) if rng.random() < 0.3 else count
    body = bytes(changed[84 : 84 + 50 * kept]) * (2 if rng.random() < 0.2 else 1)
    return bytes(changed[:80]) + struct.pack("<I", len(body) // 50) + body


def change_ply(data: bytes, rng: np.random.Generator) -> bytes:
    """Numbers behind the header of a PLY, of four bytes each, or its header in words."""
    mark = b"end_header\n"
    head, found, body = data.partition(mark)
    if not found or rng.random() < 0.3:
        return change_numbers(head, rng) + found + body
    return head + found + _other_numbers(body, rng)


def change_glb(data: bytes, rng: np.random.Generator) -> bytes:
    """Values of the description, or of what it points to; the lengths repaired."""
    try:
        scene, binary = glb_parts(data)
    except (ValueError, struct.error):
        raise Unfit from None
    if rng.random() < 0.5:
        return glb(scene, _other_numbers(binary, rng))
    for _ in range(int(rng.integers(1, 4))):
        _change_value(scene, rng)
    return glb(scene, binary)


def _change_value(scene: Any, rng: np.random.Generator) -> None:
    """Somewhere in nested lists and mappings: another value, one lost or one doubled."""
    at = scene
    while True:
        keys = list(at) if isinstance(at, dict) else list(range(len(at)))
        if not keys:
            return
        key = keys[int(rng.integers(len(keys)))]
        if not isinstance(at[key], dict | list) or rng.random() < 0.15:
            break
        at = at[key]
    kind = int(rng.integers(4))
    if kind == 0:
        del at[key]
    elif kind == 1 and isinstance(at, list):
        at.append(json.loads(json.dumps(at[key])))
    else:
        at[key] = [*_WHOLES, -1, 0.5, 1e300, "a", None, [], {}, True][int(rng.integers(20))]


def _other_numbers(body: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(body)
    if len(changed) < 8:
        raise Unfit
    for _ in range(int(rng.integers(1, 5))):
        place = int(rng.integers(len(changed) - 4))
        place -= 0 if rng.random() < 0.2 else place % 4
        if rng.random() < 0.5:
            struct.pack_into("<f", changed, place, _FLOATS[int(rng.integers(len(_FLOATS)))])
        else:
            struct.pack_into("<I", changed, place, _WHOLES[int(rng.integers(len(_WHOLES)))])
    return bytes(changed)


def change_picture(data: bytes, rng: np.random.Generator) -> bytes:
    """A PNG with another header, or other pixels packed again; every checksum repaired."""
    if not data.startswith(b"\x89PNG"):
        return change_numbers(data, rng)
    parts, place = list[tuple[bytes, bytes]](), 8
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        parts.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    number = int(rng.integers(len(parts)))
    kind, content = parts[number]
    change = PLAIN[int(rng.integers(len(PLAIN)))]
    if kind == b"IDAT" and rng.random() < 0.7:
        try:
            content = zlib.compress(change(zlib.decompress(content), rng))
        except zlib.error:
            raise Unfit from None
    else:
        content = change(content, rng)
    parts[number] = (kind, content)
    return data[:8] + b"".join(chunk(kind, content) for kind, content in parts)


NUMBERS: tuple[Change, ...] = (change_numbers,)
