"""One writer per output name: the lock file, the staging folder, and the protocol of every output.

While NAME is written, ``.NAME.slamsim-lock`` lies beside it. Its writer holds the flock of that
file, which vanishes with the process however that ends. One line of JSON in it says whose it is
and names the staging folder that belongs to it: ``.NAME.slamsim-<16 random hex digits>`` beside
NAME, or, for a data set, ``.slamsim-<...>`` inside it.

1. The lock gets its name, its content and its flock in one step, and before anything is staged.
   So a file of that name without our words is never ours: it is refused, and left as it is.
2. What is unfinished lies in the staging folder, beside a marker: ``new`` is what is being made,
   ``old`` what it replaces, for the moment between two renames.
3. When it is whole, ``new`` and NAME are exchanged; then the staging folder is removed, and then
   the lock file.
4. A lock file that is not locked was left by a process that was killed. The next writer of NAME
   holds it while it puts ``old`` back if NAME is gone, and removes the staging folder that is
   named there; then it removes the file, and begins at 1. Nothing else is looked for, and so
   nothing else is found: no other name beside NAME is ever opened, renamed or removed.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import secrets
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path

from slamsim.guard.errors import Locked, SlamsimError

_CLEAN = os.O_NOFOLLOW | os.O_CLOEXEC
_UNNAMED = getattr(os, "O_TMPFILE", 0)
_NOT_UNNAMED = frozenset((errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOSYS, errno.EPERM))
"""What a file system answers that cannot make a file without a name, or give it one later."""
_DESCRIPTORS = Path("/proc/self/fd")
_LONGEST_BYTES = 4096
_STAGING = re.compile(r"slamsim-[0-9a-f]{16}")

_claimed: dict[Path, Path] = {}
"""The staging folder of each name that this process has locked, and nothing in it writes to yet."""

Recover = Callable[[Path], object]
"""Puts away the staging folder of a killed process. It is called while its lock is held."""


@contextmanager
def claimed(final: Path, recover: Recover, *, inside: bool = False) -> Iterator[None]:
    """Hold the lock of a name for a ``locked`` in the block. Raises what that raises."""
    with locked(final, recover, inside=inside) as staging:
        _claimed[final] = staging
        try:
            yield
        finally:
            _claimed.pop(final, None)


@contextmanager
def locked(final: Path, recover: Recover, *, inside: bool = False) -> Iterator[Path]:
    """Hold the lock of a name; the path that the staging folder must have, which is not made.

    final: absolute; the folders above it are made, and go again if nothing was put into them.
    inside: whether the staging folder is to lie in ``final``, not beside it. The lock file stays
    while there is something in the staging folder. Raises Locked while another process holds it,
    or another block of this one, SlamsimError for a file of its name that is not ours, and OSError.
    """
    if final in _claimed:
        staging = _claimed.pop(final)
        try:
            yield staging
        finally:
            _claimed[final] = staging
        return
    missing = list(takewhile(lambda folder: not folder.exists(), final.parents))
    try:
        descriptor, staging = _taken(final, recover, inside)
        try:
            yield staging
        finally:
            _release(descriptor, lock_of(final), staging)
    finally:
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()


def lock_of(final: Path) -> Path:
    """The name of the lock file of a name."""
    return final.with_name(f".{final.name}.slamsim-lock")


def staging_of(final: Path) -> Path | None:
    """The staging folder that the lock file of a name names, if one is held."""
    path = lock_of(final)
    with suppress(OSError, ValueError):
        if stat.S_ISREG(path.lstat().st_mode):
            with path.open("rb") as file:
                return _staging_in(final, file.read(_LONGEST_BYTES))
    return None


def owner_words(purpose: str, name: str, staging: Path) -> bytes:
    """A line that says what a file of ours is for, and which process wrote it."""
    words = {
        "slamsim": f"{purpose} of {name}",
        "owner": f"process {os.getpid()} on {socket.gethostname()}",
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
        "staging": staging.name,
    }
    return f"{json.dumps(words)}\n".encode()


def _taken(final: Path, recover: Recover, inside: bool) -> tuple[int, Path]:
    """The descriptor that holds the lock, and the staging folder that the lock file names."""
    path = lock_of(final)
    while True:
        final.parent.mkdir(parents=True, exist_ok=True)
        staging = _new_staging(final, inside)
        try:
            descriptor = _created(path, owner_words("lock", final.name, staging))
        except FileNotFoundError:
            continue  # the folder was empty, and gone again
        if descriptor is not None:
            return descriptor, staging
        if (left := _left_behind(final, path)) is not None:
            descriptor, remains = left
            try:
                recover(remains)
                path.unlink()
            finally:
                os.close(descriptor)


def _new_staging(final: Path, inside: bool) -> Path:
    word = f"slamsim-{secrets.token_hex(8)}"
    return final / f".{word}" if inside else final.with_name(f".{final.name}.{word}")


def _created(path: Path, words: bytes) -> int | None:
    """The descriptor of the new lock file, which is locked; nothing if the name is taken."""
    if _UNNAMED and _DESCRIPTORS.is_dir():
        try:
            return _written(os.open(path.parent, _UNNAMED | os.O_RDWR | _CLEAN, 0o666), words, path)
        except OSError as error:
            if error.errno not in _NOT_UNNAMED:
                raise
    # Killed between these two calls, it leaves an empty file, which the user has to remove.
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _CLEAN, 0o666)
    except FileExistsError:
        return None
    try:
        return _written(descriptor, words)
    except BaseException:
        path.unlink()
        raise


def _written(descriptor: int, words: bytes, name: Path | None = None) -> int | None:
    """The same descriptor, locked, its words on the disk, under its name; nothing if it is taken.

    The words must be on the disk: an empty lock file after a loss of power would not be ours.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        os.write(descriptor, words)
        os.fsync(descriptor)
        if name is not None:
            folder = os.open(name.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                source = str(_DESCRIPTORS / str(descriptor))
                os.link(source, name.name, dst_dir_fd=folder, follow_symlinks=True)
            finally:
                os.close(folder)
    except FileExistsError:
        os.close(descriptor)
        return None
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _left_behind(final: Path, path: Path) -> tuple[int, Path] | None:
    """The lock file of a killed process, now held, and its staging folder; nothing if it is gone.

    Raises Locked while a process holds it, and SlamsimError if it is not ours.
    """
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            raise _foreign(final, path)
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | _CLEAN)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_at(descriptor, path):
            staging = _staging_in(final, os.pread(descriptor, _LONGEST_BYTES, 0))
            if staging is None:
                raise _foreign(final, path)
            return descriptor, staging
    except BlockingIOError:
        owner = _told(os.pread(descriptor, _LONGEST_BYTES, 0)).get("owner", "another process")
        os.close(descriptor)
        raise Locked(f"{final} is being written by {owner}") from None
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


def _release(descriptor: int, path: Path, staging: Path) -> None:
    """What could not be removed is known to the next writer by the lock file, which stays."""
    with suppress(OSError):
        if not os.path.lexists(staging) and _is_at(descriptor, path):
            path.unlink()
    with suppress(OSError):
        os.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether this is still the file of that name."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    return False


def _staging_in(final: Path, words: bytes) -> Path | None:
    """The staging folder that a lock file of ours names, and nothing for one that is not ours."""
    told = _told(words)
    name = told.get("staging", "")
    if told.get("slamsim") != f"lock of {final.name}":
        return None
    for folder, prefix in ((final, "."), (final.parent, f".{final.name}.")):
        if name.startswith(prefix) and _STAGING.fullmatch(name[len(prefix) :]):
            return folder / name
    return None


def _told(words: bytes) -> dict[str, str]:
    try:
        told = json.loads(words)
    except (ValueError, RecursionError):
        return {}
    is_ours = isinstance(told, dict) and all(isinstance(value, str) for value in told.values())
    return told if is_ours else {}


def _foreign(final: Path, path: Path) -> SlamsimError:
    return SlamsimError(
        f"{path} has the name of the lock of {final.name}, and slamsim did not write it; "
        "move it away, or choose another name for the output"
    )
