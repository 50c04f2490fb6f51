"""The Dask engine on a small cluster of this machine."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dataset_run import children, end, make, tree

from slamsim.dataset.make.engines.dask import DaskEngine
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.identity import versions
from slamsim.dataset.make.shard import Tried, Unwatched
from slamsim.guard.errors import SlamsimError

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
COUNT = 12


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    calm = {"distributed.worker.profile.enabled": False}
    with (
        dask.config.set(calm),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster,
    ):
        yield cluster


class Killer(Unwatched):
    """Kills a worker of the cluster once some sequences are there."""

    def __init__(self, cluster: Any) -> None:
        self._cluster, self._made = cluster, 0

    def made(self, tried: Tried) -> None:
        self._made += 1
        if self._made == 3:
            end(next(iter(self._cluster.workers.values())).process.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    "told",
    [
        {},  # each that crashes is begun again, and loads its libraries for seconds
        pytest.param(
            {
                **{2: "crash", 4: "eat leave", 6: "hang", 7: "break kill"},
                9: "crash crash crash crash",  # once in company, three times alone
            },
            marks=pytest.mark.slow,
        ),
    ],
    ids=["one is killed", "all"],
)
def test_the_same_bytes_as_on_one_core_whatever_happens_to_the_workers(
    told: dict[int, str], cluster: Any, orders: Path, tmp_path: Path, one_worker: WorkEngine
) -> None:
    make(tmp_path / "undisturbed", orders, COUNT, one_worker)
    for number, words in told.items():
        (orders / str(number)).write_text(words)
    engine = DaskEngine(cluster.scheduler_address, batch=3)
    summary = make(
        tmp_path / "set", orders, COUNT, engine, seconds=0.1, limit_s=5.0, watch=Killer(cluster)
    )
    may_fail = {4, 7, 9} & told.keys()  # in company, then alone
    assert {failure.index for failure in summary.failures} <= may_fail
    engine = DaskEngine(cluster.scheduler_address)
    assert make(tmp_path / "set", orders, COUNT, engine).failures == ()
    assert tree(tmp_path / "set") == tree(tmp_path / "undisturbed")
    workers = [worker.process.pid for worker in cluster.workers.values()]
    assert not any(children(process) for process in workers)


@pytest.mark.long
def test_a_worker_with_other_software_is_refused(
    cluster: Any, orders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions.cache_clear()
    monkeypatch.setattr("slamsim.dataset.make.identity.__version__", "9.0")
    with pytest.raises(SlamsimError, match=r"has slamsim .* instead of 9\.0"):
        make(tmp_path / "set", orders, COUNT, DaskEngine(cluster.scheduler_address))
    versions.cache_clear()
    assert not (tmp_path / "set").exists()


@pytest.mark.long
def test_a_scheduler_that_does_not_answer_is_refused(
    orders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamsim.dataset.make.engines.dask._ANSWER_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        silent = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        for address, says in (
            (silent, "no Dask scheduler answers at tcp://127.0.0.1:.*timed out"),
            ("tcp://127.0.0.1:1", "no Dask scheduler answers .*refused"),
            ("10.0.0.1", "'10.0.0.1' is not the address of a Dask scheduler"),
        ):
            with pytest.raises(SlamsimError, match=says):
                make(tmp_path / "set", orders, COUNT, DaskEngine(address))
    assert not (tmp_path / "set").exists()
