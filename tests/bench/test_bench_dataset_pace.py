"""The pace of workers: neither their start nor the tail counts."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Self

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from slamsim.bench import dataset
from slamsim.bench.dataset import Made, Pace, settled_pace
from slamsim.cli.main import app
from slamsim.guard.errors import SlamsimError

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


class _Here:
    """As ``Children``, with nothing measured."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def run(self, work: Callable[..., object], *arguments: object) -> dict[str, float]:
        return {"cpu_s_per_sequence": 7.0}


@pytest.mark.parametrize("fails", [False, True])
def test_what_was_measured_is_told_without_dask_and_when_the_rest_fails(
    fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pace(*arguments: object) -> Pace:
        if fails:
            raise SlamsimError("a worker has made fewer than two sequences")
        return Pace(2.0, 1.0)

    monkeypatch.setattr(dataset, "find_spec", lambda name: None)
    monkeypatch.setattr(dataset, "Children", _Here)
    monkeypatch.setattr(dataset, "bare_scaling", lambda children, count: 1.9)
    monkeypatch.setattr(dataset, "pace", pace)
    done = CliRunner().invoke(app, ["bench", "dataset", "--seeds", "2", "--json"])
    assert ("fewer than two" in str(done.exception)) if fails else (done.exit_code == 0)
    told = json.loads(done.stdout)
    assert told["one_core"] == {"cpu_s_per_sequence": 7.0}
    assert ("sequences_per_s" in told) is not fails
    assert "dask_time_over_local" not in told
