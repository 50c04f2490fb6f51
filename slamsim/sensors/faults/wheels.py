"""Faults of wheels and odometry: wrong sizes, wrong signs, slip, jumps and silence."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import RawOdometry, RawTicks, Recording
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.edit import is_odometry, require_wheels
from slamsim.sensors.faults.wheel_motion import (
    require_ticks,
    rewired,
    with_odometry,
    with_wheel_steps,
)


class WheelRadius(Fault):
    """The driver believes in another wheel radius."""

    SIZE: ClassVar[str | None] = "relative_error"
    kind: Literal["wheel_radius"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Believed over true, less one."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        gain = 1.0 + self.relative_error
        spoilt = with_odometry(recording, gain, gain)
        return spoilt.changed(
            RawTicks, lambda t: replace(t, wheel_radius_m=t.wheel_radius_m * gain)
        )


class WheelUnit(Fault):
    """Lengths by the wheels are not in metres."""

    SIZE: ClassVar[str | None] = "factor"
    kind: Literal["wheel_unit"]
    factor: float = Field(gt=0.0, le=1e6)
    """How many of the unit are a metre."""
    of: Literal["lengths", "radius", "odometry"] = "lengths"
    """All of them; the radius alone, so that turns are off too; or the published odometry alone."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        alone = self.of == "radius"
        spoilt = with_odometry(recording, self.factor, self.factor if alone else 1.0)
        if self.of == "odometry":
            return spoilt
        track = 1.0 if alone else self.factor

        def believed(t: RawTicks) -> RawTicks:
            radius_m = t.wheel_radius_m * self.factor
            return replace(t, wheel_radius_m=radius_m, track_m=t.track_m * track)

        return spoilt.changed(RawTicks, believed)


class WheelTrack(Fault):
    """The driver believes in another distance between the wheels."""

    SIZE: ClassVar[str | None] = "relative_error"
    kind: Literal["wheel_track"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Believed over true, less one."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        gain = 1.0 + self.relative_error
        spoilt = with_odometry(recording, 1.0, 1.0 / gain)
        return spoilt.changed(RawTicks, lambda t: replace(t, track_m=t.track_m * gain))


class WheelReversed(Fault):
    """One wheel counts backward."""

    kind: Literal["wheel_reversed"]
    wheel: Literal["left", "right"]
    """Which one."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        signs = np.array([-1, 1]) if self.wheel == "left" else np.array([1, -1])
        return rewired(recording, lambda wheels: wheels * signs)


class WheelDead(Fault):
    """One wheel's counter never counts."""

    kind: Literal["wheel_dead"]
    wheel: Literal["left", "right"]
    """Which one."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        counting = np.array([0, 1]) if self.wheel == "left" else np.array([1, 0])
        return rewired(recording, lambda wheels: wheels * counting)


class WheelsSwapped(Fault):
    """The left counter is wired to the right wheel, and the right one to the left."""

    kind: Literal["wheels_swapped"]

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return rewired(recording, lambda wheels: wheels[:, ::-1])


class TicksWrap(Fault):
    """The counters overflow."""

    SIZE: ClassVar[str | None] = "bits"
    kind: Literal["ticks_wrap"]
    bits: int = Field(ge=4, le=62)
    """Width of the counters; they are signed."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        require_ticks(recording)
        whole, half = 1 << self.bits, 1 << (self.bits - 1)
        return recording.changed(
            RawTicks, lambda t: replace(t, ticks=(t.ticks + half) % whole - half)
        )


class WheelSlip(Fault):
    """The wheels turn further than the robot moves, for a while at a time."""

    SIZE: ClassVar[str | None] = "share"
    kind: Literal["wheel_slip"]
    share: float = Field(gt=0.0, le=10.0)
    """Of the way, that the wheels turn in addition."""
    slip_s: float = Field(default=4.0, gt=0.0, le=1e4)
    """Length of each slip."""
    slips: int = Field(default=3, ge=1, le=1000)
    """How many, evenly spread over the recording."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return with_wheel_steps(recording, self._gain)

    def _gain(self, stamps_ns: IntArray) -> FloatArray:
        """(n - 1,) of each step between stamps."""
        slipping = _spells(stamps_ns[1:], self.slips, self.slip_s)
        return np.where(slipping, 1.0 + self.share, 1.0)


class OdometryContradicts(Fault):
    """The published odometry shows other distances than the counters."""

    SIZE: ClassVar[str | None] = "relative_error"
    kind: Literal["odometry_contradicts"]
    relative_error: float = Field(gt=-1.0, le=10.0)
    """Of distances and turns, against those that the counters give."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        require_ticks(recording)
        gain = 1.0 + self.relative_error
        return with_odometry(recording, gain, gain)


class OdometryJump(Fault):
    """The odometry makes a step, as when a filter is reset."""

    SIZE: ClassVar[str | None] = "jump_m"
    kind: Literal["odometry_jump"]
    jump_m: float = Field(ge=-1000.0, le=1000.0)
    """Length of the step, along x, halfway through the recording."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        require_wheels(recording)

        def jumped(positions_m: FloatArray) -> FloatArray:
            positions = positions_m.copy()
            positions[len(positions) // 2 :, 0] += self.jump_m
            return positions

        return replace(
            recording.changed(
                RawOdometry, lambda one: replace(one, positions_m=jumped(one.positions_m))
            ),
            transforms=tuple(
                replace(edge, positions_m=jumped(edge.positions_m)) if is_odometry(edge) else edge
                for edge in recording.transforms
            ),
        )


class OdometryFrozen(Fault):
    """Counters and odometry stand still while the robot moves on, and do not catch up."""

    SIZE: ClassVar[str | None] = "frozen_s"
    kind: Literal["odometry_frozen"]
    frozen_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=2, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return with_wheel_steps(recording, self._gain)

    def _gain(self, stamps_ns: IntArray) -> FloatArray:
        frozen = _spells(stamps_ns[1:], self.times, self.frozen_s)
        return np.where(frozen, 0.0, 1.0)


class TicksFrozen(Fault):
    """Only the counters stand still for a while, and do not catch up; the odometry goes on."""

    SIZE: ClassVar[str | None] = "frozen_s"
    kind: Literal["ticks_frozen"]
    frozen_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=2, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        require_ticks(recording)
        return recording.changed(RawTicks, self._frozen)

    def _frozen(self, ticks: RawTicks) -> RawTicks:
        standing = _spells(ticks.stamps_ns[1:], self.times, self.frozen_s)
        steps = np.where(standing[:, None], 0, np.diff(ticks.ticks, axis=0))
        return replace(ticks, ticks=np.vstack([ticks.ticks[:1], steps]).cumsum(axis=0))


class OdometryStill(Fault):
    """The published odometry never moves; the counters do."""

    kind: Literal["odometry_still"]

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        require_wheels(recording)
        return with_odometry(recording, 0.0, 0.0)


def _spells(stamps_ns: IntArray, count: int, length_s: float) -> BoolArray:
    """(n,) whether each instant lies in one of the spells, evenly spread over all of them."""
    if stamps_ns.size == 0:
        return np.zeros(0, dtype=np.bool_)
    first, last = float(stamps_ns.min()), float(stamps_ns.max())
    middles = first + (last - first) * (np.arange(count) + 1.0) / (count + 1.0)
    apart_ns = np.abs(stamps_ns[:, None] - middles)
    return np.asarray((apart_ns < 0.5e9 * length_s).any(axis=1))
