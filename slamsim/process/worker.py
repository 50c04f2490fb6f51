"""Worker processes: one core each, a memory limit, and replacement after a crash.

Work that crashes, hangs or eats all memory ends its own process and nothing else. Each is a
pebble pool of one: the workers of a larger pool share a pipe and its locks, and one that is
killed at the wrong moment takes the others with it.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Lock, local
from typing import Self, TypeVar

from pebble import ProcessExpired, ProcessPool

from slamsim.guard.errors import SlamsimError
from slamsim.process.children import Halted, Patience, end_with_parent
from slamsim.process.instructions import settle_instructions

Result = TypeVar("Result")

_ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
_LOOK_S = 0.2
"""How often a task that runs looks whether it is to be stopped."""
_NOTICED_S = 2.0
"""Within this pebble tells of a process that is gone, if it does at all."""
_STARTS = 3
_SHARE_OF_MEMORY = 0.9
"""The rest is for the process that started them, and for the system."""
_PRINTED = "printed.txt"
_OUT_OF_MEMORY = "out of memory"
_TRACE_CHARACTERS = 4000


class WorkerDied(Exception):
    """The process ended during its work: which part of it that was at is unknown.

    reason: how, in words that do not depend on where it was. trace: its memory limit, and what it
    printed last.
    """

    def __init__(self, reason: str, trace: str = "") -> None:
        super().__init__(reason, trace)
        self.reason, self.trace = reason, trace


class Unworkable(SlamsimError):
    """What stops a whole run, for no other work would fare better."""


class Worker:
    """Belongs to one thread: with that thread its process dies."""

    def __init__(self, memory_bytes: int) -> None:
        self._memory_bytes = memory_bytes
        self._stopped = Event()
        self._busy = Lock()
        self._pool: ProcessPool | None = None
        self._process = 0
        self._folder: TemporaryDirectory[str] | None = None

    def run(self, work: Callable[[], Result], limit_s: float) -> Result:
        """What the work returns, done in the process. Raises what it raises, and WorkerDied.

        work: can be pickled. limit_s: what ``time_limit`` is set to in it.
        """
        with self._busy:
            if self._pool is not None and not self._pool.active:
                self._end()  # its process died while it had nothing to do
            if self._pool is None:
                self._start()
            return self._run(work, limit_s)

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def stop(self) -> None:
        """From any thread: end what runs now; no more will be made."""
        self._stopped.set()

    def close(self) -> None:
        """End the process, once it was stopped or has nothing to do."""
        with self._busy:
            self._end()

    def _run(self, work: Callable[[], Result], limit_s: float) -> Result:
        try:
            return self._waited(work)
        except (ProcessExpired, BrokenProcessPool, TimeoutError) as error:
            died = WorkerDied(self._why(error, limit_s), self._trace())
            self._end()
            raise died from None
        except MemoryError:
            died = WorkerDied(_OUT_OF_MEMORY, self._trace())
            self._end()
            raise died from None

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
            self._pool, self._process = None, 0
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _start(self) -> None:
        """Raises Unworkable if a process does not even begin."""
        settle_instructions()
        for _ in range(_STARTS):
            self._folder = TemporaryDirectory(prefix="slamsim-worker-", ignore_cleanup_errors=True)
            self._pool = ProcessPool(
                max_workers=1,
                initializer=_settle,
                initargs=(os.getpid(), self._folder.name, self._memory_bytes),
                context=get_context("spawn"),
            )
            try:
                self._process = self._waited(os.getpid)
                return
            except (ProcessExpired, BrokenProcessPool):
                printed = self._printed()
                self._end()
        raise Unworkable(f"no worker process can be started here: {printed or 'it ends at once'}")

    def _waited(self, work: Callable[[], Result]) -> Result:
        assert self._pool is not None
        future, patience = self._pool.schedule(work), Patience(self._process)
        while not wait((future,), _LOOK_S).done:
            if self._stopped.is_set():
                self._end()
                raise WorkerDied("stopped")
            if self._process and not _runs(self._process):
                # pebble takes an exit with code 0 for a worker's own end: its task stays open
                wait((future,), _NOTICED_S)
                break
            try:
                patience.look(_LOOK_S)
            except Halted as halted:
                self._end()
                raise WorkerDied(f"its process {halted}") from None
        return future.result(0.0)

    def _why(self, error: Exception, limit_s: float) -> str:
        code = error.exitcode if isinstance(error, ProcessExpired) else None
        if code == -signal.SIGALRM:
            return f"it took longer than {limit_s:g} s"
        if code is not None and code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        if "bad_alloc" in self._printed() or "MemoryError" in self._printed():
            return _OUT_OF_MEMORY
        return "its process ended" if code is None else f"its process ended with code {code}"

    def _trace(self) -> str:
        limit = f"a worker has {self._memory_bytes / 1e6:,.0f} MB of memory"
        return f"{limit}\n{self._printed()}".rstrip()

    def _printed(self) -> str:
        """What the process wrote on its way out, its Python stack after a crash above all."""
        assert self._folder is not None
        try:
            text = (Path(self._folder.name) / _PRINTED).read_text(errors="replace")
        except OSError:
            return ""
        return text.partition("\nExtension modules:")[0][-_TRACE_CHARACTERS:]


class Workers:
    """As many processes as there are workers, each with a thread here that waits for it.

    count: as many as there are cores for us, if none is given. memory_bytes: the most that one
    may have; without it, its share of the machine's. None outlives the ``with`` block.
    """

    def __init__(self, count: int | None = None, memory_bytes: int | None = None) -> None:
        self.count = count or cores()
        self._memory_bytes = memory_bytes or fair_share_bytes(self.count)
        self._own = local()
        self._workers: list[Worker] = []
        self._threads = ThreadPoolExecutor(self.count, "worker", self._begin)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.stop()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.close()

    def submit(self, work: Callable[[], Result], limit_s: float) -> Future[Result]:
        """What ``Worker.run`` returns and raises, by whichever is free first."""
        return self._threads.submit(self._run, work, limit_s)

    def _begin(self) -> None:
        self._own.worker = Worker(self._memory_bytes)
        self._workers.append(self._own.worker)

    def _run(self, work: Callable[[], Result], limit_s: float) -> Result:
        worker: Worker = self._own.worker
        return worker.run(work, limit_s)


@contextmanager
def time_limit(limit_s: float) -> Iterator[None]:
    """End this process if the block takes longer, whatever native code it is in."""
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def fair_share_bytes(workers: int) -> int:
    """What each of so many may have of the machine's memory, or of our control group's."""
    machine: int = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):
        machine = min(machine, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return int(machine * _SHARE_OF_MEMORY / workers)


def cores() -> int:
    """Those of this machine that we may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def _settle(parent: int, folder: str, memory_bytes: int) -> None:
    """What a new process does first, before it loads any library that computes."""
    end_with_parent(parent)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    tempfile.tempdir = folder
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    printed = os.open(Path(folder) / _PRINTED, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(printed, 1)
    os.dup2(printed, 2)
    faulthandler.enable()
