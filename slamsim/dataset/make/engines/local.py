"""Interface of an engine, and the local one: worker processes on this machine."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from typing import Protocol, Self

from slamsim.dataset.make.shard import ShardTask, Tried, make_sequences
from slamsim.process.worker import Workers

Answer = Future[tuple[Tried, ...]]


class WorkEngine(Protocol):
    """Runs ``shard.make_sequences`` in workers; none outlives the ``with`` block.

    batch: at most so many sequences make a task of it.
    """

    batch: int

    def __enter__(self) -> Self:
        """Raises SlamsimError if no worker can be had."""

    def __exit__(self, *error: object) -> None:
        """Ends all that still runs, within seconds."""

    def slots(self) -> int:
        """So many tasks are worth submitting at a time; a cluster may grow and shrink."""

    def submit(self, task: ShardTask) -> Answer:
        """Raises, when asked for its result, what ``make_sequences`` raises, or WorkerDied."""


class LocalEngine:
    """workers and memory_bytes: as ``Workers`` has them."""

    batch = 1

    def __init__(self, workers: int | None = None, memory_bytes: int | None = None) -> None:
        self._workers = Workers(workers, memory_bytes)

    def __enter__(self) -> Self:
        self._workers.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._workers.__exit__(*error)

    def slots(self) -> int:
        """One more than there are workers, so that none waits for the next task."""
        return self._workers.count + 1

    def submit(self, task: ShardTask) -> Answer:
        return self._workers.submit(partial(make_sequences, task), task.limit_s)
