"""Wheel encoders: cumulative counts at their own rate."""

from __future__ import annotations

import numpy as np

from slamsim.config.sensors import EncoderConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import EncoderStream, FloatArray, IntArray
from slamsim.sensors.clock import StreamClock
from slamsim.sensors.motion import Motion
from slamsim.sensors.readings import EncoderBatch


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
            stamps_ns[there],
            ticks[there],
            self._config.ticks_per_revolution,
            self._wheel_radius_m,
            self._track_m,
        )
        return EncoderBatch(stream, true_ns[there], arrival_ns[there], angles_rad[there])

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
