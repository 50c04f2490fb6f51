"""Faults of the ranges themselves, and of what a scan declares about them."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.core.types import Float32Array
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.base import SCANS, CannotEdit, Edit, Edits
from slamsim.recording.edits.beams import ExtendAngleMax, ScaleRangeLimits, SetRangeLimits
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.recording.edits.ranges import (
    ChangeRanges,
    CodeNoReturn,
    OffsetRanges,
    ScaleRanges,
    range_matrix,
)
from slamsim.sensors.faults.base import Fault


class NoReturn(Fault):
    """A number that could be a range stands for no return."""

    kind: Literal["no_return"]
    reads: Literal["zero", "range_max"]
    """What stands there."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return CodeNoReturn(SCANS, 0.0 if self.reads == "zero" else None)


class RangeUnit(Fault):
    """Ranges are not in metres."""

    kind: Literal["range_unit"]
    factor: float = Field(gt=0.0, le=1e6)
    """How many of the unit are a metre."""
    limits_too: bool = False
    """Whether the declared limits are in that unit as well."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        readings = ScaleRanges(SCANS, self.factor)
        if not self.limits_too:
            return readings
        return Edits((readings, ScaleRangeLimits(SCANS, self.factor)))


class RangeOffset(Fault):
    """Every range is too long, or too short, by the same."""

    kind: Literal["range_offset"]
    offset_m: float = Field(ge=-10.0, le=10.0)
    """Read less true."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return OffsetRanges(SCANS, self.offset_m)


class RangesWrapped(Fault):
    """Ranges are kept in too few bits: where they pass a number they begin anew at zero."""

    kind: Literal["ranges_wrapped"]
    period_m: float = Field(gt=0.0, le=1e3)
    """The number."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def wrapped(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            seen = np.isfinite(ranges_m)
            if not (ranges_m[seen] >= self.period_m).any():
                raise CannotEdit(f"{scans.topic} reads nothing beyond {self.period_m:g} m")
            ranges_m[seen] %= np.float32(self.period_m)
            return ranges_m

        return ChangeRanges(SCANS, wrapped)


class RangeLimits(Fault):
    """The declared limits do not hold what is read."""

    kind: Literal["range_limits"]
    range_max_m: float = Field(gt=0.0, le=1e4)
    """Declared instead of the right one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return SetRangeLimits(SCANS, range_max_m=self.range_max_m)


class BeamsBlind(Fault):
    """Neighbouring beams always see the robot itself, or nothing."""

    kind: Literal["beams_blind"]
    share: float = Field(gt=0.0, lt=1.0)
    """Of the beams, at a quarter of the scan."""
    sees: Literal["robot", "nothing"]
    """A part of the robot 0.2 m away, with a millimetre of noise; or nothing."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def blinded(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            beams = ranges_m.shape[1]
            first, count = beams // 4, max(round(self.share * beams), 1)
            part = ranges_m[:, first : first + count]
            part[:] = np.inf if self.sees == "nothing" else rng.normal(0.2, 0.001, part.shape)
            return ranges_m

        return ChangeRanges(SCANS, blinded)


class BeamsLost(Fault):
    """Single beams return nothing, here and there: a dirty window, black walls, a weak laser."""

    kind: Literal["beams_lost"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the beams."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def weakened(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            lost = rng.random(ranges_m.shape) < self.share
            return np.where(lost, np.float32(np.inf), ranges_m)

        return ChangeRanges(SCANS, weakened)


class ScanStuck(Fault):
    """The last scan comes again and again, for a while at a time."""

    kind: Literal["scan_stuck"]
    stuck_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=3, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def stuck(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            stamps = scans.stamps_ns
            first, last = float(stamps[0]), float(stamps[-1])
            source = np.arange(stamps.size)
            for start in first + (last - first) * np.arange(1, self.times + 1) / (self.times + 1):
                again = (stamps >= start) & (stamps < start + self.stuck_s * 1e9)
                source[again] = source[again].min(initial=stamps.size)
            return ranges_m[source]

        return ChangeRanges(SCANS, stuck)


class Interference(Fault):
    """Another lidar or the sun makes single beams read too little."""

    kind: Literal["interference"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the beams that read anything between the minimum and what is there."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def disturbed(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            low, high = scans.layout(0).range_min_m, scans.layout(0).range_max_m
            hit = rng.random(ranges_m.shape) < self.share
            reach = np.where(np.isfinite(ranges_m), ranges_m, high)
            shorter = low + rng.random(ranges_m.shape) * np.maximum(reach - low, 0.0)
            return np.where(hit, shorter, ranges_m).astype(np.float32)

        return ChangeRanges(SCANS, disturbed)


class IntensitiesShort(Fault):
    """Messages hold fewer intensities than ranges."""

    kind: Literal["intensities_short"]
    share: float = Field(ge=0.01, le=0.99)
    """Of the beams that have one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def with_some(scans: RawScans) -> RawScans:
            beams = range_matrix(scans).shape[1]
            strengths = rng.uniform(100.0, 4000.0, (len(scans), max(round(self.share * beams), 1)))
            return replace(scans, intensities=strengths.astype(np.float32))

        return ChangeMessages(SCANS, with_some)


class ScanTimeWrong(Fault):
    """The declared time from scan to scan is not that at which they come."""

    kind: Literal["scan_time_wrong"]
    factor: float = Field(gt=0.0, le=1e6)
    """Declared over true."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def declared(scans: RawScans) -> RawScans:
            period_s = float(np.median(np.diff(scans.stamps_ns))) * 1e-9 if len(scans) > 1 else 0.0
            layouts = (replace(one, scan_time_s=self.factor * period_s) for one in scans.layouts)
            return replace(scans, layouts=tuple(layouts))

        return ChangeMessages(SCANS, declared)


class ScanLayoutWrong(Fault):
    """The declared end of the scan does not fit the number of its beams."""

    kind: Literal["scan_layout"]
    beams: int = Field(ge=-100_000, le=100_000)
    """How many beams more the declared angles would have."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ExtendAngleMax(SCANS, self.beams)
