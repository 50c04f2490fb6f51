"""Robots and their sensors by seed, and what may be wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Lidar:
    """beams over fov_deg, rate_hz scans a second; a turn of a mirror takes a period.

    at_once: all beams of a scan fire at one instant. noise: noise_m + noise_share of the range.
    quantum_m: readings are multiples of it. lost: share of the beams that return nothing.
    """

    name: str
    rate_hz: float
    beams: int
    fov_deg: float
    range_max_m: float
    quantum_m: float
    noise_m: float
    noise_share: float
    lost: float
    clockwise: bool = False
    at_once: bool = False
    from_zero: bool = False

    @property
    def step_rad(self) -> float:
        fov_rad = np.deg2rad(self.fov_deg)
        intervals = self.beams if self.fov_deg == 360.0 else self.beams - 1
        return float((-1.0 if self.clockwise else 1.0) * fov_rad / intervals)

    @property
    def first_rad(self) -> float:
        if self.from_zero:
            return 0.0
        return float((0.5 if self.clockwise else -0.5) * np.deg2rad(self.fov_deg))

    @property
    def beam_s(self) -> float:
        """Between two beams."""
        return 0.0 if self.at_once else abs(self.step_rad) / (2.0 * np.pi * self.rate_hz)


LIDARS = (
    Lidar("slow spinner", 5.0, 360, 360.0, 8.0, 0.001, 0.01, 0.004, 0.03, from_zero=True),
    Lidar("cheap spinner", 7.0, 500, 360.0, 10.0, 0.001, 0.008, 0.003, 0.02, clockwise=True),
    Lidar("spinner", 10.0, 720, 360.0, 16.0, 0.004, 0.008, 0.002, 0.01),
    Lidar("fine spinner", 8.0, 1440, 360.0, 30.0, 0.005, 0.01, 0.001, 0.01, clockwise=True),
    Lidar("outdoor scanner", 40.0, 1081, 270.0, 30.0, 0.001, 0.01, 0.001, 0.002),
    Lidar("safety scanner", 15.0, 811, 270.0, 25.0, 0.001, 0.01, 0.002, 0.003),
    Lidar("old scanner", 37.5, 181, 180.0, 8.0, 0.01, 0.008, 0.0, 0.001),
    Lidar("short scanner", 10.0, 683, 240.0, 4.0, 0.001, 0.005, 0.008, 0.01, clockwise=True),
    Lidar("all at once", 20.0, 450, 270.0, 12.0, 0.002, 0.01, 0.002, 0.005, at_once=True),
)


@dataclass(frozen=True)
class Flaws:
    """What is declared, less what is true; lengths in m, angles in rad, shares of the truth.

    knock_*: from the share knock_at of the drive on, the laser sits otherwise by this much, with
    nothing declared anew. late_s: of stamps against the instants of measurement. drift: share by
    which a stream's clock gains. jitter_s: standard deviation of stamps.
    """

    laser_yaw: float = 0.0
    laser_x: float = 0.0
    laser_y: float = 0.0
    knock_yaw: float = 0.0
    knock_x: float = 0.0
    knock_y: float = 0.0
    knock_at: float = 0.5
    angle_step: float = 0.0
    sweep: float = 0.0
    range_scale: float = 0.0
    range_offset: float = 0.0
    radius: float = 0.0
    unequal: float = 0.0
    track: float = 0.0
    lidar_late_s: float = 0.0
    imu_late_s: float = 0.0
    wheels_late_s: float = 0.0
    lidar_drift: float = 0.0
    imu_drift: float = 0.0
    wheels_drift: float = 0.0
    gyro_scale: float = 0.0
    gyro_bias: float = 0.0
    imu_roll: float = 0.0
    imu_pitch: float = 0.0
    imu_yaw: float = 0.0

    def plus(self, **more: float) -> Flaws:
        """With these on top."""
        return replace(self, **{name: getattr(self, name) + by for name, by in more.items()})


@dataclass(frozen=True)
class Robot:
    """laser: x, y, yaw of the true mount. slip: standard deviation of the wheels' paths, in m per
    square root of m. twist: the odometry's own, or the wheels' speeds since the message before."""

    lidar: Lidar
    laser: tuple[float, float, float]
    imu_rpy: tuple[float, float, float]
    imu_xy: tuple[float, float]
    track_m: float
    ticks_per_m: float
    slip: float
    odometry_hz: float
    imu_hz: float
    orientation: bool
    footprint: bool
    jitter_s: float
    flaws: Flaws


def random_robot(rng: np.random.Generator, lidar: Lidar) -> Robot:
    """A robot that its owner calibrated with care: Flaws are what such care leaves."""
    yaw = float(rng.choice([0.0, 0.0, np.pi, -0.5 * np.pi])) if lidar.fov_deg == 360.0 else 0.0
    return Robot(
        lidar=lidar,
        laser=(rng.uniform(-0.1, 0.25), rng.uniform(-0.04, 0.04), yaw),
        imu_rpy=(0.0, 0.0, float(rng.choice([0.0, 0.0, 0.5 * np.pi, np.pi]))),
        imu_xy=(rng.uniform(-0.1, 0.1), rng.uniform(-0.05, 0.05)),
        track_m=rng.uniform(0.25, 0.5),
        ticks_per_m=rng.uniform(3000.0, 20000.0),
        slip=rng.uniform(0.001, 0.003),
        odometry_hz=float(rng.choice([20.0, 30.0, 50.0, 100.0])),
        imu_hz=float(rng.choice([50.0, 100.0, 200.0])),
        orientation=bool(rng.random() < 0.5),
        footprint=bool(rng.random() < 0.5),
        jitter_s=rng.uniform(1e-4, 5e-4),
        flaws=Flaws(
            laser_yaw=np.deg2rad(rng.normal(0.0, 0.04)),
            laser_x=rng.normal(0.0, 0.001),
            laser_y=rng.normal(0.0, 0.001),
            radius=rng.normal(0.0, 0.0008),
            unequal=rng.normal(0.0, 0.0008),
            track=rng.normal(0.0, 0.0015),
            range_offset=rng.normal(0.0, 0.003),
            gyro_scale=rng.normal(0.0, 0.001),
            gyro_bias=rng.normal(0.0, 0.001),
        ),
    )
