"""A cluster, by Dask distributed: any scheduler that can be reached, with any workers.

A Dask worker does not make sequences itself: each of its threads has a process of its own for
that, the same one that the local engine uses. So a sequence that crashes costs no Dask worker, and
what Dask adds is the way there and back.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Self
from urllib.parse import urlsplit

from slamsim.dataset.make.engines.local import Answer
from slamsim.dataset.make.identity import difference, versions
from slamsim.dataset.make.shard import ShardTask, Tried, make_sequences
from slamsim.guard.errors import SlamsimError, shown
from slamsim.process.worker import Worker, WorkerDied, fair_share_bytes

_ANSWER_S = 5.0
"""So long a scheduler may take to answer before it is taken for absent."""
_AHEAD = 2
"""Tasks submitted for each thread of the cluster: one runs, one waits beside it."""
_LOOK_S = 2.0
_END_S = 10.0
_CALM = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "2s",
}
"""Dask looks at itself up to 100 times a second, as it must where tasks take milliseconds; with two
cores that takes a tenth of them."""
_ADDRESS = re.compile(r"[a-z]+://[^/\s]+:\d+")


class DaskEngine:
    """scheduler: its address, such as ``tcp://10.0.0.1:8786``. batch: most sequences in a task.

    Workers may come and go while it runs; a task whose worker is lost is given to another.
    """

    def __init__(self, scheduler: str, batch: int = 20) -> None:
        self.batch = batch
        self._scheduler = scheduler
        self._client: Any = None
        self._threads, self._looked_s = 1, -_LOOK_S

    def __enter__(self) -> Self:
        """Raises SlamsimError if no scheduler answers, or a worker has other software."""
        _mute()
        self._client = _connected(self._scheduler)
        try:
            self._require_same_software()
        except BaseException:
            self._client.close(_END_S)
            raise
        self._executor = self._client.get_executor(pure=False)
        return self

    def __exit__(self, *error: object) -> None:
        self._executor.shutdown(wait=False)
        with suppress(OSError, TimeoutError, CancelledError):  # a scheduler that is gone already
            self._client.run(end_workers, on_error="ignore")
        self._client.close(_END_S)

    def slots(self) -> int:
        if time.monotonic() > self._looked_s + _LOOK_S:
            with suppress(OSError, TimeoutError):
                self._threads = max(1, sum(self._client.nthreads().values()))
            self._looked_s = time.monotonic()
        return self._threads * _AHEAD

    def submit(self, task: ShardTask) -> Answer:
        answer: Answer = Future()
        self._executor.submit(make_on_worker, task).add_done_callback(
            lambda done: _pass_on(done, answer)
        )
        return answer

    def _require_same_software(self) -> None:
        found: Mapping[str, Any] = self._client.run(versions, on_error="return")
        for worker, theirs in found.items():
            if isinstance(theirs, BaseException):
                raise SlamsimError(f"the Dask worker {worker} cannot run slamsim: {theirs}")
            if differs := difference(versions(), theirs):
                raise SlamsimError(
                    f"the Dask worker {worker} has {differs}; give all the same software"
                )


@contextmanager
def cluster_here(workers: int) -> Iterator[str]:
    """The address of a scheduler on this machine with one worker of so many threads.

    Raises SlamsimError where Dask is not installed.
    """
    try:
        import dask
        from distributed import LocalCluster
    except ImportError:
        raise SlamsimError("this needs Dask: pip install 'slamsim[cluster]'") from None
    _mute()
    with (
        dask.config.set(_CALM),
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=1, threads_per_worker=workers, dashboard_address=":0"
        ) as cluster,
    ):
        yield cluster.scheduler_address


def _mute() -> None:
    """What goes wrong is told by what is raised."""
    for name in ("distributed", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _connected(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise SlamsimError("--engine dask needs Dask: pip install 'slamsim[cluster]'") from None
    if not _ADDRESS.fullmatch(scheduler):
        raise SlamsimError(
            f"{shown(scheduler)} is not the address of a Dask scheduler, such as tcp://10.0.0.1:8786"
        )
    try:
        if scheduler.startswith("tcp://"):
            _await_greeting(scheduler)
        return Client(scheduler, timeout=_ANSWER_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except Exception as error:  # whatever an answer of another process may cause
        told = str(error) or "it is silent"
        raise SlamsimError(f"no Dask scheduler answers at {scheduler}: {told}") from None


def _await_greeting(scheduler: str) -> None:
    """A scheduler speaks first; the client would wait for a mute one for ever."""
    place = urlsplit(scheduler)
    with socket.create_connection((place.hostname, place.port), _ANSWER_S) as connection:
        if not connection.recv(1):
            raise ConnectionError("it hangs up at once")


def _pass_on(done: Future[tuple[Tried, ...]], answer: Answer) -> None:
    from distributed import KilledWorker

    try:
        answer.set_result(done.result())
    except KilledWorker:
        answer.set_exception(WorkerDied("Dask lost every worker that it was given to"))
    except BaseException as error:
        answer.set_exception(error)


_own = threading.local()
_workers: set[Worker] = set()


def make_on_worker(task: ShardTask) -> tuple[Tried, ...]:
    """In a thread of a Dask worker: make the sequences in the process of this thread."""
    worker: Worker | None = getattr(_own, "worker", None)
    if worker is None or worker.stopped:
        # Dask marks its workers as daemons, which may have no children, lest these outlive them;
        # ours die with their parent in any case.
        multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
        # Dask has its workers give memory back at once; ours, which take it again for the next
        # scan, would spend a sixth of their time on that.
        os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
        worker = _own.worker = Worker(_share_bytes())
        _workers.add(worker)
    return worker.run(partial(make_sequences, task), task.limit_s)


def end_workers() -> None:
    """In a Dask worker: end the processes of all its threads, whatever they do."""
    for worker in tuple(_workers):
        worker.stop()
    for worker in tuple(_workers):
        worker.close()
    _workers.clear()


def _share_bytes() -> int:
    """Of the memory that Dask gives this worker, or of the machine's if it sets no limit."""
    from distributed import get_worker

    here = get_worker()
    threads: int = here.state.nthreads
    limit: int | None = here.memory_manager.memory_limit
    return limit // threads if limit else fair_share_bytes(threads)
