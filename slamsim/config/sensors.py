"""What the robot senses: lidar, inertial unit, wheel encoders, each on its own clock.

Where a sensor sits on the robot is part of the robot (``config/robot.py``). The defaults are a
Hokuyo UTM-30LX (configs/sensors/utm_30lx.yaml says where its numbers come from), an ADIS16448
inertial unit with the noise figures published with the EuRoC data set (Burri et al. 2016), and
the encoders of a Kobuki base (2578.33 ticks per wheel turn in its protocol, here rounded).
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from slamsim.config.base import Config

PerAxis = Annotated[
    tuple[
        Annotated[float, Field(ge=-0.5, le=0.5)],
        Annotated[float, Field(ge=-0.5, le=0.5)],
        Annotated[float, Field(ge=-0.5, le=0.5)],
    ],
    Field(strict=False),
]
PerWheel = Annotated[
    tuple[
        Annotated[float, Field(ge=-0.5, le=0.5)],
        Annotated[float, Field(ge=-0.5, le=0.5)],
    ],
    Field(strict=False),
]


class ClockConfig(Config):
    """How a stream's stamps differ from true time, and how late its messages arrive."""

    offset_s: float = Field(default=0.0, ge=-1e6, le=1e6)
    """Stamp minus true time at the start of the drive."""
    drift_ppm: float = Field(default=0.0, ge=-10_000.0, le=10_000.0)
    """By how much the clock runs too fast, in microseconds per second."""
    jitter_s: float = Field(default=0.0, ge=0.0, le=10.0)
    """Standard deviation of each stamp about its clock."""
    latency_s: float = Field(default=0.0, ge=0.0, le=10.0)
    """From the end of an acquisition to the arrival of its message, at least."""
    latency_jitter_s: float = Field(default=0.0, ge=0.0, le=10.0)
    """Mean of the exponentially distributed delay on top; messages never overtake each other."""
    drop_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of messages that never arrive."""


class StreamConfig(Config):
    """What every stream has: whether it exists, how often it samples, and its clock."""

    enabled: bool = True
    """False leaves the sensor out of the log."""
    rate_hz: float = Field(default=50.0, gt=0.01, le=100_000.0)
    """Samples per second, free of the physics rate."""
    phase_s: float = Field(default=0.0, ge=0.0, le=1000.0)
    """True time of the first sample after the start of the drive."""
    clock: ClockConfig = ClockConfig()
    """Errors of the stream's stamps and arrival times."""


class RangeNoiseConfig(Config):
    """Normal noise on each range; the three parts add as variances."""

    constant_m: float = Field(default=0.008, ge=0.0, le=1.0)
    """Standard deviation that every return has."""
    proportional: float = Field(default=0.0006, ge=0.0, le=0.5)
    """Standard deviation as a share of the range."""
    spot_mrad: float = Field(default=0.5, ge=0.0, le=50.0)
    """Spread of the light within the beam (a quarter of its width if the spot is round): on a
    slanted wall it gives a standard deviation of range x this x tan(incidence)."""


class DropoutConfig(Config):
    """Chance that a beam on a surface gives no return: the three parts add up, at most 1."""

    probability: float = Field(default=0.001, ge=0.0, le=1.0)
    """For every beam."""
    at_max_range: float = Field(default=0.02, ge=0.0, le=1.0)
    """More with distance: this x (range / maximum range) squared."""
    at_grazing: float = Field(default=0.02, ge=0.0, le=1.0)
    """More with slant: this x (1 - cos(incidence))."""


