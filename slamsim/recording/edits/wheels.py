"""Edits of wheel counters and of the numbers that a driver takes for its wheels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.recording import RawJoints, RawTicks, Recording
from slamsim.recording.edits.base import CannotEdit, Edit, Target, reciprocal

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ScaleWheelNumbers(Edit):
    """The declared radius of the wheels, and the distance between them, times a factor each."""

    target: Target
    radius_factor: float = 1.0
    track_factor: float = 1.0

    def apply(self, recording: Recording) -> Recording:
        def scaled(ticks: RawTicks) -> RawTicks:
            return replace(
                ticks,
                wheel_radius_m=ticks.wheel_radius_m * self.radius_factor,
                track_m=ticks.track_m * self.track_factor,
            )

        return self.target.changed(recording, scaled)

    def inverse(self) -> ScaleWheelNumbers:
        radius, track = reciprocal(self.radius_factor), reciprocal(self.track_factor)
        return replace(self, radius_factor=radius, track_factor=track)


@dataclass(frozen=True, slots=True)
class RewireWheels(Edit):
    """Counters and joints connected otherwise.

    order: which of the old (left, right) each new one is; signs: which way it counts, 0 if not.
    """

    target: Target
    order: Pair = (0, 1)
    signs: Pair = (1, 1)

    def apply(self, recording: Recording) -> Recording:
        order, signs = list(self.order), np.array(self.signs)

        def rewired(wheels: RawTicks | RawJoints) -> RawTicks | RawJoints:
            if isinstance(wheels, RawTicks):
                return replace(wheels, ticks=wheels.ticks[:, order] * signs)
            return replace(
                wheels,
                positions_rad=wheels.positions_rad[:, order] * signs,
                velocities_rad_s=wheels.velocities_rad_s[:, order] * signs,
            )

        return self.target.changed(recording, rewired)

    def inverse(self) -> RewireWheels:
        if 0 in self.signs:
            raise CannotEdit("the counts of a dead wheel cannot be brought back")
        left, right = (self.signs[i] for i in self.order)
        return replace(self, signs=(left, right))


@dataclass(frozen=True, slots=True)
class WrapTicks(Edit):
    """Counters of so many values (``modulus``), centred on zero, that begin anew."""

    target: Target
    modulus: int

    def apply(self, recording: Recording) -> Recording:
        half = self.modulus // 2
        return self.target.changed(
            recording, lambda t: replace(t, ticks=(t.ticks + half) % self.modulus - half)
        )

    def inverse(self) -> UnwrapTicks:
        """Right but for whole turns of the counter before the first message."""
        return UnwrapTicks(self.target, self.modulus)


@dataclass(frozen=True, slots=True)
class UnwrapTicks(Edit):
    """Counting on where a counter of so many values (``modulus``) begins anew."""

    target: Target
    modulus: int

    def apply(self, recording: Recording) -> Recording:
        def unwrapped(ticks: RawTicks) -> RawTicks:
            steps = np.diff(ticks.ticks, axis=0)
            steps -= np.rint(steps / self.modulus).astype(np.int64) * self.modulus
            counts = np.concatenate([ticks.ticks[:1], ticks.ticks[:1] + np.cumsum(steps, axis=0)])
            return replace(ticks, ticks=counts)

        return self.target.changed(recording, unwrapped)
