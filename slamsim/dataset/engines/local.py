"""The cores of this machine."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Self

from slamsim.dataset.engines.base import Answer
from slamsim.dataset.engines.worker import Worker, fair_share_bytes
from slamsim.dataset.shard import Task, Tried


class LocalEngine:
    """As many processes as there are workers, each with a thread here that waits for it.

    workers: as many as there are cores for us, if none is given. memory_bytes: the most that one
    may have; without it, its share of the machine's.
    """

    batch = 1

    def __init__(self, workers: int | None = None, memory_bytes: int | None = None) -> None:
        self._count = workers or _cores()
        self._memory_bytes = memory_bytes or fair_share_bytes(self._count)
        self._own = threading.local()
        self._workers: list[Worker] = []
        self._threads = ThreadPoolExecutor(self._count, "worker", self._begin)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.stop()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.close()

    def slots(self) -> int:
        """One more than there are workers, so that none waits for the next task."""
        return self._count + 1

    def submit(self, task: Task) -> Answer:
        return self._threads.submit(self._make, task)

    def _begin(self) -> None:
        self._own.worker = Worker(self._memory_bytes)
        self._workers.append(self._own.worker)

    def _make(self, task: Task) -> tuple[Tried, ...]:
        worker: Worker = self._own.worker
        return worker.make(task)


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
