"""Streams merged, against numpy's set operations."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slamsim.core.stamps import merged, order_once

STAMPS = st.lists(st.integers(-50, 50), max_size=30)


@given(one=STAMPS, other=STAMPS)
def test_merged_stamps_are_the_union(one: list[int], other: list[int]) -> None:
    a, b = (np.sort(np.array(each, dtype=np.int64)) for each in (one, other))
    np.testing.assert_array_equal(merged(a, b), np.union1d(a, b))


@given(stamps=STAMPS)
def test_each_stamp_is_taken_once_where_it_stands_first(stamps: list[int]) -> None:
    stamps_ns = np.array(stamps, dtype=np.int64)
    _, first = np.unique(stamps_ns, return_index=True)
    np.testing.assert_array_equal(order_once(stamps_ns), first)
