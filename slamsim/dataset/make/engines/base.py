"""Interface of an engine."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Protocol, Self

from slamsim.dataset.make.shard import ShardTask, Tried

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
