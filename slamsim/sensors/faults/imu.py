"""Faults of the inertial unit: scale, sign, unit, bias, mounting, gravity, invalid readings."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.core.geometry import matrix_from_rpy
from slamsim.core.types import GRAVITY_M_S2
from slamsim.recording import RawImu, Recording
from slamsim.recording.edits.base import IMUS, Edit
from slamsim.recording.edits.imu import (
    HoldReadings,
    OffsetReadings,
    RotateReadings,
    ScaleReadings,
    SetOrientation,
)
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.sensors.faults.base import Fault, some_of, spells

_Degrees = Annotated[float, Field(ge=-180.0, le=180.0)]


class GyroScale(Fault):
    """The gyroscope reads too much or too little; -1 turns the wrong way."""

    kind: Literal["gyro_scale"]
    factor: float = Field(ge=-1000.0, le=1000.0)
    """Read over true, on all axes."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleReadings(IMUS, "angular_velocity_rad_s", self.factor)


class GyroBias(Fault):
    """The gyroscope turns while the robot stands."""

    kind: Literal["gyro_bias"]
    bias_rad_s: float = Field(ge=-100.0, le=100.0)
    """On the axis of yaw, on top of what it has."""
    begins_share: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Part of the messages that come before it."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        bias_rad_s = np.array([0.0, 0.0, self.bias_rad_s])
        if self.begins_share == 0.0:
            return OffsetReadings(IMUS, "angular_velocity_rad_s", tuple(bias_rad_s.tolist()))

        def later(imu: RawImu) -> RawImu:
            rates = imu.angular_velocity_rad_s.copy()
            rates[round(self.begins_share * len(imu)) :] += bias_rad_s
            return replace(imu, angular_velocity_rad_s=rates)

        return ChangeMessages(IMUS, later)


class ImuMount(Fault):
    """The unit is mounted otherwise than its frame says."""

    kind: Literal["imu_mount"]
    rpy_deg: Annotated[tuple[_Degrees, _Degrees, _Degrees], Field(strict=False)]
    """How the unit is turned against its frame: about fixed x, then y, then z."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        R_frame_unit = matrix_from_rpy(*np.radians(self.rpy_deg))
        return RotateReadings(IMUS, R_frame_unit.T)


class GravityMissing(Fault):
    """Gravity has been taken out of the accelerations."""

    kind: Literal["gravity_missing"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return OffsetReadings(IMUS, "linear_acceleration_m_s2", (-0.0, -0.0, -GRAVITY_M_S2))


class AccelerationScale(Fault):
    """Accelerations are in another unit."""

    kind: Literal["acceleration_unit"]
    unit_m_s2: float = Field(gt=0.0, le=1000.0)
    """What the unit's 1 stands for: 9.80665 are multiples of g."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleReadings(IMUS, "linear_acceleration_m_s2", over=self.unit_m_s2)


class ImuStuck(Fault):
    """The unit is read faster than it measures: readings come several times."""

    kind: Literal["imu_stuck"]
    times: int = Field(ge=1, le=1_000_000)
    """How often each reading comes; more than there are messages: it never changes."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return HoldReadings(IMUS, self.times)


class ImuHangs(Fault):
    """One reading is published again and again, for a while at a time."""

    kind: Literal["imu_hangs"]
    hangs_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=2, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def hanging(imu: RawImu) -> RawImu:
            hangs = spells(imu.stamps_ns, self.times, self.hangs_s)
            source = np.maximum.accumulate(np.where(hangs, 0, np.arange(len(imu))))
            return replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s[source],
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2[source],
            )

        return ChangeMessages(IMUS, hanging)


class ImuNotFinite(Fault):
    """Single readings of the inertial unit are not a number."""

    kind: Literal["imu_not_finite"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def broken(imu: RawImu) -> RawImu:
            chosen = some_of(len(imu), self.share, rng)[:, None]
            return replace(
                imu,
                angular_velocity_rad_s=np.where(chosen, np.nan, imu.angular_velocity_rad_s),
                linear_acceleration_m_s2=np.where(chosen, np.nan, imu.linear_acceleration_m_s2),
            )

        return ChangeMessages(IMUS, broken)


class ImuSpikes(Fault):
    """Single accelerations are wild: a bad bus."""

    kind: Literal["imu_spikes"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""
    spike_m_s2: float = Field(default=100.0, gt=0.0, le=1e6)
    """Added along a random axis."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def with_spikes(imu: RawImu) -> RawImu:
            felt = imu.linear_acceleration_m_s2.copy()
            rows = np.flatnonzero(some_of(len(imu), self.share, rng))
            felt[rows, rng.integers(0, 3, rows.size)] += self.spike_m_s2
            return replace(imu, linear_acceleration_m_s2=felt)

        return ChangeMessages(IMUS, with_spikes)


class GyroAxisDead(Fault):
    """One axis of the gyroscope always says the same."""

    SIZE: ClassVar[str | None] = None
    kind: Literal["gyro_axis_dead"]
    axis: Literal["x", "y", "z"]
    """Which one."""
    rate_rad_s: float = Field(default=0.0, ge=-1e3, le=1e3)
    """What it says."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def dead(imu: RawImu) -> RawImu:
            rates = imu.angular_velocity_rad_s.copy()
            rates[:, "xyz".index(self.axis)] = self.rate_rad_s
            return replace(imu, angular_velocity_rad_s=rates)

        return ChangeMessages(IMUS, dead)


class GyroSaturated(Fault):
    """The gyroscope's range ends below the rates at which the robot turns."""

    kind: Literal["gyro_saturated"]
    range_rad_s: float = Field(gt=0.0, le=1e3)
    """The largest rate that it gives, about any axis."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def cut_off(imu: RawImu) -> RawImu:
            rates = np.clip(imu.angular_velocity_rad_s, -self.range_rad_s, self.range_rad_s)
            return replace(imu, angular_velocity_rad_s=rates)

        return ChangeMessages(IMUS, cut_off)


class OrientationInvented(Fault):
    """The unit estimates no orientation, and a constant one is published as if it did."""

    SIZE: ClassVar[str | None] = None
    kind: Literal["orientation_invented"]
    w: float = Field(ge=0.0, le=1.0)
    """Of the quaternion, all else of which is 0: 1 is "not turned", 0 is no rotation at all."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return SetOrientation(IMUS, (0.0, 0.0, 0.0, self.w))
