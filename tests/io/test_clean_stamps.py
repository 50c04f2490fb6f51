"""Stamps that do not rise are made to, as near to the truth as the recording allows."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamsim.core.types import IntArray
from slamsim.recording.cleaning.rising_stamps import NoTime, _known, rising_times, unset

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
COUNT = 2000


def true_ns(hz: float = 9.7) -> IntArray:
    """Regular but for jitter and one pause of a minute."""
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, COUNT)
    ns = np.round((np.arange(COUNT) + jitter) * SECOND / hz).astype(np.int64)
    return START_NS + ns + np.where(np.arange(COUNT) >= 1200, 60 * SECOND, 0)


def test_stamps_that_rise_are_left_alone() -> None:
    times = rising_times(true_ns(), np.zeros(COUNT, dtype=np.int64))
    assert times.told == () and not times.made_anew
    assert np.array_equal(times.stamps_ns, true_ns())
    assert np.array_equal(times.order, np.arange(COUNT))


@pytest.mark.parametrize("resolution_s", [1.0, 0.5, 0.25])
def test_coarse_stamps_are_spread_evenly(resolution_s: float) -> None:
    resolution_ns = int(resolution_s * SECOND)
    times = rising_times(true_ns() // resolution_ns * resolution_ns)
    error_ns = np.abs(times.stamps_ns - true_ns() + resolution_ns // 2)
    assert times.order.size == COUNT and np.median(error_ns) < 0.6 * resolution_ns
    assert np.quantile(error_ns, 0.99) < resolution_ns
    assert "spread evenly" in times.told[0]


@pytest.mark.parametrize("default_ns", [0, 5, 2**61])
def test_missing_stamps_are_their_neighbours(default_ns: int) -> None:
    stamps_ns = true_ns()
    missing = np.random.default_rng(1).random(COUNT) < 0.3
    missing[0] = missing[-1] = True
    stamps_ns[missing] = default_ns
    times = rising_times(stamps_ns)
    assert np.array_equal(times.stamps_ns[~missing], true_ns()[~missing])
    away_from_pause = np.abs(np.arange(COUNT) - 1200) > 50
    assert np.abs(times.stamps_ns - true_ns())[away_from_pause].max() < 0.1 * SECOND


@pytest.mark.parametrize("back_s", [2.0, 30.0, 1e6])
def test_a_clock_that_is_set_back_takes_no_scan(back_s: float) -> None:
    stamps_ns = true_ns()[:1000]
    stamps_ns[500:] -= int(back_s * SECOND)
    times = rising_times(stamps_ns)
    steps_s = np.diff(times.stamps_ns) * 1e-9
    assert times.order.size == 1000 and steps_s.min() > 0.03 and steps_s.max() < 0.31
    assert (times.stamps_ns[-1] - times.stamps_ns[0]) * 1e-9 == pytest.approx(103.0, abs=3.0)


@pytest.mark.parametrize("receiver_ns", [0, START_NS])
@pytest.mark.parametrize("set_at", [500, 1700])
def test_a_clock_that_is_set_back_goes_on_by_the_receipt(set_at: int, receiver_ns: int) -> None:
    """To a microsecond, though messages are received milliseconds late; the longest part counts."""
    delays_ns = np.random.default_rng(2).integers(1_000_000, 3_000_000, COUNT)
    received_ns = true_ns() - START_NS + receiver_ns + delays_ns
    stamps_ns = true_ns()
    stamps_ns[set_at:] -= 3 * SECOND
    on_ns, told = unset(stamps_ns, received_ns)
    kept = slice(None, set_at) if set_at > COUNT / 2 else slice(set_at, None)
    assert np.array_equal(on_ns[kept], stamps_ns[kept])
    assert np.abs(np.diff(on_ns - true_ns())).max() < 200_000
    assert len(told) == 1 and "was set (by -3 s)" in told[0]
    assert np.array_equal(rising_times(stamps_ns, received_ns).stamps_ns, on_ns)
    assert unset(stamps_ns, None)[1] == unset(true_ns(), received_ns)[1] == []


@pytest.mark.parametrize("clock_ns", [0, START_NS])
def test_equal_stamps_give_way_to_the_times_of_receipt(clock_ns: int) -> None:
    received_ns = true_ns() - START_NS + clock_ns
    times = rising_times(np.full(COUNT, 7, dtype=np.int64), received_ns)
    assert np.array_equal(times.stamps_ns, received_ns)
    assert "received" in times.told[0] and times.made_anew


def test_the_receiver_says_when_wrong_stamps_were_taken_on_their_clock() -> None:
    stamps_ns = true_ns()
    received_ns = stamps_ns - START_NS + 12_000_000
    stamps_ns[100:400] -= 50 * SECOND
    times = rising_times(stamps_ns, received_ns)
    assert np.abs(times.stamps_ns - true_ns()).max() < 1_000_000


@pytest.mark.parametrize("received", [None, np.zeros(COUNT, np.int64), np.arange(COUNT)])
def test_without_any_time_the_order_tells(received: IntArray | None) -> None:
    times = rising_times(np.zeros(COUNT, dtype=np.int64), received, period_ns=SECOND)
    assert np.array_equal(times.stamps_ns, np.arange(COUNT) * SECOND)
    assert "taken to be 1 s apart" in times.told[0]
    with pytest.raises(NoTime):
        rising_times(np.zeros(COUNT, dtype=np.int64), received)


def test_delayed_messages_are_sorted_and_repeated_ones_left_out() -> None:
    stamps_ns = true_ns()[[3, 0, 1, 1, 2, 5, 4]]
    is_repeat = np.array([False, False, False, True, False, False, False])
    times = rising_times(stamps_ns, is_repeat=is_repeat)
    assert times.order.tolist() == [1, 2, 4, 0, 6, 5] and not times.made_anew
    assert times.told == (
        "2 of 7 scans are stamped before the one above: sorted",
        "1 scans carry the stamp of another one: left out",
    )


def test_a_still_scene_on_one_stamp_is_no_repeat() -> None:
    is_repeat = np.arange(COUNT) > 0
    stamps_ns = np.zeros(COUNT, dtype=np.int64)
    assert rising_times(stamps_ns, is_repeat=is_repeat, period_ns=SECOND).order.size == COUNT


@given(st.lists(st.integers(-(2**61), 2**61), min_size=1, max_size=40), st.booleans())
@example([0, 1, 1, -(2**53)], False)
@example([0, 1, 1, -(2**53)], True)
@example([0] * 7 + [-(2**61), 0, 1], False)
def test_whatever_is_written_times_rise(stamps: list[int], sorting: bool) -> None:
    stamps_ns = np.array(stamps, dtype=np.int64)
    times = rising_times(stamps_ns, sorting=sorting, period_ns=SECOND)
    assert (np.diff(times.stamps_ns) > 0).all()
    assert np.unique(times.order).size == times.order.size
    assert times.order.size >= np.unique(stamps_ns).size


@given(st.lists(st.integers(0, 12), min_size=1, max_size=9))
def test_the_most_rising_stamps_are_kept(stamps: list[int]) -> None:
    """Against all subsets, where no stamp stands in three places."""
    stamps_ns = np.array(stamps, dtype=np.int64)
    runs = stamps_ns[np.concatenate([[True], np.diff(stamps_ns) != 0])]
    kept = stamps_ns[_known(stamps_ns)]
    assert (np.diff(kept) > 0).all()
    if np.unique(runs, return_counts=True)[1].max() < 3:
        slow = max(
            size
            for size in range(1, runs.size + 1)
            for some in combinations(runs.tolist(), size)
            if all(a < b for a, b in pairwise(some))
        )
        assert kept.size == slow