class MixedReturnsConfig(Config):
    """Beams that straddle an edge and see two surfaces (mixed pixels)."""

    divergence_mrad: float = Field(default=2.0, ge=0.0, le=50.0)
    """Full width of the beam in the scan plane; 0 makes beams infinitely thin: no mixing."""
    probability: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of straddling beams that report a mixture; the others report the stronger surface."""
    min_gap_m: float = Field(default=0.05, gt=0.0, le=10.0)
    """Surfaces closer together along the beam than this are one."""
    max_gap_m: float = Field(default=1.5, gt=0.0, le=1000.0)
    """Surfaces further apart than this never mix: half the length of the light pulse."""


class LidarConfig(StreamConfig):
    """A rotating 2-D lidar; its beams fire one after the other, counter-clockwise from above."""

    rate_hz: float = Field(default=40.0, gt=0.01, le=1000.0)
    """Turns and scans per second."""
    rolling: bool = True
    """False fires all beams of a scan at once, at its stamp."""
    angle_min_deg: float = Field(default=-135.0, ge=-360.0, le=360.0)
    """Direction of beam 0 in the laser frame."""
    angle_step_deg: float = Field(default=0.25, gt=0.001, le=90.0)
    """From each beam to the next; with rate_hz it gives the time between them."""
    beam_count: int = Field(default=1081, ge=1, le=100_000)
    """Beams in a scan."""
    range_min_m: float = Field(default=0.1, ge=0.0, le=10.0)
    """Closer readings are invalid (nan)."""
    range_max_m: float = Field(default=30.0, gt=0.0, le=1000.0)
    """Further readings are no return (inf)."""
    resolution_m: float = Field(default=0.001, ge=0.0, le=1.0)
    """Readings are whole multiples of this; 0 leaves them as they are."""
    max_incidence_deg: float = Field(default=88.0, gt=0.0, le=90.0)
    """Surfaces that slant away further than this from facing the beam give no return."""
    noise: RangeNoiseConfig = RangeNoiseConfig()
    """Noise of the ranges."""
    dropout: DropoutConfig = DropoutConfig()
    """Returns that get lost."""
    mixed: MixedReturnsConfig = MixedReturnsConfig()
    """What happens at edges."""
    intensities: bool = False
    """Record the strength of each return: cos(incidence) / max(range, 1 m) squared."""

    @property
    def beam_dt_ns(self) -> int:
        """Time from each beam to the next: the share of a turn between them."""
        turn_ns = 1e9 / self.rate_hz
        return round(turn_ns * self.angle_step_deg / 360.0) if self.rolling else 0

    @model_validator(mode="after")
    def _fits_into_a_turn(self) -> Self:
        if self.range_max_m <= self.range_min_m:
            raise ValueError(
                f"range_max_m ({self.range_max_m:g}) must exceed range_min_m ({self.range_min_m:g})"
            )
        swept = self.beam_count * self.angle_step_deg
        if swept > 360.0 + 1e-6 * self.angle_step_deg:
            raise ValueError(
                f"{self.beam_count} beams of {self.angle_step_deg:g} deg sweep {swept:g} deg, "
                f"but a turn has 360: at most {int(360.0 / self.angle_step_deg + 1e-6)} beams fit"
            )
        return self


class InertialAxesConfig(Config):
    """Errors of a triad of gyroscopes (unit: rad/s) or accelerometers (unit: m/s^2)."""

    noise_density: float = Field(ge=0.0, le=10.0)
    """White noise, in unit/sqrt(Hz); a sample gets this x sqrt(rate)."""
    bias_random_walk: float = Field(ge=0.0, le=10.0)
    """Diffusion of the bias, in unit/s/sqrt(Hz); a step adds this x sqrt(1 / rate)."""
    turn_on_bias: float = Field(ge=0.0, le=10.0)
    """Standard deviation of the bias at the start, drawn once for each axis, in unit."""
    scale_error: PerAxis = (0.0, 0.0, 0.0)
    """Relative error of each axis: 0.01 reads one per cent too much."""
    saturation: float = Field(gt=0.0, le=1e6)
    """Readings stop at plus and minus this, in unit."""
    resolution: float = Field(ge=0.0, le=10.0)
    """Readings are whole multiples of this; 0 leaves them as they are."""


class GyroConfig(InertialAxesConfig):
    """Errors of the three gyroscopes, in rad/s."""

    noise_density: float = Field(default=1.6968e-4, ge=0.0, le=10.0)
    """White noise, in rad/s/sqrt(Hz); a sample gets this x sqrt(rate)."""
    bias_random_walk: float = Field(default=1.9393e-5, ge=0.0, le=10.0)
    """Diffusion of the bias, in rad/s^2/sqrt(Hz); a step adds this x sqrt(1 / rate)."""
    turn_on_bias: float = Field(default=2.0e-3, ge=0.0, le=10.0)
    """Standard deviation of the bias at the start, drawn once for each axis, in rad/s."""
    saturation: float = Field(default=17.45, gt=0.0, le=1e6)
    """Readings stop at plus and minus this, in rad/s."""
    resolution: float = Field(default=0.0, ge=0.0, le=10.0)
    """Readings are whole multiples of this, in rad/s; 0 leaves them as they are."""


class AccelerometerConfig(InertialAxesConfig):
    """Errors of the three accelerometers, in m/s^2."""

    noise_density: float = Field(default=2.0e-3, ge=0.0, le=10.0)
    """White noise, in m/s^2/sqrt(Hz); a sample gets this x sqrt(rate)."""
    bias_random_walk: float = Field(default=3.0e-3, ge=0.0, le=10.0)
    """Diffusion of the bias, in m/s^3/sqrt(Hz); a step adds this x sqrt(1 / rate)."""
    turn_on_bias: float = Field(default=0.05, ge=0.0, le=10.0)
    """Standard deviation of the bias at the start, drawn once for each axis, in m/s^2."""
    saturation: float = Field(default=176.0, gt=0.0, le=1e6)
    """Readings stop at plus and minus this, in m/s^2."""
    resolution: float = Field(default=0.0, ge=0.0, le=10.0)
    """Readings are whole multiples of this, in m/s^2; 0 leaves them as they are."""


class ImuConfig(StreamConfig):
    """Gyroscopes and accelerometers; each sample is the mean over one period about its stamp."""

    rate_hz: float = Field(default=200.0, gt=0.01, le=100_000.0)
    """Samples per second, free of the physics rate."""
    gyro: GyroConfig = GyroConfig()
    """Errors of the gyroscopes."""
    accelerometer: AccelerometerConfig = AccelerometerConfig()
    """Errors of the accelerometers."""


class EncoderConfig(StreamConfig):
    """Counters on the two drive wheels, and what a driver believes of the wheels."""

    rate_hz: float = Field(default=50.0, gt=0.01, le=100_000.0)
    """Readings per second, free of the physics rate."""
    ticks_per_revolution: int = Field(default=2578, ge=1, le=10_000_000)
    """Counts in one turn of a wheel."""
    tick_noise: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Standard deviation of a reading about the true angle, in ticks; it does not add up."""
    missed_tick_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of ticks that are never counted, on either wheel; it does add up."""
    wheel_scale_error: PerWheel = (0.0005, -0.0005)
    """Relative error of the counted angle, left and right: unequal or worn wheels. The default is
    what a careful calibration leaves (Borenstein & Feng 1996)."""
    wheel_radius_error: float = Field(default=0.002, gt=-0.9, le=10.0)
    """Relative error of the radius that the driver believes in."""
    track_error: float = Field(default=0.005, gt=-0.9, le=10.0)
    """Relative error of the track that the driver believes in."""


class SensorsConfig(Config):
    """All sensors of the robot."""

    lidar: LidarConfig = LidarConfig()
    """The 2-D lidar."""
    imu: ImuConfig = ImuConfig()
    """The inertial unit."""
    encoders: EncoderConfig = EncoderConfig()
    """The wheel encoders."""
