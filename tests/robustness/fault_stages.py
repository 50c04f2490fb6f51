"""All that writes, each as one command that takes a fraction of a second.

Here on made-up data; ``fault_recorded`` has the commands whose data must be computed first. What is
written, and how, is the package's own doing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import dataset_run
import log_data
import numpy as np

from slamsim.dataset.catalogue.statistics import MANIFEST, manifest
from slamsim.dataset.make.engines.local import Answer
from slamsim.dataset.make.identity import IDENTITY
from slamsim.dataset.make.shard import ShardTask, make_sequences
from slamsim.dataset.store.lazy_table import table_from_parquet, table_to_parquet
from slamsim.dataset.store.store import Store
from slamsim.guard.output import partial_file, partial_folder, write_atomic
from slamsim.guard.seal import SUMS, sums_text
from slamsim.io.parquet.file import Column, ParquetFile
from slamsim.simulation.log_writer import LogWriter

LOG = "log"
Work = Callable[[Path], object]


@dataclass(frozen=True)
class Stage:
    """A command that writes to the path it is given, and what was done to that path before.

    in_parts: whether what it makes may be there in parts until it has succeeded. varies: files
    that have other bytes each time.
    """

    name: str
    work: Work
    before: Work | None = None
    in_parts: bool = False
    varies: tuple[str, ...] = ()

    def prepared(self, place: Path) -> Path:
        """The path to write to, in a new folder ``place``, as it stands before the command."""
        place.mkdir()
        out = place / "out"
        if self.before is not None:
            self.before(out)
        return out


def contents(out: Path) -> dict[str, bytes]:
    """All files under a path with their bytes, logs of productions and unfinished work left out."""
    if out.is_dir():
        files = dataset_run.tree(out).items()
        return {name: data for name, data in files if not _is_unfinished(Path(name))}
    return {"": out.read_bytes()} if out.exists() else {}


def _is_unfinished(path: Path) -> bool:
    return path.parts[0].startswith(".slamsim-")


def folder_of(text: str, out: Path) -> None:
    with partial_folder(out, overwrite=True) as folder:
        (folder / "log").mkdir()
        (folder / "log" / "data").write_text(text * 3000)
        write_atomic(folder / "map.pgm", text.encode())


def _file(text: str, out: Path) -> None:
    with partial_file(out, overwrite=True) as unfinished:
        unfinished.write_text(text)


def _log(out: Path) -> None:
    with partial_folder(out) as folder, LogWriter(folder / LOG, log_data.header()) as log:
        for start_s in (0.0, 0.2):
            end_s = start_s + 0.2
            log.write(log_data.readings(start_s, end_s), log_data.drive(start_s, end_s))


def _table(out: Path) -> None:
    columns = (Column("stamp_ns", "int64"), Column("x_m", "float64", width=3))
    with (
        partial_folder(out) as folder,
        ParquetFile(folder / "table.parquet", columns, {"of": "a test"}, 50) as table,
    ):
        for start in (0, 100):
            stamps = np.arange(start, start + 100)
            table.append({"stamp_ns": stamps, "x_m": np.repeat(stamps[:, None] * 0.1, 3, axis=1)})


class Inline:
    """An engine that works in this very process."""

    batch = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...

    def slots(self) -> int:
        return 1

    def submit(self, task: ShardTask) -> Answer:
        answer: Answer = Future()
        try:
            answer.set_result(make_sequences(task))
        except Exception as error:
            answer.set_exception(error)
        return answer


def _catalogue(store: Store) -> None:
    """As ``write_catalogue``, with a few bytes in place of figures and data card."""
    names = sorted(name for name in store.names("shards") if not name.startswith("."))
    shards = [f"shards/{name}" for name in names]
    tables = [table_from_parquet(store.read(path) or b"") for path in shards]
    table = manifest(tables, {"slamsim": "1"})
    files = {MANIFEST: table_to_parquet(table), "README.md": b"%d sequences\n" % table.num_rows}
    for path, data in files.items():
        store.write(path, data)
    every = (IDENTITY, *files, *shards)
    hashes = {path: hashlib.sha256(store.read(path) or b"").hexdigest() for path in every}
    store.write(SUMS, sums_text(hashes).encode())


def dataset_of(count: int, out: Path) -> None:
    """Stub sequences, each in a place of its own, and what stands beside them."""
    dataset_run.make(out, out.parent, count, Inline(), catalogue=_catalogue)


FOLDERS = (
    Stage("a new folder", partial(folder_of, "new")),
    Stage("a folder replaced", partial(folder_of, "new"), partial(folder_of, "old")),
    Stage("a new file", partial(_file, "new")),
    Stage("a file replaced", partial(_file, "new"), partial(_file, "old")),
)
WRITERS = (Stage("a log", _log), Stage("a table", _table))
SETS = (
    Stage("a data set", partial(dataset_of, 3), in_parts=True),
    Stage("a data set grown", partial(dataset_of, 3), partial(dataset_of, 1), in_parts=True),
)
