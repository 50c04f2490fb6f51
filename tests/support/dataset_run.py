"""Productions of stub sequences, in this process or as a command that can be killed.

``python dataset_run.py OUT ORDERS COUNT WORKERS SECONDS`` is the command.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from dataset_stub import Stub, draw

from slamsim.dataset.make.engines.local import LocalEngine, WorkEngine
from slamsim.dataset.make.identity import Identity
from slamsim.dataset.make.make import execute
from slamsim.dataset.make.production import DatasetSummary, Order
from slamsim.dataset.make.shard import ProductionWatch, Unwatched
from slamsim.dataset.store.store import Store, open_store
from slamsim.process.exit_codes import run_command

SHARD = 4


def make(
    out: Path | str,
    orders: Path,
    count: int,
    engine: WorkEngine | None = None,
    *,
    seconds: float = 0.0,
    limit_s: float = 60.0,
    watch: ProductionWatch | None = None,
    only: Sequence[int] | None = None,
    catalogue: Callable[[Store], None] | None = None,
    **recipe: object,
) -> DatasetSummary:
    order = Order(
        count=count,
        shard_sequences=SHARD,
        draw=draw,
        produce=Stub(orders, seconds),
        limit_s=limit_s,
        command=lambda index: f"make --out {out} --only {index}",
        recorded=lambda index: f"make --only {index}",
    )
    identity = Identity("stub", count, {"seed": 1, **recipe})
    engine = engine or LocalEngine(1, 2 * 10**9)
    store, watch = open_store(str(out)), watch or Unwatched()
    return execute(order, identity, store, engine, watch, only=only, catalogue=catalogue)


def start(
    out: Path | str, orders: Path, count: int, workers: int, seconds: float
) -> subprocess.Popen[str]:
    """The command, in a session of its own, so that Ctrl-C can be sent to all of it."""
    words = map(str, (out, orders, count, workers, seconds))
    return subprocess.Popen(
        [sys.executable, __file__, *words],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def children(process: int) -> list[int]:
    """Processes whose parent this one is."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            found.append(int(status.parent.name))
    return found


def workers_of(process: int) -> list[int]:
    """Its worker processes, without the one that keeps book of semaphores."""
    found = []
    for child in children(process):
        try:
            words = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            continue
        if b"spawn_main" in words:
            found.append(child)
    return found


def runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def end(process: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, number)


def tree(folder: Path) -> dict[str, bytes]:
    """All files but the logs."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.relative_to(folder).parts[0] != "logs"
    }


def _main(out: str, orders: str, count: str, workers: str, seconds: str) -> int:
    engine = LocalEngine(int(workers))
    return run_command(lambda: make(out, Path(orders), int(count), engine, seconds=float(seconds)))


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
