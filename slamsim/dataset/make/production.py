"""Makes all sequences of a data set, with retries when workers fail."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, datetime

import pyarrow as pa
import pyarrow.compute as pc

from slamsim.dataset.make.engines.local import Answer, WorkEngine
from slamsim.dataset.make.identity import versions
from slamsim.dataset.make.shard import (
    MADE,
    Draw,
    Produce,
    ProductionWatch,
    Row,
    ShardTask,
    Tried,
    failed_row,
    shard_path,
)
from slamsim.dataset.store.lazy_table import rows_to_parquet, table_from_parquet, table_to_parquet
from slamsim.dataset.store.store import READERS, Store
from slamsim.guard.errors import SlamsimError
from slamsim.process.worker import WorkerDied

TRIES = 3
"""So often a sequence is tried before it is given up."""
_LOOK_S = 0.5
_BATCHES_LEFT = 4
"""What is left is cut into at least so many tasks for each worker, so that all end together."""


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be made.

    command: what a user types to see the sequence of an index made alone. recorded: the same as
    its row tells it, with nothing in it of where the data set lies.
    """

    count: int
    shard_sequences: int
    draw: Draw
    produce: Produce
    limit_s: float
    command: Callable[[int], str]
    recorded: Callable[[int], str]


@dataclass(frozen=True, slots=True)
class Failure:
    """A sequence that was given up."""

    index: int
    reason: str
    command: str


@dataclass(frozen=True, slots=True)
class DatasetSummary:
    """What a production came to; ``already``: sequences that were there before."""

    address: str
    sequences: int
    already: int
    made: int
    failures: tuple[Failure, ...]
    simulated_s: float
    size_bytes: int
    wall_s: float


