"""Where a data set lies: a local folder, or any place that fsspec knows by a URL.

Nothing half-written ever counts. In a folder, a sequence is written beside its final name and
renamed when it is whole and on the disk. Elsewhere it is made in a temporary folder and uploaded,
its ``sequence.json`` last; whoever reads it there takes one that is not whole for absent.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from slamsim.safe.errors import Locked, NotFound, SlamsimError
from slamsim.safe.files import open_as_found, own_file
from slamsim.safe.lock import claimed, folder_lock
from slamsim.safe.output import (
    free_bytes,
    sync,
    sync_tree,
    write_atomic,
    written_to,
)
from slamsim.safe.sums import SEQUENCE

READERS = 16
"""An object store answers slowly, but many at a time."""

_WORK, _WORKERS_LOCK = ".partial", "lock"
_ORPHANS_END_S = 10.0
"""So long a run waits for the workers of one that was killed; they are killed with it, but a
worker of another machine first finishes what it has."""


class StoreFailed(SlamsimError):
    """The place of a data set cannot be read or written: no fault of any sequence."""


class Store(Protocol):
    """A data set's files; paths are relative to it, with ``/``.

    All raise StoreFailed when the place cannot be read or written, DiskFull when it is full.
    """

    address: str

    def read(self, path: str) -> bytes | None:
        """The whole file, or nothing if there is none."""

    def write(self, path: str, data: bytes) -> None:
        """A file: whole, or as it was before."""

    def remove(self, path: str) -> None:
        """A file, if it is there."""

    def append(self, path: str, text: str) -> None:
        """More lines of a log, which is no part of the data."""

    def names(self, folder: str) -> frozenset[str]:
        """Names of the files and folders in a folder; none if it is not there."""

    def working_folder(self, name: str) -> AbstractContextManager[Path]:
        """An empty folder of this process to make a sequence in; it is gone after the block."""

    def publish(self, folder: Path, name: str) -> None:
        """Put a working folder in its place, its ``sequence.json`` last."""

    def free_bytes(self) -> int | None:
        """How much more there is room for, where that is known."""

    def owned(self) -> AbstractContextManager[None]:
        """Held by a whole run; raises Locked while another run, or a worker of it, is there."""

    def used(self) -> AbstractContextManager[None]:
        """Held by a worker while it writes."""


def open_store(address: str) -> Store:
    """The store at a local path or a URL such as ``s3://bucket/set``. Raises SlamsimError."""
    return _connected(address) if "://" in address else LocalStore(address)


def claimed_place(address: str) -> AbstractContextManager[None]:
    """Keep a folder for a run in the block, and raise Locked now rather than then."""
    return nullcontext() if "://" in address else claimed(Path(LocalStore(address).address))


@lru_cache(maxsize=8)
def _connected(address: str) -> Store:
    from slamsim.dataset.remote import RemoteStore

    return RemoteStore(address)


class LocalStore:
    """A folder of this machine, or of a file system that several machines share."""

    def __init__(self, address: str) -> None:
        if not address:
            raise SlamsimError("the name of the folder is empty; '.' is the one we are in")
        try:
            self._root = Path(address).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise SlamsimError(f"{address!r} cannot be written: {error}") from None
        self.address = str(self._root)

    def read(self, path: str) -> bytes | None:
        try:
            with open_as_found(self._own(path)) as file:
                return file.read()
        except NotFound:
            return None

    def write(self, path: str, data: bytes) -> None:
        write_atomic(self._own(path), data)

    def remove(self, path: str) -> None:
        file = self._own(path)
        with written_to(file):
            file.unlink(missing_ok=True)
            sync(file.parent)

    def append(self, path: str, text: str) -> None:
        file = self._own(path)
        with written_to(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            with file.open("a", encoding="utf-8") as log:
                log.write(text)

    def names(self, folder: str) -> frozenset[str]:
        try:
            return frozenset(os.listdir(self._own(folder)))  # noqa: PTH208 - a million names
        except FileNotFoundError:
            return frozenset()
        except NotADirectoryError:
            raise SlamsimError(f"{self._root / folder} is a file; choose another name") from None

    @contextmanager
    def working_folder(self, name: str) -> Iterator[Path]:
        parent = self._own(_WORK)
        prefix = f"{name.replace('/', '-')}.{socket.gethostname()}-{os.getpid()}."
        with written_to(self._root):
            parent.mkdir(parents=True, exist_ok=True)
            folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
            folder.chmod(0o755)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def publish(self, folder: Path, name: str) -> None:
        """A sequence that another worker has put there meanwhile stays: it is the same."""
        final = self._own(name)
        with written_to(final):
            sync_tree(folder)
            final.parent.mkdir(parents=True, exist_ok=True)
            if final.is_dir():
                if self.read(f"{name}/{SEQUENCE}") == (folder / SEQUENCE).read_bytes():
                    return
                shutil.rmtree(final)
            folder.rename(final)
            sync(final.parent)

    def free_bytes(self) -> int | None:
        return free_bytes(self._root)

    @contextmanager
    def owned(self) -> Iterator[None]:
        with ExitStack() as leaving:
            with written_to(self._root):
                leaving.enter_context(folder_lock(self._root))
                self._wait_for_workers()
            self._clear_work()
            leaving.callback(self._clear_work)
            yield

    @contextmanager
    def used(self) -> Iterator[None]:
        work = self._own(_WORK)
        with written_to(self._root):
            work.mkdir(parents=True, exist_ok=True)
            lock = os.open(work / _WORKERS_LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_SH)
            yield
        finally:
            with suppress(OSError):  # nothing was written to it
                os.close(lock)

    def _wait_for_workers(self) -> None:
        lock = self._own(f"{_WORK}/{_WORKERS_LOCK}")
        if not lock.exists():
            return
        end_s = time.monotonic() + _ORPHANS_END_S
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC)
        try:
            while not _taken(descriptor):
                if time.monotonic() > end_s:
                    raise Locked(
                        f"workers of an earlier run still write to {self._root}; "
                        "try again when they are done"
                    )
                time.sleep(0.1)
        finally:
            os.close(descriptor)

    def _own(self, path: str) -> Path:
        """InputRefused for a link that leads out of the data set."""
        return own_file(self._root, path)

    def _clear_work(self) -> None:
        shutil.rmtree(self._root / _WORK, ignore_errors=True)


def _taken(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
