"""Random streams that depend on a seed and a name only."""

from __future__ import annotations

import hashlib
import zlib

import numpy as np


def random_stream(seed: int, *names: str) -> np.random.Generator:
    """An independent generator for each path of names, such as ``(seed, "lidar", "noise")``.

    One effect, one stream: drawing more from one never shifts another, so turning a single
    noise source on or off leaves all the others as they were.
    """
    key = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def random_bits(seed: int, *names: str) -> int:
    """64 random bits for each path of names: a hash, so that a million of them cost little.

    The same for every version of every library; different paths are independent.
    """
    path = "\0".join((str(seed), *names))
    return int.from_bytes(hashlib.blake2b(path.encode(), digest_size=8).digest(), "big")


def random_share(seed: int, *names: str) -> float:
    """Evenly distributed from 0 up to, but never, 1, from the same bits."""
    return (random_bits(seed, *names) >> 11) * 2.0**-53
