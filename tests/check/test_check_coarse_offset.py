"""Lags found by correlation, for whole signals and piece by piece; counters that wrap."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.signal import fftconvolve

from slamsim.check.motion.coarse_offset import Rate, coarse_lag, convolved
from slamsim.check.motion.local_lags import local_lags
from slamsim.check.motion.wheel_counts import counter_range, unwrapped
from slamsim.core.types import FloatArray


def signal(times_s: FloatArray) -> FloatArray:
    """Bumps of random size at random places, the same in every test."""
    rng = np.random.default_rng(5)
    places, sizes = rng.uniform(0.0, 60.0, 40), rng.standard_normal(40)
    return np.asarray(
        (sizes * np.exp(-0.5 * np.square((times_s[:, None] - places) / 0.4))).sum(axis=1)
    )


def rate(begin_s: float, end_s: float, period_s: float, late_s: float = 0.0) -> Rate:
    edges = np.arange(begin_s, end_s, period_s)
    return Rate(edges[:-1] + late_s, edges[1:] + late_s, signal(0.5 * (edges[1:] + edges[:-1])))


@given(st.integers(1, 3000), st.integers(1, 900))
def test_convolutions_are_those_of_scipy_to_the_last_bit(first: int, second: int) -> None:
    random = np.random.default_rng(first)
    a, b = random.normal(size=first), random.normal(size=second)
    np.testing.assert_array_equal(convolved(a, b[::-1]), fftconvolve(a, b[::-1]))


@given(
    late_s=st.floats(-12.0, 12.0),
    period_s=st.sampled_from([0.01, 0.05, 0.1]),
    sign=st.sampled_from([1.0, -3.0]),
)
def test_a_lag_is_found_whatever_rate_and_sign(late_s: float, period_s: float, sign: float) -> None:
    one, other = rate(3.0, 57.0, period_s), rate(0.0, 60.0, 0.02, late_s)
    found = coarse_lag(one, Rate(other.starts_s, other.ends_s, sign * other.values))
    assert found is not None
    assert found.clear
    assert abs(found.lag_s - late_s) < 0.03
    assert np.sign(found.correlation) == np.sign(sign)


def test_windows_with_pauses_between_them_do() -> None:
    whole = rate(0.0, 60.0, 0.05)
    kept = (whole.starts_s // 5.0).astype(int) % 2 == 0
    one = Rate(whole.starts_s[kept], whole.ends_s[kept], whole.values[kept])
    found = coarse_lag(one, rate(0.0, 60.0, 0.02, 2.5))
    assert found is not None
    assert abs(found.lag_s - 2.5) < 0.03


def test_signals_that_have_nothing_to_do_with_each_other() -> None:
    rng = np.random.default_rng(0)
    noise = rate(0.0, 60.0, 0.05)
    found = coarse_lag(
        rate(0.0, 60.0, 0.05),
        Rate(noise.starts_s, noise.ends_s, rng.standard_normal(noise.values.size)),
    )
    assert found is None or not found.clear
    still = Rate(noise.starts_s, noise.ends_s, np.zeros(noise.values.size))
    assert coarse_lag(noise, still) is None


@settings(max_examples=6)
@given(growth=st.floats(-0.01, 0.01), at_zero=st.floats(-1.0, 1.0))
def test_a_growing_lag_is_followed_piece_by_piece(growth: float, at_zero: float) -> None:
    one, other = rate(5.0, 55.0, 0.05), rate(0.0, 60.0, 0.02)
    starts, ends = (edges * (1.0 + growth) + at_zero for edges in (other.starts_s, other.ends_s))
    other = Rate(starts, ends, other.values)
    found = local_lags(one, ((one.starts_s - 5.0) // 5.0).astype(np.int64), other, 1.0)
    assert found is not None
    start, slope = found.line()
    assert abs(slope - growth) < 2e-3
    assert abs(start - at_zero) < 0.1
    assert found.wander_s() < 0.12


@given(
    steps=st.lists(st.integers(-1, 3), min_size=40, max_size=300),
    bits=st.integers(8, 40),
    start=st.integers(-(10**6), 10**6),
)
def test_a_wrapped_counter_is_unwrapped(steps: list[int], bits: int, start: int) -> None:
    whole = 1 << bits
    true = start + np.cumsum(np.array([0, *steps], dtype=np.int64)) * (whole // 16)
    wrapped = (true + whole // 2) % whole - whole // 2
    # Only what comes near both ends shows how many digits there are.
    assume(np.ptp(true) > 2 * whole)
    assert counter_range(wrapped) == whole
    assert np.array_equal(unwrapped(wrapped) - wrapped[0], true - true[0])


@given(steps=st.lists(st.integers(-30, 30), min_size=3, max_size=100))
def test_a_counter_with_enough_digits_is_left_alone(steps: list[int]) -> None:
    counts = np.cumsum(np.array(steps, dtype=np.int64))
    assert counter_range(counts) is None
    assert np.array_equal(unwrapped(counts), counts)
