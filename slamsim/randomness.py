"""Random streams that depend on a seed and a name, and on nothing else."""

from __future__ import annotations

import zlib

import numpy as np


def random_stream(seed: int, *names: str) -> np.random.Generator:
    """An independent generator for each path of names, such as ``(seed, "lidar", "noise")``.

    One effect, one stream: drawing more from one never shifts another, so turning a single
    noise source on or off leaves all the others as they were.
    """
    key = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
