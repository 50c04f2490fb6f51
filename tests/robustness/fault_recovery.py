"""A damaged recording made and recovered, for the tests of recovery."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.report import Recovered
from slamsim.io.salvage.source import damaged_recording

MANY = pytest.mark.parametrize("count", [15, pytest.param(60, marks=pytest.mark.slow)])
"""In how many places a file is cut or damaged."""


def recovered_from(data: bytes, folder: Path, name: str) -> tuple[Recovered, Path]:
    """(what is told, the folder written) of a file with these bytes and this name."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "out").mkdir(parents=True)
    (folder / name).write_bytes(data)
    told = recover(damaged_recording(folder / name), folder / "out")
    assert (folder / name).read_bytes() == data
    return told, folder / "out"


def damaged(data: bytes, seed: int, count: int) -> Iterator[tuple[int, bytes]]:
    """(first changed byte, content) with 1 to 8 changed bytes in a row."""
    rng = np.random.default_rng(seed)
    for first in rng.integers(0, len(data) - 8, count).tolist():
        changed = bytearray(data)
        for position in range(first, first + int(rng.integers(1, 9))):
            changed[position] ^= int(rng.integers(1, 256))
        yield first, bytes(changed)


def cuts(data: bytes, seed: int, edges: list[int], count: int) -> list[int]:
    """Where to cut: anywhere, and just beside some of the edges."""
    rng = np.random.default_rng(seed)
    beside = [edge + step for edge in edges for step in (-1, 0, 1)]
    chosen = [*rng.integers(0, len(data), count).tolist(), *rng.permutation(beside)[:10].tolist()]
    return sorted(set(chosen))
