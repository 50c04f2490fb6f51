"""Scans: as a lidar measured them, and freed of motion. Conventions as in ``core.types``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from slamsim.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, Samples
from slamsim.guard import numbers

MOST_BEAMS, MOST_BEAM_NS = 1_000_000, 1_000_000_000


@dataclass(frozen=True, slots=True)
class ScanGeometry:
    """What all scans of one lidar share.

    Beam ``i`` fires ``i * beam_dt_ns`` after the scan's stamp and looks along
    ``angle_min_rad + i * angle_step_rad`` in the laser frame, counter-clockwise seen from
    above its z axis. A flash scan has ``beam_dt_ns == 0``.
    """

    angle_min_rad: float
    angle_step_rad: float
    beam_count: int
    beam_dt_ns: int
    range_min_m: float
    range_max_m: float
    frame_id: str = "laser"

    def __post_init__(self) -> None:
        numbers.require_angle("the first angle of a scan", self.angle_min_rad)
        numbers.require_angle("the angle between beams", self.angle_step_rad)
        numbers.require_whole("the number of beams", self.beam_count, 1, MOST_BEAMS)
        numbers.require_whole("the ns between beams", self.beam_dt_ns, -MOST_BEAM_NS, MOST_BEAM_NS)
        numbers.require_number("the least range (m)", self.range_min_m, 0.0)
        numbers.require_number("the largest range (m)", self.range_max_m, self.range_min_m)
        alike = self.beam_count > 1 and self.angle_step_rad == 0.0
        if alike or self.range_max_m == self.range_min_m:
            raise numbers.BadNumbers(f"beams without an angle or a range between them: {self}")

    def angles_rad(self) -> FloatArray:
        """(beam_count,) direction of each beam in the laser frame."""
        steps = np.arange(self.beam_count, dtype=np.float64)
        return self.angle_min_rad + steps * self.angle_step_rad

    def offsets_ns(self) -> IntArray:
        """(beam_count,) firing time of each beam after the scan's stamp."""
        return np.arange(self.beam_count, dtype=np.int64) * self.beam_dt_ns

    @property
    def duration_ns(self) -> int:
        """From the first beam to the last."""
        return (self.beam_count - 1) * self.beam_dt_ns


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One raw sweep in the laser frame: timed beams, motion distortion included.

    stamp_ns: the instant at which beam 0 fires. ranges_m: (beam_count,) float32, ``inf`` for
    no return, ``nan`` for an invalid reading. intensities: (beam_count,) float32 or None.
    beside: what other lidars of the same robot measured at about the same time.
    """

    stamp_ns: int
    ranges_m: Float32Array
    geometry: ScanGeometry
    intensities: Float32Array | None = None
    beside: tuple[ScanBeside, ...] = ()

    def __post_init__(self) -> None:
        numbers.require_whole("the stamp of a scan (ns)", self.stamp_ns)
        numbers.require_array("the ranges of a scan", self.ranges_m, (self.geometry.beam_count,))
        if self.intensities is not None:
            numbers.require_array("the intensities", self.intensities, self.ranges_m.shape)

    @property
    def end_ns(self) -> int:
        return self.stamp_ns + self.geometry.duration_ns

    @property
    def span_ns(self) -> tuple[int, int]:
        """From the earliest beam to the latest, those of other lidars included."""
        own = min(self.stamp_ns, self.end_ns), max(self.stamp_ns, self.end_ns)
        spans = own, *(each.scan.span_ns for each in self.beside)
        return min(first for first, _ in spans), max(last for _, last in spans)

    def within(self, first_ns: int, last_ns: int) -> Scan | None:
        """The scan with those beside it that lie in a span of time; None if it does not itself."""
        if first_ns > min(self.stamp_ns, self.end_ns) or last_ns < max(self.stamp_ns, self.end_ns):
            return None
        spans = [(each, each.scan.span_ns) for each in self.beside]
        inside = (each for each, (a, b) in spans if first_ns <= a and b <= last_ns)
        return replace(self, beside=tuple(inside)) if self.beside else self


@dataclass(frozen=True, slots=True, eq=False)
class ScanBeside:
    """A scan of another lidar of the robot. T_base_laser: 4 x 4, where that one is mounted. topic:
    what it was recorded on, which no other lidar is."""

    scan: Scan
    T_base_laser: FloatArray
    topic: str


@dataclass(frozen=True, slots=True, eq=False)
class Cloud(Samples):
    """A scan freed of motion: all beams as seen from the base frame at one instant.

    points_m: (n, 2) end of each beam; a beam without return ends at the lidar's maximum range.
    origins_m: (n, 2) where the beam left the sensor. hit: (n,) whether something was there.
    own_beams: the first so many are of the robot's first lidar; None if all are.
    """

    stamp_ns: int
    points_m: FloatArray
    origins_m: FloatArray
    hit: BoolArray
    own_beams: int | None = None

    def __post_init__(self) -> None:
        numbers.require_whole("the stamp of a cloud (ns)", self.stamp_ns)
        numbers.require_finite("the points of a cloud", self.points_m, (None, 2))
        numbers.require_finite("the origins of a cloud", self.origins_m, self.points_m.shape)
        numbers.require_array("the hits of a cloud", self.hit, (len(self.points_m),), "b")


class ScanSource(Protocol):
    """The scans of a log, in time order, readable any number of times."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Scan]: ...
