"""A manageable share of a recording's ranges, and which scans repeat the one before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.recording import RawScans, ScanLayout
from slamsim.types import BoolArray, Float32Array, IntArray

SAMPLED_SCANS = 600


@dataclass(frozen=True, slots=True, eq=False)
class ScanSample:
    """Scans spread evenly over the recording, all of the commonest number of beams and layout.

    scans: (k,) their numbers. ranges_m: (k, beams). repeats: (n,) whether each scan of the whole
    recording has bit for bit the ranges of the one before.
    """

    layout: ScanLayout
    scans: IntArray
    ranges_m: Float32Array
    repeats: BoolArray


def sample_scans(scans: RawScans) -> ScanSample | None:
    """One pass over all ranges; None for a stream without scans or without beams."""
    every = max(len(scans) // SAMPLED_SCANS, 1)
    kept: dict[tuple[int, int], list[tuple[int, Float32Array]]] = {}
    repeats = np.zeros(len(scans), dtype=np.bool_)
    before: Float32Array | None = None
    for number, row in enumerate(scans.ranges_m):
        repeats[number] = before is not None and _same(before, row)
        before = row
        if number % every == 0:
            kept.setdefault((int(scans.layout_of[number]), row.size), []).append((number, row))
    chosen = max(kept, key=lambda kind: len(kept[kind]), default=None)
    if chosen is None or chosen[1] == 0:
        return None
    numbers = np.array([number for number, _ in kept[chosen]], dtype=np.int64)
    rows = np.stack([row for _, row in kept[chosen]])
    return ScanSample(scans.layouts[chosen[0]], numbers, rows, repeats)


def _same(one: Float32Array, other: Float32Array) -> bool:
    """Bit for bit, and with something in it: empty scenes are alike without being stuck."""
    if one.size != other.size or one.tobytes() != other.tobytes():
        return False
    return bool(np.isfinite(other).any())
