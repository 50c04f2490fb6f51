"""Readings of a lidar as points, whatever unit they are in and whatever stands for no return."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Cloud, Float32Array, FloatArray, IntArray
from slamsim.recording import RawScans, ScanLayout
from slamsim.slam.laser.own_body import beams_on_robot
from slamsim.slam.laser.scan_sweep import Sweep

SAMPLED_SCANS = 60
DEGREES_SPAN_RAD = 20.0
"""Beams that span more than three turns have their angles in degrees."""

LARGEST_ROOM_M, SMALLEST_ROOM_M = 60.0, 0.02
"""Median reading beyond which ranges are in no metres."""

MILLIMETRE_READING = 400.0
LEAST_RANGE_M = 0.03
FEW, MANY = 0.2, 0.5
SAME_SHARE = 0.003
"""The largest reading of all, seen this often to the last bit, stands for no return."""

LEAST_STEP_SHARE = 0.1
"""Quantile of the distances between neighbouring readings: the smallest are steps, larger ones are
values that did not occur."""

ISOLATED_M, ISOLATED_SHARE = 0.1, 0.05
"""A reading this far (and this share of it) off both neighbours, who agree, is an isolated one."""


class BeamReader:
    """Turns the scans of a recording into clouds of points as seen at each beam's own instant.

    metres_per_unit, radians_per_unit: 1, unless ranges or angles are evidently in another unit.
    rounding_m: readings are multiples of this, or at least no closer together. declared_sweep_s,
    span_rad: from the first beam of the first scan to the last, as it is taken.
    """

    def __init__(self, scans: RawScans, angle_scale: float = 1.0) -> None:
        """angle_scale: true over declared angle between beams, which stay about their middle."""
        self._scans = scans
        self.angle_scale = angle_scale
        self._angles: dict[tuple[int, int], FloatArray] = {}
        self.radians_per_unit = _radians_per_unit(scans)
        sample = _sample(scans)
        self.metres_per_unit = _metres_per_unit(sample)
        self.rounding_m = _rounding(sample) * self.metres_per_unit
        self._low, self._high = self._limits(sample)
        self._own = self._beams_on_robot(sample)
        layout, beams = self.layout_of(0) if len(scans) else (None, 0)
        self.declared_sweep_s = 0.0 if layout is None else _sweep_s(layout, beams)
        self.span_rad = 0.0 if layout is None else self.sweep(0).span_rad

    def layout_of(self, scan: int) -> tuple[ScanLayout, int]:
        """What a scan declares, and how many beams it has."""
        return self._scans.layout(scan), len(self._scans.ranges_m[scan])

    def sweep(self, scan: int) -> Sweep:
        """How the beams of a scan are taken to lie."""
        layout, beams = self.layout_of(scan)
        first = _first_rad(layout)
        step = _step_rad(layout, beams, self.radians_per_unit)
        wider = (self.angle_scale - 1.0) * step
        return Sweep(
            first_rad=first - 0.5 * wider * (beams - 1),
            step_rad=step + wider,
            beams=beams,
            declared_s=_sweep_s(layout, beams),
        )

    def middle_ns(self, scans: IntArray) -> IntArray:
        """(n,) when the middle beams of the scans fired, as they declare."""
        half_s = [0.5 * _sweep_s(*self.layout_of(int(scan))) for scan in scans]
        half_ns = np.round(np.asarray(half_s) * 1e9).astype(np.int64)
        return np.asarray(self._scans.stamps_ns[scans] + half_ns)

    def cloud(self, scan: int) -> Cloud:
        """The returns of one scan in metres, in the laser frame at the instant of each beam."""
        ranges = np.asarray(self._scans.ranges_m[scan], dtype=np.float32)
        directions = self._directions(scan, ranges.size)
        points = _points(ranges, directions, self.returns(ranges), self.metres_per_unit)
        return Cloud(0, points, np.zeros_like(points), np.ones(len(points), np.bool_))

    def returns(self, ranges: Float32Array) -> BoolArray:
        """(beams,) which readings of one scan are ranges of something that is not the robot."""
        metres = ranges.astype(np.float64) * self.metres_per_unit
        own = self._own if self._own.size == metres.size else np.zeros(metres.size, np.bool_)
        return np.isfinite(metres) & (metres > self._low) & (metres < self._high) & ~own

    def _directions(self, scan: int, beams: int) -> FloatArray:
        key = (int(self._scans.layout_of[scan]), beams)
        if key not in self._angles:
            sweep = self.sweep(scan)
            angles = sweep.first_rad + sweep.step_rad * np.arange(beams)
            self._angles[key] = np.column_stack([np.cos(angles), np.sin(angles)])
        return self._angles[key]

    def _limits(self, sample: list[Float32Array]) -> tuple[float, float]:
        """Readings strictly between are returns, in metres."""
        readings = _finite(sample) * self.metres_per_unit
        readings = readings[readings > LEAST_RANGE_M]
        low, high = LEAST_RANGE_M, np.inf
        if not readings.size:
            return low, high
        layout = self._scans.layouts[0]
        if np.mean(readings < layout.range_min_m) < FEW:
            low = max(low, layout.range_min_m)
        if np.mean(readings >= layout.range_max_m) < MANY:
            high = layout.range_max_m
        inside = readings[(readings > low) & (readings < high)]
        largest = inside.max(initial=0.0)
        if inside.size and np.mean(inside == largest) > SAME_SHARE:
            high = float(largest)
        return float(low), float(high)

    def _beams_on_robot(self, sample: list[Float32Array]) -> BoolArray:
        """(beams,) those that always see the same; empty where the number of beams changes."""
        if len(sample) < 8 or len({one.size for one in sample}) != 1:
            return np.zeros(0, np.bool_)
        readings = np.stack(sample).astype(np.float64)
        return beams_on_robot(readings * self.metres_per_unit)


def _sample(scans: RawScans) -> list[Float32Array]:
    count = len(scans)
    some = np.unique(np.linspace(0, count - 1, min(count, SAMPLED_SCANS)).astype(int))
    return [np.asarray(scans.ranges_m[int(k)], dtype=np.float32) for k in some] if count else []


def _finite(sample: list[Float32Array]) -> FloatArray:
    readings = np.concatenate([np.zeros(0, np.float32), *sample]).astype(np.float64)
    return readings[np.isfinite(readings)]


def _rounding(sample: list[Float32Array]) -> float:
    """The least usual step between neighbouring values that occur; far ranges leave some out."""
    steps = np.diff(np.unique(np.round(_finite(sample), 6)))
    return float(np.quantile(steps, LEAST_STEP_SHARE)) if steps.size else 0.0


def _radians_per_unit(scans: RawScans) -> float:
    if not scans.layouts:
        return 1.0
    layout = scans.layouts[0]
    span = abs(layout.angle_max_rad - layout.angle_min_rad)
    if len(scans) and np.isfinite(layout.angle_step_rad):
        span = max(span, abs(layout.angle_step_rad) * (len(scans.ranges_m[0]) - 1))
    return float(np.deg2rad(1.0)) if span > DEGREES_SPAN_RAD else 1.0


def _metres_per_unit(sample: list[Float32Array]) -> float:
    readings = _finite(sample)
    readings = readings[readings > 0.0]
    middle = float(np.median(readings)) if readings.size else 1.0
    if middle > LARGEST_ROOM_M:
        return 1e-3 if middle > MILLIMETRE_READING else 1e-2
    return 1e3 if middle < SMALLEST_ROOM_M else 1.0


def _step_rad(layout: ScanLayout, beams: int, radians_per_unit: float) -> float:
    """What is declared, or as good a guess as there is."""
    step = layout.angle_step_rad * radians_per_unit
    if np.isfinite(step) and step != 0.0:
        return float(step)
    span = (layout.angle_max_rad - layout.angle_min_rad) * radians_per_unit
    span = span if np.isfinite(span) and span != 0.0 else 2.0 * np.pi
    return float(span / max(beams - 1, 1))


def _first_rad(layout: ScanLayout) -> float:
    """Its unit may be another than that of the step."""
    first = layout.angle_min_rad
    if not np.isfinite(first):
        return -np.pi
    ends = abs(layout.angle_max_rad - first)
    return float(np.deg2rad(first) if ends > DEGREES_SPAN_RAD else first)


def _sweep_s(layout: ScanLayout, beams: int) -> float:
    return layout.beam_dt_s * (beams - 1) if np.isfinite(layout.beam_dt_s) else 0.0


@kernel
def _points(
    ranges: Float32Array,
    directions: FloatArray,
    returns: BoolArray,
    unit: float,
) -> FloatArray:
    points, kept = np.empty((ranges.size, 2)), 0
    last = np.empty(2)
    reach = np.empty(ranges.size)
    index = np.empty(ranges.size, np.int64)
    count = 0
    for i in range(ranges.size):
        if returns[i]:
            reach[count], index[count] = ranges[i] * unit, i
            count += 1
    for k in range(count):
        here = reach[k]
        if 0 < k < count - 1:
            last[0], last[1] = reach[k - 1], reach[k + 1]
            off = ISOLATED_M + ISOLATED_SHARE * min(here, last[0], last[1])
            if (
                np.abs(here - last[0]) > off
                and np.abs(here - last[1]) > off
                and np.abs(last[0] - last[1]) < off
            ):
                continue
        points[kept, 0] = here * directions[index[k], 0]
        points[kept, 1] = here * directions[index[k], 1]
        kept += 1
    return points[:kept].copy()
