"""Faults of the numbers themselves: not finite, no rotation, spikes, columns that never change."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.core.types import BoolArray, FloatArray
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.sensors.faults.base import CannotInject, Fault
from slamsim.sensors.faults.edit import require_wheels, with_imus


def _chosen(count: int, share: float, rng: np.random.Generator) -> BoolArray:
    """(count,) so many of them at random, at least one."""
    chosen = rng.random(count) < share
    chosen[count // 2 :][:1] = True
    return np.asarray(chosen)


def _require_odometry(recording: Recording) -> None:
    require_wheels(recording)
    if not recording.odometries:
        raise CannotInject(f"{recording.name} has no odometry")


class OdometryNotFinite(Fault):
    """Single poses of the odometry are not a number."""

    SIZE: ClassVar[str | None] = "share"
    kind: Literal["odometry_not_finite"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        _require_odometry(recording)

        def spoilt(odometry: RawOdometry) -> RawOdometry:
            broken = _chosen(len(odometry), self.share, rng)
            return replace(
                odometry,
                positions_m=np.where(broken[:, None], np.nan, odometry.positions_m),
                linear_m_s=np.where(broken[:, None], np.nan, odometry.linear_m_s),
            )

        return recording.changed(RawOdometry, spoilt)


class OdometryQuaternion(Fault):
    """The odometry's quaternions are not of unit length; of length 0: never filled in."""

    SIZE: ClassVar[str | None] = "length"
    kind: Literal["odometry_quaternion"]
    length: float = Field(ge=0.0, le=1e6)
    """Of all of them."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        _require_odometry(recording)
        return recording.changed(
            RawOdometry, lambda one: replace(one, quats_xyzw=one.quats_xyzw * self.length)
        )


class ImuNotFinite(Fault):
    """Single readings of the inertial unit are not a number."""

    SIZE: ClassVar[str | None] = "share"
    kind: Literal["imu_not_finite"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def spoilt(imu: RawImu) -> RawImu:
            broken = _chosen(len(imu), self.share, rng)[:, None]
            return replace(
                imu,
                angular_velocity_rad_s=np.where(broken, np.nan, imu.angular_velocity_rad_s),
                linear_acceleration_m_s2=np.where(broken, np.nan, imu.linear_acceleration_m_s2),
            )

        return with_imus(recording, spoilt)


class ImuSpikes(Fault):
    """Single accelerations are wild: a bad bus."""

    SIZE: ClassVar[str | None] = "share"
    kind: Literal["imu_spikes"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""
    spike_m_s2: float = Field(default=100.0, gt=0.0, le=1e6)
    """Added along a random axis."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def spoilt(imu: RawImu) -> RawImu:
            felt = imu.linear_acceleration_m_s2.copy()
            rows = np.flatnonzero(_chosen(len(imu), self.share, rng))
            felt[rows, rng.integers(0, 3, rows.size)] += self.spike_m_s2
            return replace(imu, linear_acceleration_m_s2=felt)

        return with_imus(recording, spoilt)


class GyroAxisDead(Fault):
    """One axis of the gyroscope always says the same."""

    kind: Literal["gyro_axis_dead"]
    axis: Literal["x", "y", "z"]
    """Which one."""
    rate_rad_s: float = Field(default=0.0, ge=-1e3, le=1e3)
    """What it says."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def spoilt(imu: RawImu) -> RawImu:
            rates = imu.angular_velocity_rad_s.copy()
            rates[:, "xyz".index(self.axis)] = self.rate_rad_s
            return replace(imu, angular_velocity_rad_s=rates)

        return with_imus(recording, spoilt)


class OrientationInvented(Fault):
    """The unit estimates no orientation, and a constant one is published as if it did."""

    kind: Literal["orientation_invented"]
    w: float = Field(ge=0.0, le=1.0)
    """Of the quaternion, all else of which is 0: 1 is "not turned", 0 is no rotation at all."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def spoilt(imu: RawImu) -> RawImu:
            quats: FloatArray = np.tile([0.0, 0.0, 0.0, self.w], (len(imu), 1))
            return replace(imu, orientation_xyzw=quats)

        return with_imus(recording, spoilt)
