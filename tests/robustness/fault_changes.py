"""Changes to the bytes of any file, whatever it holds."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from fault_seeds import Change, Unfit

_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_WIDE = (2**62, 2**63 - 1, 2**63, 2**64 - 1)
_FLOATS = (float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 5e-324, -0.0, 1e-30)


def flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    """One to eight bits."""
    changed = bytearray(_some(data))
    for place in rng.integers(0, len(data), rng.integers(1, 9)):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def change_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """One to eight bytes."""
    changed = bytearray(_some(data))
    for place in rng.integers(0, len(data), rng.integers(1, 9)):
        changed[place] ^= int(rng.integers(1, 256))
    return bytes(changed)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end is missing."""
    return data[: int(rng.integers(0, len(_some(data))))]


def delete(data: bytes, rng: np.random.Generator) -> bytes:
    """A block in the middle is missing."""
    start, length = _block(data, rng)
    return data[:start] + data[start + length :]


def insert(data: bytes, rng: np.random.Generator) -> bytes:
    """A block of zeros, of noise or of what stands elsewhere."""
    start, length = _block(data, rng)
    kind = int(rng.integers(3))
    block = (bytes(length), rng.bytes(length), data[start : start + length])[kind]
    place = int(rng.integers(0, len(data) + 1))
    return data[:place] + block + data[place:]


def swap(data: bytes, rng: np.random.Generator) -> bytes:
    """Two blocks change places."""
    (a, length), b = _block(data, rng), int(rng.integers(0, len(data)))
    if a > b:
        a, b = b, a
    length = min(length, b - a, len(data) - b)
    middle = data[a + length : b]
    return data[:a] + data[b : b + length] + middle + data[a : a + length] + data[b + length :]


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    """A block comes several times."""
    start, length = _block(data, rng)
    return data[: start + length] + data[start : start + length] * int(
        rng.integers(1, 9)
    ) + data[start + length :]  # fmt: skip


def overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    """A number that programs stumble over, of one to eight bytes."""
    kind = int(rng.integers(3))
    if kind == 0:
        number = struct.pack("<Q", int(rng.choice(np.array(_INTERESTING, dtype=np.uint64))))
        number = number[: int(rng.choice([1, 2, 4]))]
    elif kind == 1:
        number = struct.pack("<Q", _WIDE[int(rng.integers(len(_WIDE)))])
    else:
        value = _FLOATS[int(rng.integers(len(_FLOATS)))]
        wide = abs(value) < 1e30 or not np.isfinite(value)
        number = struct.pack("<f" if wide and rng.random() < 0.5 else "<d", value)
    if rng.random() < 0.3:
        number = number[::-1]
    place = int(rng.integers(0, len(_some(data))))
    return (data[:place] + number + data[place + len(number) :])[: max(len(data), place + 1)]


PLAIN: tuple[Change, ...] = (
    flip_bits,
    change_bytes,
    cut,
    delete,
    insert,
    swap,
    repeat,
    overwrite,
)


def splice_with(donors: Sequence[bytes]) -> Change:
    """The begin of one file and the end, or a block, of another."""

    def splice(data: bytes, rng: np.random.Generator) -> bytes:
        donor = donors[int(rng.integers(len(donors)))]
        start, length = _block(donor, rng)
        place = int(rng.integers(1, max(len(_some(data)), 2)))
        if rng.random() < 0.5:
            return data[:place] + donor[start:]
        return data[:place] + donor[start : start + length] + data[place + length :]

    return splice


def _some(data: bytes) -> bytes:
    if not data:
        raise Unfit
    return data


def _block(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    """(start, length) of a block, short ones as likely as long ones."""
    start = int(rng.integers(0, len(_some(data))))
    longest = min(len(data) - start, 1 << 16)
    return start, min(int(np.exp(rng.uniform(0.0, np.log(longest + 1.0)))), longest)
