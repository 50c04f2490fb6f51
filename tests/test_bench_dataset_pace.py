"""The pace of workers: neither their start nor the tail counts."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.bench.dataset_pace import Made, settled_pace
from slamsim.safe.errors import SlamsimError

workers = st.lists(
    st.tuples(st.floats(0.0, 100.0), st.floats(0.1, 10.0), st.integers(2, 20)), min_size=1
)


@given(workers)
def test_paces_of_workers_add_up_whenever_each_begins_and_ends(
    each: list[tuple[float, float, int]],
) -> None:
    """Of each worker: the end of its first sequence, how long each takes, how many it makes."""
    made = [
        Made(worker, first_s + number * period_s, 2.0)
        for worker, (first_s, period_s, count) in enumerate(each)
        for number in range(count)
    ]
    pace = settled_pace(made[::-1])
    assert pace.sequences_per_s == pytest.approx(sum(1.0 / period_s for _, period_s, _ in each))
    assert pace.cpu_s == 2.0


def test_a_worker_that_made_one_has_no_pace() -> None:
    with pytest.raises(SlamsimError, match="ask for more"):
        settled_pace([Made(1, 1.0, 1.0), Made(1, 2.0, 1.0), Made(2, 1.5, 1.0)])