class Production:
    """One run over all that is missing in a place; only: over these indices, missing or not."""

    def __init__(
        self,
        order: Order,
        store: Store,
        engine: WorkEngine,
        watch: ProductionWatch,
        only: Sequence[int] | None = None,
    ) -> None:
        self._order, self._store, self._engine, self._watch = order, store, engine, watch
        self._shards: dict[int, dict[int, Row]] = {}
        self._waiting: deque[tuple[int, ...]] = deque()
        self._running: dict[Answer, tuple[int, ...]] = {}
        self._tries: Counter[int] = Counter()
        self._failures: list[Failure] = []
        self._log: dict[int, list[str]] = {}
        self._already = self._made = self._size_bytes = 0
        self._simulated_s = 0.0
        missing = self._survey()
        self._total = order.count if only is None else len(set(only))
        self._missing = missing if only is None else [tuple(dict.fromkeys(only))]

    def left(self) -> int:
        """So many sequences are to be made."""
        return sum(map(len, self._missing))

    def run(self) -> DatasetSummary:
        """Make what is missing.

        Raises what stops a whole production: DiskFull, StoreFailed, Unworkable, SlamsimError
        for an engine that is lost. What was made by then stays, and counts next time.
        """
        begin_s = time.monotonic()
        self._already = self._total - self.left()
        self._watch.begin(self._total, self._already)
        batches = self._batches(self._missing, self.left())
        try:
            while self._fill(batches) or self._running:
                self._collect()
        finally:
            self._write_logs()
        return DatasetSummary(
            address=self._store.address,
            sequences=self._order.count,
            already=self._already,
            made=self._made,
            failures=tuple(sorted(self._failures, key=lambda failure: failure.index)),
            simulated_s=self._simulated_s,
            size_bytes=self._size_bytes,
            wall_s=time.monotonic() - begin_s,
        )

    def _survey(self) -> list[tuple[int, ...]]:
        """Indices by shard; what failed before is tried again."""
        there = self._store.names("shards")
        size, missing = self._order.shard_sequences, []
        starts = range(0, self._order.count, size)
        paths = [shard_path(shard) for shard in range(len(starts))]
        found = (path if path.removeprefix("shards/") in there else None for path in paths)
        with ThreadPoolExecutor(READERS) as readers:
            for shard, table in enumerate(readers.map(self._whole, found)):
                indices = range(starts[shard], min(starts[shard] + size, self._order.count))
                if table is not None and _tells_all_made(table, indices):
                    continue
                known = _made_rows(table)
                if lacking := tuple(index for index in indices if index not in known):
                    self._shards[shard] = known
                    missing.append(lacking)
        return missing

    def _whole(self, path: str | None) -> pa.Table | None:
        """What a shard tells, if it is there and every byte of it as it was written."""
        data = path and self._store.read(path)
        if not data:
            return None
        try:
            table = table_from_parquet(data)
        except ValueError:  # cut while it was written
            return None
        return table if table_to_parquet(table) == data else None

    def _batches(self, missing: list[tuple[int, ...]], left: int) -> Iterator[tuple[int, ...]]:
        """Tasks that grow smaller towards the end, each within one shard."""
        for indices in missing:
            rest = indices
            while rest:
                fair = left // (_BATCHES_LEFT * max(1, self._engine.slots()))
                size = max(1, min(self._engine.batch, fair))
                batch, rest = rest[:size], rest[size:]
                left -= len(batch)
                yield batch

    def _fill(self, batches: Iterator[tuple[int, ...]]) -> bool:
        """Keep every worker busy; True if something was submitted."""
        submitted = False
        while len(self._running) < self._engine.slots():
            indices = self._waiting.popleft() if self._waiting else next(batches, None)
            if indices is None:
                break
            self._running[self._engine.submit(self._task(indices))] = indices
            submitted = True
        return submitted

    def _task(self, indices: tuple[int, ...]) -> ShardTask:
        order, store = self._order, self._store
        return ShardTask(
            store.address,
            order.draw,
            order.produce,
            indices,
            order.limit_s,
            versions(),
            store.staging,
        )

    def _collect(self) -> None:
        done = wait(self._running, _LOOK_S, FIRST_COMPLETED).done
        if not done:
            self._watch.still()
        for answer in done:
            indices = self._running.pop(answer)
            try:
                for tried in answer.result():
                    self._take(tried)
            except WorkerDied as died:
                self._blame(indices, died)
            except CancelledError:
                raise SlamsimError(
                    "the engine is gone; run the same command again to go on"
                ) from None

    def _blame(self, indices: tuple[int, ...], died: WorkerDied) -> None:
        """One alone is the culprit; of several each is tried alone, those made are skipped."""
        if len(indices) > 1:
            self._waiting.extend((index,) for index in indices)
        else:
            self._take(Tried(indices[0], reason=died.reason, trace=died.trace))

    def _take(self, tried: Tried) -> None:
        index = tried.index
        if tried.row is not None:
            self._count(tried, tried.row)
            self._keep(index, tried.row)
            return
        self._tries[index] += 1
        tries = self._tries[index]
        self._note(index, f"try {tries} failed: {tried.reason}\n{tried.trace}".rstrip())
        self._write_logs()
        if tries < TRIES:
            self._watch.tried(index, tried.reason, tries)
            self._waiting.append((index,))
            return
        command = self._order.command(index)
        self._failures.append(Failure(index, tried.reason, command))
        self._watch.failed(index, tried.reason, command)
        recorded = self._order.recorded(index)
        self._keep(index, failed_row(self._order.draw, index, tried.reason, recorded))

    def _count(self, tried: Tried, row: Row) -> None:
        self._watch.made(tried)
        if tried.old:
            self._already += 1
            return
        self._made += 1
        self._size_bytes += int(str(row["size_bytes"]))
        self._simulated_s += float(str(row.get("quality.duration_s") or 0.0))
        self._note(tried.index, f"made in {tried.wall_s:.2f} s")

    def _keep(self, index: int, row: Row) -> None:
        """Write the file of the shard once all its rows are known."""
        shard = index // self._order.shard_sequences
        rows = self._shards.get(shard)
        if rows is None:
            return
        rows[index] = row
        first = shard * self._order.shard_sequences
        if len(rows) < min(self._order.shard_sequences, self._order.count - first):
            return
        ordered = [rows[index] for index in sorted(rows)]
        self._store.write(shard_path(shard), rows_to_parquet(ordered))
        del self._shards[shard]
        self._write_logs()

    def _note(self, index: int, text: str) -> None:
        at = datetime.now(UTC).isoformat(timespec="seconds")
        shard = index // self._order.shard_sequences
        self._log.setdefault(shard, []).append(f"{at} {index:06d} {text}\n")

    def _write_logs(self) -> None:
        for shard, lines in self._log.items():
            self._store.append(f"logs/{shard:05d}.log", "".join(lines))
        self._log.clear()


def _tells_all_made(shard: pa.Table, indices: range) -> bool:
    """Without making a Python object of every cell."""
    is_made = pc.all(pc.equal(shard["status"], MADE)).as_py()
    return bool(is_made) and shard["index"].to_pylist() == list(indices)


def _made_rows(shard: pa.Table | None) -> dict[int, Row]:
    rows = [] if shard is None else shard.to_pylist()
    return {int(str(row["index"])): row for row in rows if row["status"] == MADE}
