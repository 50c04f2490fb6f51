"""Samples the ranges of a recording, and finds scans that repeat the previous one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.recording import RawScans, ScanLayout

SAMPLED_SCANS = 600


@dataclass(frozen=True, slots=True, eq=False)
class ScanSample:
    """Scans spread evenly over the recording, all of the commonest number of beams.

    layout: of the first of them. scans: (k,) their numbers. ranges_m: (k, beams). following_m:
    (k, beams) of the scan after each, nan where that has other beams. repeats: (n,) whether each
    scan of the whole recording has bit for bit the ranges of the one before.
    """

    layout: ScanLayout
    scans: IntArray
    ranges_m: Float32Array
    following_m: Float32Array
    repeats: BoolArray

    def scaled(self, factor: float) -> ScanSample:
        """The same with every range multiplied."""
        scale = np.float32(factor)
        return replace(self, ranges_m=self.ranges_m * scale, following_m=self.following_m * scale)


def sample_scans(scans: RawScans) -> ScanSample | None:
    """One pass over all ranges; None for a stream without scans or without beams."""
    every = max(len(scans) // SAMPLED_SCANS, 1)
    kept: dict[int, Float32Array] = {}
    repeats = np.zeros(len(scans), dtype=np.bool_)
    before: Float32Array | None = None
    for number, row in enumerate(scans.ranges_m):
        repeats[number] = before is not None and _same(before, row)
        before = row
        if number % every in (0, 1):
            kept[number] = row
    first = [number for number in kept if number % every == 0]
    kinds = Counter(_kind(scans, number, kept[number]) for number in first)
    if not kinds or (chosen := kinds.most_common(1)[0][0])[0] == 0:
        return None
    alike = [number for number in first if _kind(scans, number, kept[number]) == chosen]
    unknown = np.full(chosen[0], np.nan, dtype=np.float32)
    after = [kept.get(number + 1, unknown) for number in alike]
    return ScanSample(
        scans.layout(alike[0]),
        np.array(alike, dtype=np.int64),
        np.stack([kept[number] for number in alike]),
        np.stack([row if row.size == unknown.size else unknown for row in after]),
        repeats,
    )


def _kind(scans: RawScans, number: int, row: Float32Array) -> tuple[int, float, float, float]:
    """What scans must share to be looked at together; where the first beam looks is their own."""
    layout = scans.layout(number)
    return row.size, layout.angle_step_rad, layout.range_min_m, layout.range_max_m


def _same(one: Float32Array, other: Float32Array) -> bool:
    """Bit for bit, and with something in it: empty scenes are alike without being stuck."""
    if one.size != other.size or one.tobytes() != other.tobytes():
        return False
    return bool(np.isfinite(other).any())


def positive(sample: ScanSample) -> FloatArray:
    """All finite readings above zero, flat."""
    flat = sample.ranges_m[np.isfinite(sample.ranges_m)].astype(np.float64)
    return flat[flat > 0.0]
