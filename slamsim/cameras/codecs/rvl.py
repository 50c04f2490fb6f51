"""RVL, lossless and fast for 16-bit depth: runs of zeros, and differences in 3-bit groups.

A. D. Wilson, "Fast lossless depth image compression", ISS 2017; the stream is that of the
compressedDepth transport of ROS: nibbles from the highest on in little-endian words of 32 bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.guard.numbers import BadNumbers

_MOST_NIBBLES = 7
"""Of a pixel: six of the largest difference (18 bits), and no more than one of its runs."""
_SPARE_NIBBLES = 64
_MOST_VALUE = 1 << 34
"""Runs and differences are far below it; a longer number is no RVL."""


def encode_rvl(depths: NDArray[np.uint16]) -> bytes:
    """The stream of an array of any shape, row by row, of uint16; 0 is no depth.

    Raises BadNumbers for other numbers.
    """
    if depths.dtype != np.uint16:
        raise BadNumbers(f"RVL holds uint16, not {depths.dtype}")
    plain = np.ascontiguousarray(depths).reshape(-1)
    nibbles = np.zeros(_MOST_NIBBLES * plain.size + _SPARE_NIBBLES, dtype=np.uint8)
    count = _encode(plain, nibbles)
    whole = nibbles[: -(-count // 8) * 8].reshape(-1, 4, 2)
    packed = (whole[:, :, 0] << 4) | whole[:, :, 1]
    return bytes(packed[:, ::-1].tobytes())


def decode_rvl(data: bytes | memoryview, count: int) -> NDArray[np.uint16]:
    """(count,) uint16; raises ValueError for a stream that ends before, or says more."""
    usable = np.frombuffer(data, dtype=np.uint8, count=len(data) // 4 * 4).reshape(-1, 4)[:, ::-1]
    depths = np.zeros(count, dtype=np.uint16)
    found = int(_decode(np.ascontiguousarray(usable).reshape(-1), depths))
    if found < 0:
        raise ValueError("the RVL data are damaged: a run is longer than the image")
    if found < count:
        raise ValueError(f"the RVL data are cut off: {found:,} of {count:,} pixels")
    return depths


@kernel
def _put(nibbles: NDArray[np.uint8], at: int, value: int) -> int:
    """Write a number in groups of three bits, the lowest first; returns the next place."""
    while True:
        group = value & 7
        value >>= 3
        nibbles[at] = group | 8 if value else group
        at += 1
        if not value:
            return at


@kernel
def _encode(depths: NDArray[np.uint16], nibbles: NDArray[np.uint8]) -> int:
    """Fill ``nibbles``; returns how many."""
    at, used, previous = 0, 0, 0
    while at < depths.size:
        zeros = at
        while at < depths.size and depths[at] == 0:
            at += 1
        used = _put(nibbles, used, at - zeros)
        begin = at
        while at < depths.size and depths[at] != 0:
            at += 1
        used = _put(nibbles, used, at - begin)
        for place in range(begin, at):
            change = int(depths[place]) - previous
            used = _put(nibbles, used, 2 * change if change >= 0 else -2 * change - 1)
            previous = int(depths[place])
    return used


@kernel
def _get(data: NDArray[np.uint8], at: int) -> tuple[int, int]:
    """(number, next nibble); a number of -1 where the data end or no number is."""
    value, factor = 0, 1
    while at < 2 * data.size and factor < _MOST_VALUE:
        nibble = (data[at >> 1] >> (0 if at & 1 else 4)) & 15
        at += 1
        value += (nibble & 7) * factor
        if nibble < 8:
            return value, at
        factor *= 8
    return -1, at


@kernel
def _decode(data: NDArray[np.uint8], depths: NDArray[np.uint16]) -> int:
    """Fill ``depths``; returns how many were there, or -1 for a run beyond the end."""
    at, done, previous = 0, 0, 0
    while done < depths.size:
        zeros, at = _get(data, at)
        values, at = _get(data, at)
        if zeros < 0 or values < 0 or (zeros == 0 and values == 0):
            return done
        if zeros + values > depths.size - done:
            return -1
        done += zeros
        for _ in range(values):
            change, at = _get(data, at)
            if change < 0:
                return done
            previous += change >> 1 if not change & 1 else -((change + 1) >> 1)
            depths[done] = previous & 65535
            done += 1
    return done
