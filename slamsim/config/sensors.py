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
from slamsim.config.kinds import AdditionalSensors
from slamsim.config.lidar import LidarConfig
from slamsim.config.streams import StreamConfig

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


TRUTH_NAMES = frozenset(("ground_truth", "groundtruth"))
"""Below which names simulators publish the truth, which no reader takes for a measurement."""


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
    additional: AdditionalSensors = Field(default=(), strict=False)
    """More sensors, each an entry of its own: type, name, mount and what its type has."""

    @model_validator(mode="after")
    def _named_apart(self) -> Self:
        names = [entry.name for entry in self.additional]
        if taken := next((name for name in names if name in TRUTH_NAMES), None):
            raise ValueError(f"{taken!r} is the name of the truth; readers would skip the sensor")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"two additional sensors are named {twice!r}")
        self._topics_apart()
        return self

    def _topics_apart(self) -> None:
        """Frames and tables of data sets are named by topics without slashes: ``/front/left_color``
        and ``/front_left/color`` would be one."""
        owners: dict[str, str] = {}
        for entry in self.additional if len(self.additional) > 1 else ():
            for topic in entry.topics:
                other = owners.setdefault(topic.replace("/", "_"), entry.name)
                if other != entry.name:
                    raise ValueError(
                        f"{other!r} and {entry.name!r} both have what is called {topic} with '_' "
                        "for '/', as frames and tables are; rename one"
                    )
