"""The scans of a recording as they were written, many at once where their bytes allow it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from slamsim.logs.bag_columns import Alike, Opened
from slamsim.logs.cdr import CdrLayout
from slamsim.logs.frames import frame_name
from slamsim.logs.messages import scan_layout
from slamsim.logs.raw_streams import Collector
from slamsim.recording import Origin, RawScans, ScanLayout
from slamsim.recording.row_store import RowStore
from slamsim.types import Float32Array, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Scans with equally many beams. declared: (k, 7) in the order of ``ScanLayout``."""

    frame_id: str
    places: IntArray
    stamps_ns: IntArray
    declared: FloatArray
    ranges_m: Float32Array
    intensities: Float32Array

    @classmethod
    def of(cls, group: Alike) -> Self:
        frame_id = frame_name(group.example.header.frame_id)
        if group.rows is None:
            return cls(frame_id, group.places, group.stamps_ns(), *_fields(group.example))
        names = group.rows.dtype.names or ()
        none = np.zeros((group.rows.size, 0), dtype=np.float32)
        with np.errstate(invalid="ignore"):  # of a signalling NaN, which becomes a quiet one
            declared = group.rows["declared"].astype(np.float64)
        return cls(
            frame_id,
            group.places,
            group.stamps_ns(),
            declared,
            np.ascontiguousarray(group.rows["ranges"]) if "ranges" in names else none,
            np.ascontiguousarray(group.rows["intensities"]) if "intensities" in names else none,
        )

    def row(self, i: int) -> Self:
        one = slice(i, i + 1)
        return type(self)(
            self.frame_id,
            self.places[one],
            self.stamps_ns[one],
            self.declared[one],
            self.ranges_m[one],
            self.intensities[one],
        )


class ScanCollector(Collector):
    """sensor_msgs/LaserScan."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._layouts: dict[ScanLayout, int] = {}
        self._layout_of_scans: list[NDArray[np.int32]] = []
        self._stamps: list[IntArray] = []
        self._received: list[IntArray] = []
        self._numbers: list[IntArray] = []
        self._ranges = RowStore()
        self._intensities: RowStore | None = None

    def _layout_of(self, message: Any) -> CdrLayout:
        return scan_layout(message.header.frame_id, len(message.ranges), len(message.intensities))

    def add(self, received_ns: IntArray, batch: list[bytes]) -> None:
        parts = sorted(map(_Part.of, self._groups(batch)), key=lambda part: int(part.places[0]))
        for part in parts:
            self._frames.setdefault(part.frame_id)
        if any(a.places[-1] > b.places[0] for a, b in pairwise(parts)):
            rows = (part.row(i) for part in parts for i in range(part.places.size))
            parts = sorted(rows, key=lambda part: int(part.places[0]))
        for part in parts:
            self.taken += part.places.size
            self._numbers.append(self._seen + part.places)
            self._append(part, received_ns[part.places])
        self._seen += len(batch)

    def _append(self, part: _Part, received_ns: IntArray) -> None:
        if not self._stamps and part.intensities.shape == part.ranges_m.shape:
            self._intensities = RowStore()
        self._stamps.append(part.stamps_ns)
        self._received.append(received_ns)
        distinct, which = np.unique(part.declared, axis=0, return_inverse=True)
        numbers = [
            self._layouts.setdefault(ScanLayout(*row), len(self._layouts))
            for row in distinct.tolist()
        ]
        self._layout_of_scans.append(np.array(numbers, dtype=np.int32)[which.ravel()])
        self._ranges.add(part.ranges_m)
        if self._intensities is not None:
            fit = part.intensities.shape == part.ranges_m.shape
            blank = np.full(part.ranges_m.shape, np.nan, dtype=np.float32)
            self._intensities.add(part.intensities if fit else blank)

    def stream(self) -> RawScans:
        return RawScans(
            topic=self.topic,
            frame_ids=tuple(self._frames),
            stamps_ns=np.concatenate(self._stamps),
            received_ns=np.concatenate(self._received),
            layouts=tuple(self._layouts),
            layout_of=np.concatenate(self._layout_of_scans),
            ranges_m=self._ranges.rows(),
            intensities=None if self._intensities is None else self._intensities.rows(),
            origin=Origin.in_order(self.topic, np.concatenate(self._numbers)),
        )


def _fields(message: Any) -> tuple[FloatArray, Float32Array, Float32Array]:
    declared = (
        message.angle_min,
        message.angle_max,
        message.angle_increment,
        message.time_increment,
        message.scan_time,
        message.range_min,
        message.range_max,
    )
    return (
        np.array([declared], dtype=np.float64),
        np.array([message.ranges], dtype=np.float32),
        np.array([message.intensities], dtype=np.float32),
    )
