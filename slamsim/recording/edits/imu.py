"""Edits of the readings of an inertial unit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, Recording
from slamsim.recording.edits.base import Edit, Target, reciprocal

Quantity = Literal["angular_velocity_rad_s", "linear_acceleration_m_s2"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ScaleReadings(Edit):
    """Readings of the gyroscope or of the accelerometer times ``factor``, divided by ``over``.

    Two numbers, so that a unit is taken back by the very number by which it was changed.
    """

    target: Target
    quantity: Quantity
    factor: float = 1.0
    over: float = 1.0

    def apply(self, recording: Recording) -> Recording:
        def scaled(imu: RawImu) -> RawImu:
            return _with(imu, self.quantity, getattr(imu, self.quantity) * self.factor / self.over)

        return self.target.changed(recording, scaled)

    def inverse(self) -> ScaleReadings:
        reciprocal(self.factor)
        return replace(self, factor=self.over, over=self.factor)


@dataclass(frozen=True, slots=True)
class OffsetReadings(Edit):
    """A constant vector added to all readings, in the unit's frame: a bias, or gravity."""

    target: Target
    quantity: Quantity
    offset: Vector

    def apply(self, recording: Recording) -> Recording:
        offset = np.array(self.offset)

        def added(imu: RawImu) -> RawImu:
            return _with(imu, self.quantity, getattr(imu, self.quantity) + offset)

        return self.target.changed(recording, added)

    def inverse(self) -> OffsetReadings:
        x, y, z = self.offset
        return replace(self, offset=(-x, -y, -z))


@dataclass(frozen=True, slots=True, eq=False)
class RotateReadings(Edit):
    """Both vectors of each reading turned by the rotation ``R_new_old`` (3, 3)."""

    target: Target
    R_new_old: FloatArray

    def apply(self, recording: Recording) -> Recording:
        def rotated(imu: RawImu) -> RawImu:
            return replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s @ self.R_new_old.T,
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2 @ self.R_new_old.T,
            )

        return self.target.changed(recording, rotated)

    def inverse(self) -> RotateReadings:
        return replace(self, R_new_old=self.R_new_old.T)


@dataclass(frozen=True, slots=True)
class HoldReadings(Edit):
    """Each reading comes ``times`` times in the place of those that follow it."""

    target: Target
    times: int

    def apply(self, recording: Recording) -> Recording:
        def held(imu: RawImu) -> RawImu:
            source = np.arange(len(imu)) // self.times * self.times
            return replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s[source],
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2[source],
            )

        return self.target.changed(recording, held)


@dataclass(frozen=True, slots=True)
class SetOrientation(Edit):
    """One quaternion (x, y, z, w) as the orientation of every reading; None: none is estimated."""

    target: Target
    quat_xyzw: tuple[float, float, float, float] | None

    def apply(self, recording: Recording) -> Recording:
        def oriented(imu: RawImu) -> RawImu:
            quat = self.quat_xyzw
            return replace(
                imu, orientation_xyzw=None if quat is None else np.tile(quat, (len(imu), 1))
            )

        return self.target.changed(recording, oriented)


def _with(imu: RawImu, quantity: Quantity, values: FloatArray) -> RawImu:
    if quantity == "angular_velocity_rad_s":
        return replace(imu, angular_velocity_rad_s=values)
    return replace(imu, linear_acceleration_m_s2=values)
