"""What a worker does: sequences made one after the other, those already there skipped.

A shard is a row of sequences that share one file of the catalogue, ``shards/NNNNN.parquet``,
written once all of them are made or have failed for good. Which sequences a worker is given at a
time changes nothing in any file.
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Protocol

from slamsim.dataset.make.identity import difference, versions
from slamsim.dataset.recipe.sequence import Cell, SequenceFacts, SequenceSpec
from slamsim.dataset.store.store import Store, open_store
from slamsim.guard.errors import DiskFull, SlamsimError, StoreFailed, reason_of
from slamsim.guard.output import disk_full, write_atomic
from slamsim.guard.seal import SEQUENCE, SumsDamaged, read_sequence, sequence_text, sha256_of
from slamsim.process.worker import Unworkable, time_limit

MADE, FAILED = "made", "failed"
LIMIT_S = 1800.0
"""A sequence that takes longer is ended and counts as failed."""

Draw = Callable[[int], SequenceSpec]
Produce = Callable[[SequenceSpec, Path], SequenceFacts]
Row = dict[str, Cell]


@dataclass(frozen=True, slots=True)
class ShardTask:
    """What a worker is sent; everything in it can be pickled.

    address: where the data set lies. draw: the sequence of an index, a pure function. produce:
    makes one in a folder. limit_s: a sequence that takes longer ends its process. versions: what
    the worker must run on, too. staging: what the store of the run says.
    """

    address: str
    draw: Draw
    produce: Produce
    indices: tuple[int, ...]
    limit_s: float
    versions: Mapping[str, str]
    staging: str = ""


@dataclass(frozen=True, slots=True)
class Tried:
    """One attempt at one sequence: its row if it is there, else reason and trace.

    old: it was there before.
    """

    index: int
    wall_s: float = 0.0
    row: Row | None = None
    old: bool = False
    reason: str = ""
    trace: str = ""


def shard_path(shard: int) -> str:
    return f"shards/{shard:05d}.parquet"


def make_sequences(task: ShardTask) -> tuple[Tried, ...]:
    """Make those that are not there yet, in order.

    Raises Unworkable if the worker runs other software, DiskFull, or StoreFailed if the place
    cannot be read or written. What a sequence raises is told in its own ``Tried``.
    """
    if found := difference(task.versions, versions()):
        raise Unworkable(f"a worker has {found}; give all workers the same software")
    store = open_store(task.address, task.staging)
    with store.used():
        return tuple(_try(store, task, index) for index in task.indices)


def made_row(spec: SequenceSpec, mark: bytes) -> Row | None:
    """The row of a sequence by its ``sequence.json``; nothing if that is damaged or another's."""
    try:
        facts = read_sequence(mark)
        files = facts["files"]
        if facts["index"] != spec.index or facts["name"] != spec.name:
            return None
        size_bytes = sum(file["size_bytes"] for file in files)
        quality = {f"quality.{name}": value for name, value in facts["quality"].items()}
    except (SumsDamaged, KeyError, TypeError):
        return None
    return {
        **_drawn_row(spec),
        **quality,
        "files": len(files),
        "size_bytes": size_bytes + len(mark),
        "sha256": sha256_of(mark),
        "status": MADE,
        "reason": None,
        "command": None,
    }


def failed_row(draw: Draw, index: int, reason: str, command: str) -> Row:
    """The row of a sequence that could not be made, and how to see it fail again."""
    try:
        row = _drawn_row(draw(index))
    except SlamsimError:  # it could not even be drawn, as the reason says
        row = {"index": index}
    return {**row, "status": FAILED, "reason": reason, "command": command}


def _drawn_row(spec: SequenceSpec) -> Row:
    faults = (f"{one.name}:{one.size:g}" if one.size else one.name for one in spec.config.faults)
    return {
        "index": spec.index,
        "name": spec.name,
        "split": spec.split,
        "world_index": spec.world_index,
        "seed": spec.config.seed,
        "faults": ",".join(faults),
        **{f"drawn.{path}": value for path, value in spec.drawn.items()},
    }


def _try(store: Store, task: ShardTask, index: int) -> Tried:
    begin_s = time.monotonic()
    places = [tempfile.gettempdir()]
    try:
        spec = task.draw(index)
        if row := _row_of_old(store, spec):
            return Tried(index, row=row, old=True)
        with store.working_folder(spec.name) as folder:
            places.insert(0, str(folder))
            row = _make(store, task, spec, folder)
    except (StoreFailed, MemoryError):  # after which the process is not to be trusted
        raise
    except Exception as error:
        if full := disk_full(error):
            raise DiskFull(f"{task.address}: {full}") from None
        wall_s = time.monotonic() - begin_s
        return Tried(index, wall_s, reason=_reason(error, places), trace=_trace(error))
    return Tried(index, time.monotonic() - begin_s, row)


def _row_of_old(store: Store, spec: SequenceSpec) -> Row | None:
    mark = store.read(f"{spec.name}/{SEQUENCE}")
    return None if mark is None else made_row(spec, mark)


def _make(store: Store, task: ShardTask, spec: SequenceSpec, folder: Path) -> Row | None:
    with time_limit(task.limit_s):
        facts = task.produce(spec, folder)
    mark = sequence_mark(spec, facts)
    write_atomic(folder / SEQUENCE, mark)
    store.publish(folder, spec.name)
    return made_row(spec, mark)


def sequence_mark(spec: SequenceSpec, facts: SequenceFacts) -> bytes:
    """The contents of ``sequence.json``."""
    told = {
        "index": spec.index,
        "name": spec.name,
        "split": spec.split,
        "world_index": spec.world_index,
        "seed": spec.config.seed,
        "formats": list(spec.formats),
        "drawn": dict(spec.drawn),
        "quality": dict(facts.quality),
        "files": [
            {"path": file.path, "size_bytes": file.size_bytes, "sha256": file.sha256}
            for file in facts.files
        ],
    }
    return sequence_text(told).encode()


def _reason(error: Exception, places: Sequence[str]) -> str:
    """Without the folders that it happened in, which are others each time."""
    return reduce(lambda told, place: told.replace(f"{place}/", ""), places, reason_of(error))


def _trace(error: Exception) -> str:
    return "" if isinstance(error, SlamsimError) else "".join(traceback.format_exception(error))


class ProductionWatch(Protocol):
    """A listener; called from the thread that runs the production."""

    def begin(self, total: int, already: int) -> None:
        """So many sequences there are to be; so many of them were there."""

    def made(self, tried: Tried) -> None:
        """One more is there."""

    def tried(self, index: int, reason: str, tries: int) -> None:
        """One did not succeed and will be tried again."""

    def failed(self, index: int, reason: str, command: str) -> None:
        """One is given up."""

    def still(self) -> None:
        """Nothing has happened for a moment."""

    def catalogue(self) -> None:
        """Every sequence is there or given up; now what stands beside them is written."""


class Unwatched:
    """The listener that does nothing."""

    def begin(self, total: int, already: int) -> None: ...

    def made(self, tried: Tried) -> None: ...

    def tried(self, index: int, reason: str, tries: int) -> None: ...

    def failed(self, index: int, reason: str, command: str) -> None: ...

    def still(self) -> None: ...

    def catalogue(self) -> None: ...
