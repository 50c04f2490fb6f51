"""Storage of a data set: a local folder, or any URL that fsspec supports.

Nothing half-written ever counts. In a folder, a sequence is written in the staging folder of the
run, which lies inside the data set (that may be a disk of its own, and the only one that workers
see), and renamed when it is whole and on the disk. Elsewhere it is made in a temporary folder and
uploaded, its ``sequence.json`` last; readers take one that is not whole for absent.
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

from slamsim.guard.errors import Locked, NotFound, SlamsimError, StoreFailed, shown
from slamsim.guard.files import open_as_found, own_file
from slamsim.guard.lock import claimed, locked, staging_of
from slamsim.guard.output import free_bytes, sync_tree, write_atomic, written_to
from slamsim.guard.seal import SEQUENCE, files_in
from slamsim.guard.staging import is_staging, make_staging, remove_staging, sync

READERS = 16
"""An object store answers slowly, but many at a time."""

_WORKERS_LOCK = "workers"
_ORPHANS_END_S = 10.0
"""So long a run waits for the workers of one that was killed; they are killed with it, but a
worker of another machine first finishes what it has."""


class Store(Protocol):
    """A data set's files; paths are relative to it, with ``/``.

    All raise StoreFailed when the place cannot be read or written, DiskFull when it is full.
    """

    address: str
    staging: str
    """The name of the run's staging folder in it, if it has one; workers are told."""

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


def open_store(address: str, staging: str = "") -> Store:
    """The store at a local path or a URL such as ``s3://bucket/set``. Raises SlamsimError.

    staging: what the store of the run says, for its workers.
    """
    return _connected(address) if "://" in address else LocalStore(address, staging)


def claimed_place(address: str) -> AbstractContextManager[None]:
    """Keep a folder for a run in the block, and raise Locked now rather than then."""
    return nullcontext() if "://" in address else LocalStore(address).claimed()


@lru_cache(maxsize=8)
def _connected(address: str) -> Store:
    from slamsim.dataset.store.remote import RemoteStore

    return RemoteStore(address)


class LocalStore:
    """A folder of this machine, or of a file system that several machines share."""

    def __init__(self, address: str, staging: str = "") -> None:
        if not address:
            raise SlamsimError("the name of the folder is empty; '.' is the one we are in")
        try:
            self._root = Path(address).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise SlamsimError(f"{address!r} cannot be written: {error}") from None
        self.address, self.staging = str(self._root), staging

    def read(self, path: str) -> bytes | None:
        try:
            with open_as_found(self._own(path)) as file:
                return file.read()
        except NotFound:
            return None

    def write(self, path: str, data: bytes) -> None:
        file = self._own(path)
        write_atomic(file, data, self._staging() if self.staging else None)

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
            found = frozenset(os.listdir(self._own(folder)))  # noqa: PTH208 - a million names
            left = None if folder else staging_of(self._root)
            return found - {left.name} if left and is_staging(left) else found
        except FileNotFoundError:
            return frozenset()
        except NotADirectoryError:
            raise SlamsimError(f"{self._root / folder} is a file; choose another name") from None

    @contextmanager
    def working_folder(self, name: str) -> Iterator[Path]:
        prefix = f"{name.replace('/', '-')}.{socket.gethostname()}-{os.getpid()}."
        with written_to(self._root):
            folder = Path(tempfile.mkdtemp(prefix=prefix, dir=self._staging()))
            folder.chmod(0o755)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def publish(self, folder: Path, name: str) -> None:
        """A sequence that another worker has put there meanwhile stays: it is the same.

        Raises SlamsimError rather than replace a folder that holds other files.
        """
        final = self._own(name)
        with written_to(final):
            sync_tree(folder)
            final.parent.mkdir(parents=True, exist_ok=True)
            if final.is_dir():
                if self.read(f"{name}/{SEQUENCE}") == (folder / SEQUENCE).read_bytes():
                    return
                if others := sorted({*files_in(final)} - {*files_in(folder)}):
                    raise SlamsimError(
                        f"{final} is to be made again and holds {shown(others[0])}, "
                        "which is no part of it; move that away"
                    )
                shutil.rmtree(final)
            folder.rename(final)
            sync(final.parent)

    def free_bytes(self) -> int | None:
        return free_bytes(self._root)

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep it for an ``owned`` in the block. Raises what that raises."""
        with ExitStack() as held:
            with written_to(self._root):
                held.enter_context(claimed(self._root, self._put_away, inside=True))
            yield

    @contextmanager
    def owned(self) -> Iterator[None]:
        with ExitStack() as leaving:
            with written_to(self._root):
                staging = leaving.enter_context(locked(self._root, self._put_away, inside=True))
            if not self._root.exists():
                leaving.callback(self._remove_if_empty)
            leaving.callback(self._clear, staging)
            with written_to(self._root):
                make_staging(staging, self._root)
            self.staging = staging.name
            yield

    @contextmanager
    def used(self) -> Iterator[None]:
        with written_to(self._root):
            path = self._staging() / _WORKERS_LOCK
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_SH)
            yield
        finally:
            with suppress(OSError):  # nothing was written to it
                os.close(lock)

    def _staging(self) -> Path:
        """Where the run has its unfinished work, which is gone when the run is."""
        staging = self._root / self.staging
        if not self.staging or not is_staging(staging):
            raise StoreFailed(f"the run that makes the data set {self._root} is over")
        return staging

    def _put_away(self, staging: Path) -> None:
        """What a run left that was killed, once its workers are done too."""
        self._wait_for_workers(staging / _WORKERS_LOCK)
        remove_staging(staging)

    def _wait_for_workers(self, lock: Path) -> None:
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            return
        end_s = time.monotonic() + _ORPHANS_END_S
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

    def _clear(self, staging: Path) -> None:
        """What cannot be removed now is when the next run begins."""
        self.staging = ""
        with suppress(OSError):
            remove_staging(staging)

    def _remove_if_empty(self) -> None:
        with suppress(OSError):
            self._root.rmdir()


def _taken(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
