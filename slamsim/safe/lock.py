"""One writer for each folder: a lock beside it, which vanishes with the process that holds it."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path

from slamsim.safe.errors import Locked

_OPENED = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC

_SOMEBODY = "another process"

_claimed: set[Path] = set()
"""What this process has locked, and nothing in it writes to yet."""


@contextmanager
def claimed(final: Path) -> Iterator[None]:
    """Hold the lock of a folder for a ``folder_lock`` in the block. Raises what that raises."""
    with folder_lock(final):
        _claimed.add(final)
        try:
            yield
        finally:
            _claimed.discard(final)


@contextmanager
def folder_lock(final: Path) -> Iterator[None]:
    """Hold ``<final>.lock``: it vanishes with the process, however that ends.

    final: absolute; the folders above it are made, and go again if nothing was put into them.
    Raises Locked while another process holds it, or another block of this one, and OSError.
    """
    if final in _claimed:
        _claimed.remove(final)
        try:
            yield
        finally:
            _claimed.add(final)
        return
    missing = list(takewhile(lambda folder: not folder.exists(), final.parents))
    path = final.with_name(f"{final.name}.lock")
    descriptor = _locked(final, path)
    try:
        yield
    finally:
        with suppress(OSError):  # a file without its holder locks nobody out
            path.unlink(missing_ok=True)
        with suppress(OSError):
            os.close(descriptor)
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()


def held(path: Path) -> int:
    """The descriptor of a file, made if need be, that is locked until it is closed.

    It is the file itself, never what a link leads to: its name could have been foreseen.
    Raises BlockingIOError while somebody else holds it, and OSError.
    """
    while True:
        descriptor = os.open(path, _OPENED, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The holder before us may have removed the file between our open and our flock.
            if os.path.samestat(os.fstat(descriptor), path.stat(follow_symlinks=False)):
                return descriptor
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _locked(final: Path, path: Path) -> int:
    """The descriptor that holds the lock, and the file tells whose it is."""
    while True:
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            descriptor = held(path)
            break
        except FileNotFoundError:
            continue  # the folder was empty, and gone again
        except BlockingIOError:
            raise Locked(f"{final} is being written by {_owner(path)}") from None
    with suppress(OSError):  # on a full disk nobody is told whose it is
        os.truncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    return descriptor


def _owner(path: Path) -> str:
    with suppress(OSError):
        return path.read_bytes()[:200].decode(errors="replace").strip() or _SOMEBODY
    return _SOMEBODY
