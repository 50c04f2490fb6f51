"""Edits of the readings of an inertial unit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.recording import RawImu
from slamsim.recording.edits.base import MessagesEdit, reciprocal

Quantity = Literal["angular_velocity_rad_s", "linear_acceleration_m_s2"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ScaleReadings(MessagesEdit):
    """Readings of the gyroscope or of the accelerometer times ``factor``, divided by ``over``.

    Two numbers, so that a unit is taken back by the very number by which it was changed.
    """

    quantity: Quantity
    factor: float = 1.0
    over: float = 1.0

    def changed(self, imu: RawImu) -> RawImu:
        return _with(imu, self.quantity, getattr(imu, self.quantity) * self.factor / self.over)

    def inverse(self) -> ScaleReadings:
        reciprocal(self.factor)
        return replace(self, factor=self.over, over=self.factor)


@dataclass(frozen=True, slots=True)
class OffsetReadings(MessagesEdit):
    """A constant vector added to all readings, in the unit's frame: a bias, or gravity."""

    quantity: Quantity
    offset: Vector

    def changed(self, imu: RawImu) -> RawImu:
        return _with(imu, self.quantity, getattr(imu, self.quantity) + np.array(self.offset))

    def inverse(self) -> OffsetReadings:
        x, y, z = self.offset
        return replace(self, offset=(-x, -y, -z))


@dataclass(frozen=True, slots=True, eq=False)
class RotateReadings(MessagesEdit):
    """Both vectors of each reading turned by the rotation ``R_new_old`` (3, 3)."""

    R_new_old: FloatArray

    def changed(self, imu: RawImu) -> RawImu:
        return replace(
            imu,
            angular_velocity_rad_s=imu.angular_velocity_rad_s @ self.R_new_old.T,
            linear_acceleration_m_s2=imu.linear_acceleration_m_s2 @ self.R_new_old.T,
        )

    def inverse(self) -> RotateReadings:
        return replace(self, R_new_old=self.R_new_old.T)


@dataclass(frozen=True, slots=True)
class HoldReadings(MessagesEdit):
    """Each reading comes ``times`` times in the place of those that follow it."""

    times: int

    def changed(self, imu: RawImu) -> RawImu:
        source = np.arange(len(imu)) // self.times * self.times
        return replace(
            imu,
            angular_velocity_rad_s=imu.angular_velocity_rad_s[source],
            linear_acceleration_m_s2=imu.linear_acceleration_m_s2[source],
        )


@dataclass(frozen=True, slots=True)
class SetOrientation(MessagesEdit):
    """One quaternion (x, y, z, w) as the orientation of every reading; None: none is estimated."""

    quat_xyzw: tuple[float, float, float, float] | None

    def changed(self, imu: RawImu) -> RawImu:
        quat = self.quat_xyzw
        quats_xyzw = None if quat is None else np.tile(quat, (len(imu), 1))
        return replace(imu, orientation_xyzw=quats_xyzw)


def _with(imu: RawImu, quantity: Quantity, values: FloatArray) -> RawImu:
    if quantity == "angular_velocity_rad_s":
        return replace(imu, angular_velocity_rad_s=values)
    return replace(imu, linear_acceleration_m_s2=values)
