"""What every sensor's stream has; what entries in the lists of further sensors and sinks say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.robot import MountConfig


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


class SensorEntry(StreamConfig, ABC):
    """One sensor more; its class is the model of its kind, with ``type`` as a literal.

    Its topics begin with its name, its frame is ``NAME_link``.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]{0,40}$")
    """Of this very sensor: small letters, digits and underscores."""
    mount: MountConfig
    """Where it sits on the robot."""

    @property
    def frame(self) -> str:
        return f"{self.name}_link"

    @property
    def frames(self) -> tuple[Any, ...]:
        """Frames that hang on its own, each a ``slamsim.core.geometry.StaticTransform``."""
        return ()

    @property
    def custom_data(self) -> Mapping[str, str]:
        """What the recording says of it besides messages."""
        return {}

    @property
    @abstractmethod
    def topics(self) -> Mapping[str, str]:
        """The ROS type of the messages of each of its topics."""

    @abstractmethod
    def build(self, site: Any) -> Any:
        """The sensor that samples at a ``slamsim.sensors.base.Site``."""


class SinkEntry(Config, ABC):
    """One sink; its class is the model of its kind, with ``type`` as a literal."""

    @abstractmethod
    def start(self, topics: Any) -> Any:
        """A ``slamsim.simulation.log_writer.Sink`` for messages on these topics."""
