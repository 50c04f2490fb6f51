"""Clocks: when streams sample, what they stamp, when messages arrive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.config.streams import StreamConfig
from slamsim.sensors.clock import StreamClock

START = 123_456_789_000
EVERY = np.arange(20_000)


def clock(
    rate_hz: float = 100.0, phase_s: float = 0.0, seed: int = 0, **errors: Any
) -> StreamClock:
    config = StreamConfig.model_validate({"rate_hz": rate_hz, "phase_s": phase_s, "clock": errors})
    return StreamClock(config, START, seed, "test")


@settings(max_examples=60)
@given(rate_hz=st.floats(0.1, 5000.0), phase_s=st.floats(0.0, 10.0), span_s=st.floats(0.0, 20.0))
def test_samples_come_at_their_rate_and_phase(
    rate_hz: float, phase_s: float, span_s: float
) -> None:
    stream = clock(rate_hz, phase_s)
    until = START + round(span_s * 1e9)
    samples = stream.samples_until(0, until)
    instants = stream.instants_ns(samples)
    exact_s = phase_s + samples / rate_hz
    np.testing.assert_allclose((instants - START) * 1e-9, exact_s, atol=1e-9)
    assert (instants <= until).all()
    assert stream.instants_ns(np.array([samples.size]))[0] > until  # none is missing
    np.testing.assert_array_equal(samples, np.arange(samples.size))


def test_a_healthy_clock_tells_the_true_time_at_once() -> None:
    stream = clock()
    true = stream.instants_ns(EVERY)
    np.testing.assert_array_equal(stream.stamps_ns(true), true)
    np.testing.assert_array_equal(stream.arrivals_ns(true), true)
    assert stream.arrived(1000).all()


def test_offset_and_drift() -> None:
    true = clock().instants_ns(EVERY)
    np.testing.assert_array_equal(clock(offset_s=-0.25).stamps_ns(true), true - 250_000_000)
    error = clock(drift_ppm=50.0).stamps_ns(true) - true
    np.testing.assert_allclose(error, 50e-6 * (true - START), atol=1.0)


def test_jitter() -> None:
    true = clock().instants_ns(EVERY)
    error = clock(jitter_s=1e-3).stamps_ns(true) - true
    assert error.std() == pytest.approx(1e6, rel=0.03)
    assert abs(error.mean()) < 4e6 / np.sqrt(EVERY.size)


def test_messages_arrive_late_but_in_order() -> None:
    true = clock().instants_ns(EVERY)
    np.testing.assert_array_equal(clock(latency_s=0.02).arrivals_ns(true), true + 20_000_000)
    delay = clock(rate_hz=1.0, latency_jitter_s=0.01).arrivals_ns(true * 10) - true * 10
    assert (delay >= 0).all()
    assert delay.mean() == pytest.approx(1e7, rel=0.03)
    crowded = clock(latency_s=0.001, latency_jitter_s=0.5).arrivals_ns(true)
    assert (np.diff(crowded) >= 0).all()
    assert (crowded >= true + 1_000_000).all()


def test_drops() -> None:
    assert clock(drop_probability=0.3).arrived(20_000).mean() == pytest.approx(0.7, abs=0.01)
    assert not clock(drop_probability=1.0).arrived(100).any()


def test_each_error_draws_from_a_stream_of_its_own() -> None:
    true = clock().instants_ns(EVERY)
    all_on = clock(jitter_s=1e-3, latency_jitter_s=1e-3, drop_probability=0.5)
    jitter, late = clock(jitter_s=1e-3), clock(latency_jitter_s=1e-3)
    np.testing.assert_array_equal(all_on.stamps_ns(true), jitter.stamps_ns(true))
    np.testing.assert_array_equal(all_on.arrivals_ns(true), late.arrivals_ns(true))
    np.testing.assert_array_equal(all_on.arrived(500), clock(drop_probability=0.5).arrived(500))


def test_cutting_the_samples_into_calls_changes_nothing() -> None:
    errors: dict[str, Any] = {
        "jitter_s": 1e-3,
        "latency_jitter_s": 0.05,
        "drop_probability": 0.5,
    }
    true = clock().instants_ns(EVERY[:500])
    whole, cut = clock(**errors), clock(**errors)
    pieces = np.split(true, [0, 1, 7, 7, 300])
    np.testing.assert_array_equal(
        whole.stamps_ns(true), np.concatenate([cut.stamps_ns(piece) for piece in pieces])
    )
    np.testing.assert_array_equal(
        whole.arrivals_ns(true), np.concatenate([cut.arrivals_ns(piece) for piece in pieces])
    )
    np.testing.assert_array_equal(
        whole.arrived(500), np.concatenate([cut.arrived(piece.size) for piece in pieces])
    )
