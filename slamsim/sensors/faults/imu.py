"""Faults of the inertial unit: scale, sign, unit, bias, mounting, gravity, stuck readings."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.core.geometry import matrix_from_rpy
from slamsim.core.types import GRAVITY_M_S2
from slamsim.recording import RawImu, Recording
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.edit import with_imus

_Degrees = Annotated[float, Field(ge=-180.0, le=180.0)]


class GyroScale(Fault):
    """The gyroscope reads too much or too little; -1 turns the wrong way."""

    SIZE: ClassVar[str | None] = "factor"
    kind: Literal["gyro_scale"]
    factor: float = Field(ge=-1000.0, le=1000.0)
    """Read over true, on all axes."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return with_imus(
            recording,
            lambda imu: replace(
                imu, angular_velocity_rad_s=imu.angular_velocity_rad_s * self.factor
            ),
        )


class GyroBias(Fault):
    """The gyroscope turns while the robot stands."""

    SIZE: ClassVar[str | None] = "bias_rad_s"
    kind: Literal["gyro_bias"]
    bias_rad_s: float = Field(ge=-100.0, le=100.0)
    """On the axis of yaw, on top of what it has."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        bias = np.array([0.0, 0.0, self.bias_rad_s])
        return with_imus(
            recording,
            lambda imu: replace(imu, angular_velocity_rad_s=imu.angular_velocity_rad_s + bias),
        )


class ImuMount(Fault):
    """The unit is mounted otherwise than its frame says."""

    kind: Literal["imu_mount"]
    rpy_deg: Annotated[tuple[_Degrees, _Degrees, _Degrees], Field(strict=False)]
    """How the unit is turned against its frame: about fixed x, then y, then z."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        R_frame_unit = matrix_from_rpy(*np.radians(self.rpy_deg))
        return with_imus(
            recording,
            lambda imu: replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s @ R_frame_unit,
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2 @ R_frame_unit,
            ),
        )


class GravityMissing(Fault):
    """Gravity has been taken out of the accelerations."""

    kind: Literal["gravity_missing"]

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        gravity = np.array([0.0, 0.0, GRAVITY_M_S2])
        return with_imus(
            recording,
            lambda imu: replace(
                imu, linear_acceleration_m_s2=imu.linear_acceleration_m_s2 - gravity
            ),
        )


class AccelerationScale(Fault):
    """Accelerations are in another unit."""

    SIZE: ClassVar[str | None] = "unit_m_s2"
    kind: Literal["acceleration_unit"]
    unit_m_s2: float = Field(gt=0.0, le=1000.0)
    """What the unit's 1 stands for: 9.80665 are multiples of g."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return with_imus(
            recording,
            lambda imu: replace(
                imu, linear_acceleration_m_s2=imu.linear_acceleration_m_s2 / self.unit_m_s2
            ),
        )


class ImuStuck(Fault):
    """The unit is read faster than it measures: readings come several times."""

    SIZE: ClassVar[str | None] = "times"
    kind: Literal["imu_stuck"]
    times: int = Field(ge=1, le=1_000_000)
    """How often each reading comes; more than there are messages: it never changes."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def held(imu: RawImu) -> RawImu:
            source = np.arange(len(imu)) // self.times * self.times
            return replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s[source],
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2[source],
            )

        return with_imus(recording, held)
