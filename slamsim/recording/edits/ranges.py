"""Edits of the readings of a lidar: scaled, offset, marked, replaced."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.types import BoolArray, Float32Array
from slamsim.recording import RawScans
from slamsim.recording.edits.base import CannotEdit, MessagesEdit, reciprocal
from slamsim.recording.row_store import RowStore

_BLOCK = 2048
"""Scans that are in memory at a time."""
_INF, _NAN = np.float32(np.inf), np.float32(np.nan)


@dataclass(frozen=True, slots=True)
class ScaleRanges(MessagesEdit):
    """Every reading times ``factor``: another unit, or a wrong scale."""

    factor: float

    def changed(self, scans: RawScans) -> RawScans:
        return map_ranges(scans, lambda ranges_m: ranges_m * np.float32(self.factor))

    def inverse(self) -> ScaleRanges:
        return replace(self, factor=reciprocal(self.factor))


@dataclass(frozen=True, slots=True)
class OffsetRanges(MessagesEdit):
    """``offset_m`` added to every reading.

    only_returns: to those alone that are a range, above zero and below the declared maximum; the
    inverse is then one where the offset takes no reading beyond these.
    """

    offset_m: float
    only_returns: bool = False

    def changed(self, scans: RawScans) -> RawScans:
        offset_m = np.float32(self.offset_m)
        if not self.only_returns:
            return map_ranges(scans, lambda ranges_m: ranges_m + offset_m)
        largest = np.float32(max(layout.range_max_m for layout in scans.layouts))
        return map_ranges(
            scans,
            lambda r: np.where(np.isfinite(r) & (r > 0.0) & (r < largest), r + offset_m, r),
        )

    def inverse(self) -> OffsetRanges:
        return replace(self, offset_m=-self.offset_m)


@dataclass(frozen=True, slots=True)
class CodeNoReturn(MessagesEdit):
    """A number in the place of no return: not finite, or beyond the declared maximum.

    code_m: the number; None for the declared maximum. The inverse gives infinity for each.
    """

    code_m: float | None

    def changed(self, scans: RawScans) -> RawScans:
        if len(scans) == 0:
            return scans
        largest_m = scans.layout(0).range_max_m
        code_m = np.float32(largest_m if self.code_m is None else self.code_m)

        def nothing(ranges_m: Float32Array) -> BoolArray:
            return ~np.isfinite(ranges_m) | (ranges_m > largest_m)

        if not any(nothing(scans.ranges_m[i]).any() for i in range(len(scans))):
            raise CannotEdit(f"every beam on {scans.topic} returns")
        return map_ranges(scans, lambda r: np.where(nothing(r), code_m, r))

    def inverse(self) -> DecodeNoReturn:
        if self.code_m is None:
            raise CannotEdit("a code that each scan declares cannot be undone without the scan")
        return DecodeNoReturn(self.target, self.code_m)


@dataclass(frozen=True, slots=True)
class DecodeNoReturn(MessagesEdit):
    """Infinity in the place of ``code_m``, which stands for no return; ``tolerance_m`` about it."""

    code_m: float
    tolerance_m: float = 0.0

    def changed(self, scans: RawScans) -> RawScans:
        code_m = np.float32(self.code_m)
        return map_ranges(
            scans, lambda r: np.where(np.abs(r - code_m) <= self.tolerance_m, _INF, r)
        )


@dataclass(frozen=True, slots=True)
class BlankBeams(MessagesEdit):
    """The beams ``first`` to ``last`` without a reading in every scan."""

    first: int
    last: int

    def changed(self, scans: RawScans) -> RawScans:
        return map_ranges(scans, self._blank)

    def _blank(self, ranges_m: Float32Array) -> Float32Array:
        found = np.array(ranges_m)
        found[:, self.first : self.last + 1] = _NAN
        return found


@dataclass(frozen=True, slots=True)
class ChangeRanges(MessagesEdit):
    """All readings of a lidar replaced.

    change: from a copy of the (n, beams) ranges, and the scans that they are of, to (n, beams).
    Raises CannotEdit where scans differ in their number of beams.
    """

    change: Callable[[Float32Array, RawScans], Float32Array]

    def changed(self, scans: RawScans) -> RawScans:
        if len(scans) == 0:
            return scans
        return replace(scans, ranges_m=self.change(range_matrix(scans), scans))


def map_ranges(scans: RawScans, change: Callable[[Float32Array], Float32Array]) -> RawScans:
    """change: from (k, beams) ranges to (k, beams) others; long recordings stay on the disk."""
    if len(scans) == 0:
        return scans
    store = RowStore()
    if isinstance(scans.ranges_m, np.ndarray):
        for start in range(0, len(scans), _BLOCK):
            changed = change(scans.ranges_m[start : start + _BLOCK])
            store.add(np.ascontiguousarray(changed, dtype=np.float32))
    else:
        for row in scans.ranges_m:
            store.add(np.ascontiguousarray(change(row[None]), dtype=np.float32))
    return replace(scans, ranges_m=store.rows())


def range_matrix(scans: RawScans) -> Float32Array:
    """(n, beams) a copy of all ranges. Raises CannotEdit if scans differ in length."""
    if isinstance(scans.ranges_m, np.ndarray):
        return scans.ranges_m.copy()
    rows: Sequence[Float32Array] = [np.asarray(row) for row in scans.ranges_m]
    if len({row.size for row in rows}) > 1:
        raise CannotEdit(f"the scans of {scans.topic} differ in their number of beams")
    return np.stack(rows) if rows else np.zeros((0, 0), dtype=np.float32)
