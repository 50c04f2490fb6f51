"""Are borders found, and trends believed, only where there are any?"""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from slamsim.config.scenarios.bodies import StepsConfig
from slamsim.scenarios.physics.stacking import IN_A_ROW, largest_passing, smallest_failing
from slamsim.scenarios.rows import largest_below, trend


def test_steps_are_free_of_rounding() -> None:
    values_s = StepsConfig(first_s=0.001, last_s=0.030, by_s=0.001).values_s()
    assert values_s == tuple(k / 1000 for k in range(1, 31))


@given(st.lists(st.booleans(), min_size=2, max_size=40))
def test_the_smallest_that_fails_has_enough_holding_below_it(fails: list[bool]) -> None:
    asked = list[int]()

    def failing(number: int) -> bool:
        asked.append(number)
        return number > 1 and fails[number - 1]

    found = smallest_failing(failing, len(fails))
    assert len(asked) == len(set(asked))
    if not fails[-1]:
        assert found is None
    else:
        assert found is not None and found > 1 and failing(found)
        assert not any(failing(below) for below in range(max(found - IN_A_ROW, 1), found))


@given(st.integers(2, 60), st.integers(2, 60))
def test_a_sharp_border_is_found_in_few_trials(border: int, most: int) -> None:
    asked = list[int]()

    def failing(number: int) -> bool:
        asked.append(number)
        return number >= border

    assert smallest_failing(failing, most) == (border if border <= most else None)
    assert len(asked) <= math.log2(most) + 2 + IN_A_ROW


@given(st.lists(st.booleans(), max_size=12))
def test_the_largest_that_passes_is_that_of_an_exhaustive_look(passes: list[bool]) -> None:
    ascending = [0.001 * (k + 1) for k in range(len(passes))]
    by_step = dict(zip(ascending, passes, strict=True))
    expected = None
    for at in range(len(passes)):
        if all(passes[max(at - IN_A_ROW + 1, 0) : at + 1]):
            expected = ascending[at]
    assert largest_passing(by_step.__getitem__, ascending) == expected


def test_a_trend_needs_points_that_tell() -> None:
    steps = [0.001 * k for k in range(1, 11)]
    rising, flat = trend(steps, [k**2 for k in range(10)]), trend(steps, [1.0] * 10)
    assert rising is not None and rising.grows() and not rising.falls()
    assert flat is None and trend(steps[:5], steps[:5]) is None
    mixed = trend(steps, [1, -1] * 5)
    assert mixed is not None and not mixed.grows() and not mixed.falls()


def test_the_largest_step_below_a_bound_has_no_worse_one_before_it() -> None:
    steps_s = [0.03, 0.01, 0.02, 0.04]
    assert largest_below(steps_s, [0.1, 0.1, 5.0, 0.1], 1.0) == 0.01
    assert largest_below(steps_s, [0.1, 0.1, 0.2, None], 1.0) == 0.03
    assert largest_below(steps_s, [0.1, 2.0, 0.2, 0.1], 1.0) is None
