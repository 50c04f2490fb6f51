"""Edits of wheel counters and of the numbers that a driver takes for its wheels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.recording import RawJoints, RawTicks
from slamsim.recording.edits.base import CannotEdit, MessagesEdit, reciprocal

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ScaleWheelNumbers(MessagesEdit):
    """The declared radius of the wheels, and the distance between them, times a factor each."""

    radius_factor: float = 1.0
    track_factor: float = 1.0

    def changed(self, ticks: RawTicks) -> RawTicks:
        return replace(
            ticks,
            wheel_radius_m=ticks.wheel_radius_m * self.radius_factor,
            track_m=ticks.track_m * self.track_factor,
        )

    def inverse(self) -> ScaleWheelNumbers:
        radius, track = reciprocal(self.radius_factor), reciprocal(self.track_factor)
        return replace(self, radius_factor=radius, track_factor=track)


@dataclass(frozen=True, slots=True)
class RewireWheels(MessagesEdit):
    """Counters connected otherwise, and the two joints of a robot that has no more.

    order: which of the old (left, right) each new one is; signs: which way it counts, 0 if not.
    """

    order: Pair = (0, 1)
    signs: Pair = (1, 1)

    def changed(self, wheels: RawTicks | RawJoints) -> RawTicks | RawJoints:
        order, signs = list(self.order), np.array(self.signs)
        if isinstance(wheels, RawTicks):
            return replace(wheels, ticks=wheels.ticks[:, order] * signs)
        if wheels.positions_rad.shape[1] != len(order):
            return wheels
        return replace(
            wheels,
            positions_rad=wheels.positions_rad[:, order] * signs,
            velocities_rad_s=wheels.velocities_rad_s[:, order] * signs,
        )

    def inverse(self) -> RewireWheels:
        if 0 in self.signs:
            raise CannotEdit("the counts of a dead wheel cannot be brought back")
        left, right = (self.signs[i] for i in self.order)
        return replace(self, signs=(left, right))


@dataclass(frozen=True, slots=True)
class WrapTicks(MessagesEdit):
    """Counters of so many values (``modulus``), centred on zero, that begin anew."""

    modulus: int

    def changed(self, ticks: RawTicks) -> RawTicks:
        half = self.modulus // 2
        return replace(ticks, ticks=(ticks.ticks + half) % self.modulus - half)

    def inverse(self) -> UnwrapTicks:
        """Right but for whole turns of the counter before the first message."""
        return UnwrapTicks(self.target, self.modulus)


@dataclass(frozen=True, slots=True)
class UnwrapTicks(MessagesEdit):
    """Counting on where a counter of so many values (``modulus``) begins anew."""

    modulus: int

    def changed(self, ticks: RawTicks) -> RawTicks:
        steps = np.diff(ticks.ticks, axis=0)
        steps -= np.rint(steps / self.modulus).astype(np.int64) * self.modulus
        counts = np.concatenate([ticks.ticks[:1], ticks.ticks[:1] + np.cumsum(steps, axis=0)])
        return replace(ticks, ticks=counts)
