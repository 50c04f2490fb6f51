"""Collects scans as written, many at once where their layout is fixed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.io.ros.collectors import Collector
from slamsim.io.ros.columns import Alike, Opened, layout_for
from slamsim.io.ros.layouts import CdrLayout
from slamsim.recording import Origin, RawScans, ScanLayout
from slamsim.recording.row_store import RowStore
from slamsim.recording.schemas import LASER_LAYOUT, SCANS


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Scans with equally many beams. declared: (k, 7) in the order of ``ScanLayout``."""

    example: Any
    places: IntArray
    stamps_ns: IntArray
    declared: FloatArray
    ranges_m: Float32Array
    intensities: Float32Array

    @classmethod
    def of(cls, group: Alike) -> Self:
        return cls(
            group.example,
            group.places,
            group.stamps_ns(),
            np.stack([group.values(field) for field in LASER_LAYOUT], axis=1),
            group.values(SCANS.field("ranges_m")),
            group.values(SCANS.field("intensities")),
        )

    def row(self, i: int) -> Self:
        one = slice(i, i + 1)
        return type(self)(
            self.example,
            self.places[one],
            self.stamps_ns[one],
            self.declared[one],
            self.ranges_m[one],
            self.intensities[one],
        )


class ScanCollector(Collector):
    """sensor_msgs/LaserScan.

    note: how the scans were made of other messages, in words; empty for those that are scans.
    """

    kind = RawScans
    note = ""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._layouts: dict[ScanLayout, int] = {}
        self._layout_of_scans: list[NDArray[np.int32]] = []
        self._stamps: list[IntArray] = []
        self._received: list[IntArray] = []
        self._numbers: list[IntArray] = []
        self._ranges = RowStore()
        self._intensities: RowStore | None = None
        self._other_intensities = 0

    def _layout_of(self, message: Any) -> CdrLayout:
        return layout_for(SCANS, message)

    def add(self, received_ns: IntArray, batch: list[bytes]) -> None:
        parts = sorted(map(_Part.of, self._groups(batch)), key=lambda part: int(part.places[0]))
        for part in parts:
            self._note_frames(part.example, SCANS)
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
        if part.intensities.size and part.intensities.shape != part.ranges_m.shape:
            self._other_intensities += part.places.size
        if self._intensities is not None:
            fit = part.intensities.shape == part.ranges_m.shape
            blank = np.full(part.ranges_m.shape, np.nan, dtype=np.float32)
            self._intensities.add(part.intensities if fit else blank)

    def stream(self) -> RawScans:
        return RawScans(
            topic=self.topic,
            **self._frames(SCANS),
            stamps_ns=np.concatenate(self._stamps),
            received_ns=np.concatenate(self._received),
            layouts=tuple(self._layouts),
            layout_of=np.concatenate(self._layout_of_scans),
            ranges_m=self._ranges.rows(),
            intensities=None if self._intensities is None else self._intensities.rows(),
            other_intensities=self._other_intensities,
            origin=None if self.note else self._origin(),
            note=self.note,
        )

    def _origin(self) -> Origin:
        return Origin.in_order(self.topic, np.concatenate(self._numbers))


class EchoCollector(ScanCollector):
    """sensor_msgs/MultiEchoLaserScan, with one echo of each beam, as Cartographer reads it."""

    note = "the first echo of each beam"

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, lambda data: _with_first_echoes(opened(data)), is_cdr=False)


def _with_first_echoes(message: Any) -> Any:
    """The message with lists of numbers, ``inf`` for beams without an echo; None for None."""
    if message is not None:
        for name in ("ranges", "intensities"):
            firsts = [np.append(beam.echoes, np.inf)[0] for beam in getattr(message, name)]
            setattr(message, name, np.array(firsts, dtype=np.float32))
    return message
