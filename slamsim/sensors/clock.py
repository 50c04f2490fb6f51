"""Clocks of sensors: sampling instants, stamps, and receive times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.config.streams import StreamConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, IntArray


class StreamClock:
    """The instants of one stream, its stamps, and its messages' way to the log.

    Sample n is taken at ``start + phase + n / rate`` in true time, computed from n each time so
    that nothing adds up. Every call advances the generators by as many samples as it is given,
    in order: the outcome depends on the samples, not on how they are cut into calls.
    """

    def __init__(self, config: StreamConfig, start_ns: int, seed: int, name: str) -> None:
        self._config, self._start_ns = config, start_ns
        self._jitter = random_stream(seed, name, "jitter")
        self._latency = random_stream(seed, name, "latency")
        self._drops = random_stream(seed, name, "drops")
        self._last_arrival_ns = np.iinfo(np.int64).min

    def instants_ns(self, samples: NDArray[np.integer | np.floating]) -> IntArray:
        """(n,) true time of the samples with these numbers; halves lie midway between two."""
        elapsed_ns = self._config.phase_s * 1e9 + samples * (1e9 / self._config.rate_hz)
        return np.asarray(self._start_ns + np.rint(elapsed_ns).astype(np.int64))

    def needed_ns(self, sample: float) -> int:
        """True time from which on the motion must be kept to take this sample and all later."""
        if not self._config.enabled:
            return int(np.iinfo(np.int64).max)
        return int(self.instants_ns(np.array([sample]))[0])

    def samples_until(self, first: int, until_ns: int) -> IntArray:
        """(n,) numbers of the samples from ``first`` that were taken at or before an instant."""
        if not self._config.enabled:
            return np.zeros(0, dtype=np.int64)
        elapsed_s = (until_ns - self._start_ns) * 1e-9 - self._config.phase_s
        samples = np.arange(first, int(elapsed_s * self._config.rate_hz) + 2)
        return samples[self.instants_ns(samples) <= until_ns]

    def stamps_ns(self, true_ns: IntArray) -> IntArray:
        """(n,) what the stream's own clock says at these instants."""
        clock = self._config.clock
        error_ns = clock.offset_s * 1e9 + clock.drift_ppm * 1e-6 * (true_ns - self._start_ns)
        if clock.jitter_s > 0.0:
            error_ns = error_ns + clock.jitter_s * 1e9 * self._jitter.standard_normal(true_ns.size)
        return np.asarray(true_ns + np.rint(error_ns).astype(np.int64))

    def arrivals_ns(self, acquired_ns: IntArray) -> IntArray:
        """(n,) true time at which messages that were complete at these instants are there."""
        clock = self._config.clock
        delay_ns = np.full(acquired_ns.size, clock.latency_s * 1e9)
        if clock.latency_jitter_s > 0.0:
            delay_ns += clock.latency_jitter_s * 1e9 * self._latency.exponential(size=delay_ns.size)
        alone = acquired_ns + np.rint(delay_ns).astype(np.int64)
        in_order = np.maximum.accumulate(np.append(self._last_arrival_ns, alone))
        self._last_arrival_ns = int(in_order[-1])
        return np.asarray(in_order[1:], dtype=np.int64)

    def arrived(self, count: int) -> BoolArray:
        """(count,) which of the next messages are not lost on the way."""
        if self._config.clock.drop_probability == 0.0:
            return np.ones(count, dtype=np.bool_)
        return np.asarray(self._drops.random(count) >= self._config.clock.drop_probability)
