"""Distributions of recipes: against scipy's, and what of them is refused."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scipy import stats

from slamsim.core.randomness import random_bits, random_share
from slamsim.dataset.recipe.distributions import (
    Choice,
    Distribution,
    Drawn,
    Integers,
    Listed,
    LogUniform,
    Normal,
    Uniform,
    edges,
    pick,
)

SHARES = np.linspace(0.0, 1.0, 1001)[:-1]
NUMBER = st.floats(-1e6, 1e6).map(lambda value: float(f"{value:.6g}"))
ANY: TypeAdapter[Distribution] = TypeAdapter(Distribution)


def _values(drawn: Drawn) -> list[float]:
    values = [drawn.value(float(share)) for share in SHARES]
    assert all(isinstance(value, int | float) for value in values)
    return values  # type: ignore[return-value]


@given(NUMBER, st.floats(1e-3, 1e3))
def test_uniform(low: float, width: float) -> None:
    high = low + width
    values = _values(Uniform(uniform=(low, high)))
    assert all(low <= a <= b <= high for a, b in pairwise(values))
    np.testing.assert_allclose(values, low + SHARES * width, rtol=1e-5, atol=1e-5 * abs(low))


@given(st.floats(1e-6, 1e3), st.floats(1.0, 1e4))
def test_log_uniform(low: float, factor: float) -> None:
    high = low * factor
    values = _values(LogUniform(log_uniform=(low, high)))
    assert all(low <= a <= b <= high for a, b in pairwise(values))
    assume(factor > 1.001)
    np.testing.assert_allclose(values, stats.loguniform(low, high).ppf(SHARES), rtol=1e-5)


@given(st.floats(-10, 10), st.floats(0.01, 5), st.floats(-3, 2), st.floats(0.5, 4))
def test_normal_is_cut_and_not_clipped(mean: float, sd: float, low: float, width: float) -> None:
    bounds = (mean + sd * low, mean + sd * (low + width))
    values = _values(Normal(normal=(mean, sd), within=bounds))
    assert all(bounds[0] <= a <= b <= bounds[1] for a, b in pairwise(values))
    expected = stats.truncnorm(low, low + width, mean, sd).ppf(SHARES)
    np.testing.assert_allclose(values, expected, atol=2e-5 * (abs(mean) + sd) + 1e-9)


def test_normal_without_deviation_or_bounds() -> None:
    assert set(_values(Normal(normal=(2.0, 0.0)))) == {2.0}
    assert Normal(normal=(2.0, 0.5)).extremes() == (0.5, 3.5)


@given(st.integers(-50, 50), st.integers(0, 20))
def test_integers_are_all_as_likely(low: int, width: int) -> None:
    values = _values(Integers(integers=(low, low + width)))
    numbers = Counter(values)
    assert set(numbers) == set(range(low, low + width + 1))
    assert max(numbers.values()) - min(numbers.values()) <= 1


@given(
    st.lists(st.one_of(st.just(0.0), st.floats(1e-3, 10)), min_size=1, max_size=8),
    st.floats(0, 1, exclude_max=True),
)
def test_pick_is_as_likely_as_the_weight_and_never_a_zero(
    weights: list[float], share: float
) -> None:
    assume(sum(weights) > 0.0)
    picked = pick(tuple(weights), share)
    assert weights[picked] > 0.0
    before = sum(weights[:picked]) / sum(weights)
    assert before - 1e-9 <= share <= before + weights[picked] / sum(weights) + 1e-9


def test_choices_by_weight() -> None:
    one = Choice(choice=("a", "b", "c"), weights=(1, 0, 3))
    assert Counter(one.value(float(share)) for share in SHARES) == {"a": 250, "c": 750}
    assert one.extremes() == ("a", "c")


def test_plain_values_lists_and_edges() -> None:
    assert ANY.validate_python(3).value(0.5) == 3  # type: ignore[union-attr]
    listed = ANY.validate_python([{"uniform": [0, 1]}, 5])
    assert isinstance(listed, Listed)
    assert edges(listed) == ([0.0, 5], [1.0, 5], [0.0, 5])
    assert edges(ANY.validate_python([])) == ([],)


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"uniform": [2, 1]}, "the smaller value comes first"),
        ({"uniform": [1]}, "Field required"),
        ({"uniform": [0, float("inf")]}, "finite"),
        ({"integers": [1.5, 2]}, "integer"),
        ({"log_uniform": [0, 1]}, "begins above 0"),
        ({"normal": [0, -1]}, "never negative"),
        ({"normal": [0, 1], "within": [50, 60]}, "next to nothing"),
        ({"normal": [0, 0], "within": [1, 2]}, "lies outside"),
        ({"choice": []}, "at least 1"),
        ({"choice": [1, 2], "weights": [1]}, "2 choices have 1 weights"),
        ({"choice": [1, 2], "weights": [0, 0]}, "nothing could be chosen"),
        ({"choice": [1, 2], "weights": [1, -1]}, "greater than or equal to 0"),
        ({"uniform": [1, 2], "weights": [1]}, "not permitted"),
        ({"unifrom": [1, 2]}, "did you mean 'uniform'"),
        ({}, "there is no distribution ''"),
        ({"listed": [{"nrmal": [0, 1]}]}, "did you mean 'normal'"),
    ],
)
def test_the_impossible_is_refused(given_: object, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        ANY.validate_python(given_)


def test_random_numbers_are_even_and_apart() -> None:
    shares = [random_share(1, "sequence", str(index), "x") for index in range(4000)]
    assert stats.kstest(shares, "uniform").pvalue > 1e-3
    assert 0.0 <= min(shares) < max(shares) < 1.0
    others = [random_share(1, "sequence", str(index), "y") for index in range(4000)]
    assert abs(np.corrcoef(shares, others)[0, 1]) < 0.06
    assert random_bits(1, "ab", "c") != random_bits(1, "a", "bc")
    assert random_bits(0) == 9523843951405948789  # data sets would change with it
