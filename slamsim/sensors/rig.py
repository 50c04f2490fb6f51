"""Runs all sensors of a robot: from windows of true motion to readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slamsim.cameras.appearance import Appearance
from slamsim.config.sensors import EncoderConfig, SensorsConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import Drive, EncoderStream, FloatArray, IntArray, TriangleMesh
from slamsim.sensors.base import Batch, Sensor, Site
from slamsim.sensors.clock import StreamClock
from slamsim.sensors.imu import Imu
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import Motion, PoseOverride, as_mounted, joined, kept_since
from slamsim.sensors.readings import EncoderBatch, ImuBatch, Readings, ScanBatch


class Carrier(Protocol):
    """What sensing must know of a robot: where its sensors sit and how its wheels are."""

    @property
    def T_base_laser(self) -> FloatArray: ...  # noqa: N802

    @property
    def T_base_imu(self) -> FloatArray: ...  # noqa: N802

    @property
    def wheel_radius_m(self) -> float: ...

    @property
    def track_m(self) -> float: ...


class SensorRig:
    """The sensors of one robot during one drive.

    Call ``sense`` with one window of the drive after the other. Readings depend on the mesh, the
    robot, the configuration, the seed and the whole motion, and are the same bytes however the
    drive is cut into windows and on however many ``threads``. What is carried from window to
    window is the tail of the motion that open samples still need, the number of the next sample
    of each stream, the biases, and one generator for each random effect. override, with_truth: as
    for Lidar. appearance: how the world looks to cameras; without it, plain grey.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        robot: Carrier,
        config: SensorsConfig,
        seed: int,
        threads: int = 1,
        override: PoseOverride = as_mounted,
        with_truth: bool = False,
        appearance: Callable[[], Appearance] | None = None,
    ) -> None:
        self._mesh, self._robot, self._config = mesh, robot, config
        self._seed, self._threads, self._override = seed, threads, override
        self._with_truth, self._appearance = with_truth, appearance
        self._motion: Motion | None = None
        self._sensors: _Sensors | None = None

    def sense(self, window: Drive) -> Readings:
        """Every sample whose whole acquisition is now covered and that was not given before.

        window: the next part of the drive, at least two steps in the first; its first stamp is
        the start of the streams. Raises BadNumbers if it does not follow on.
        """
        motion = joined(self._motion, window)
        if self._sensors is None:
            self._sensors = self._switched_on(int(window.stamps_ns[0]))
        scans, imu, encoders, additional = self._sensors.sense(motion)
        self._motion = kept_since(motion, self._sensors.needed_ns)
        return Readings(scans, imu, encoders, additional)

    def _switched_on(self, start_ns: int) -> _Sensors:
        robot, config, seed = self._robot, self._config, self._seed
        site = Site(self._mesh, seed, start_ns, self._threads, self._appearance)
        return _Sensors(
            Lidar(config.lidar, robot.T_base_laser, site, self._override, self._with_truth),
            Imu(config.imu, robot.T_base_imu, seed, start_ns),
            Encoders(config.encoders, robot.wheel_radius_m, robot.track_m, seed, start_ns),
            tuple(entry.build(site) for entry in config.additional if entry.enabled),
        )


@dataclass(frozen=True, slots=True)
class _Sensors:
    lidar: Lidar
    imu: Imu
    encoders: Encoders
    additional: tuple[Sensor, ...]

    @property
    def needed_ns(self) -> int:
        own = self.lidar.needed_ns, self.imu.needed_ns, self.encoders.needed_ns
        return min(*own, *(sensor.needed_ns for sensor in self.additional))

    def sense(self, motion: Motion) -> tuple[ScanBatch, ImuBatch, EncoderBatch, tuple[Batch, ...]]:
        scans, imu = self.lidar.sense(motion), self.imu.sense(motion)
        further = tuple(sensor.sense(motion) for sensor in self.additional)
        return scans, imu, self.encoders.sense(motion), further


class Encoders:
    """Counts of both wheels, and the wheel radius and track that a driver would use.

    A count is the wheel's true angle, rounded down to whole ticks. wheel_radius_m, track_m: the
    robot's true values; the stream carries them with the configured errors.
    """

    def __init__(
        self, config: EncoderConfig, wheel_radius_m: float, track_m: float, seed: int, start_ns: int
    ) -> None:
        self._config = config
        self._wheel_radius_m = wheel_radius_m * (1.0 + config.wheel_radius_error)
        self._track_m = track_m * (1.0 + config.track_error)
        self._clock = StreamClock(config, start_ns, seed, "encoders")
        self._noise = random_stream(seed, "encoders", "noise")
        self._missing = random_stream(seed, "encoders", "missed")
        self._next = 0
        self._last_count: IntArray | None = None
        self._missed: IntArray = np.zeros(2, dtype=np.int64)

    @property
    def needed_ns(self) -> int:
        """The earliest instant that later readings look at."""
        return self._clock.needed_ns(self._next)

    def sense(self, motion: Motion) -> EncoderBatch:
        """All readings that the motion covers and that were not given yet."""
        samples = self._clock.samples_until(self._next, motion.covered_ns)
        self._next += samples.size
        true_ns = self._clock.instants_ns(samples)
        angles_rad = motion.wheel_angles_at(true_ns)
        ticks = self._count(angles_rad)
        stamps_ns = self._clock.stamps_ns(true_ns)
        arrival_ns = self._clock.arrivals_ns(true_ns)
        there = self._clock.arrived(true_ns.size)
        stream = EncoderStream(
            stamps_ns,
            ticks,
            self._config.ticks_per_revolution,
            self._wheel_radius_m,
            self._track_m,
        )
        return EncoderBatch(stream, true_ns, arrival_ns, angles_rad).select(there)

    def _count(self, angles_rad: FloatArray) -> IntArray:
        """(n, 2) ticks after these true angles, less the ones missed so far."""
        config = self._config
        turned = angles_rad * (1.0 + np.array(config.wheel_scale_error))
        exact = turned * (config.ticks_per_revolution / (2.0 * np.pi))
        passed = np.floor(exact).astype(np.int64)
        if config.tick_noise > 0.0:
            exact = exact + config.tick_noise * self._noise.standard_normal(exact.shape)
        return np.floor(exact).astype(np.int64) - self._missed_after(passed)

    def _missed_after(self, passed: IntArray) -> IntArray:
        """(n, 2) signed number of ticks lost since the start: each one with the same chance."""
        if self._config.missed_tick_probability == 0.0 or len(passed) == 0:
            return np.zeros_like(passed)
        before = passed[:1] if self._last_count is None else self._last_count[None]
        steps = np.diff(np.concatenate([before, passed]), axis=0)
        lost = self._missing.binomial(np.abs(steps), self._config.missed_tick_probability)
        missed = self._missed + np.cumsum(np.sign(steps) * lost, axis=0)
        self._last_count, self._missed = passed[-1], missed[-1]
        return np.asarray(missed, dtype=np.int64)
