"""Local engine: worker processes on this machine."""

from __future__ import annotations

from functools import partial
from typing import Self

from slamsim.dataset.make.engines.base import Answer
from slamsim.dataset.make.shard import ShardTask, make_sequences
from slamsim.process.worker import Workers


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
