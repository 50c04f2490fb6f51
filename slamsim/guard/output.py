"""Staged writes: every output is written in a staging folder and renamed when complete.

How names are locked, and what belongs to whom, is told in ``slamsim.guard.lock``.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

from slamsim.guard.errors import DiskFull, SlamsimError, shown
from slamsim.guard.lock import claimed, locked, staging_of
from slamsim.guard.quantities import as_size
from slamsim.guard.replaceable import require_replaceable_file, require_replaceable_folder
from slamsim.guard.seal import WRITTEN_BY_US, seal_folder
from slamsim.guard.staging import (
    NEW,
    OLD,
    make_staging,
    put_in_place,
    remove_staging,
    restore,
    sync,
)

_Held = TypeVar("_Held")
_MARK_TEXT = "Written by slamsim, which may replace this folder when told to overwrite it.\n"
_SYNCED_TOGETHER = 8
_FULL = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
_FAILING = frozenset((errno.EIO, errno.EROFS, errno.ENXIO, errno.ENODEV, errno.ESTALE))


@contextmanager
def partial_folder(final: Path, overwrite: bool = False) -> Iterator[Path]:
    """A folder to write into, which becomes ``final`` if the block ends without an exception.

    It is in a staging folder beside it until everything in it is sealed with ``SHA256SUMS`` and on
    the disk; then it is renamed. After an exception, Ctrl-C included, it is removed and what stood
    under ``final`` still stands. An existing folder is refused at once, and nothing is touched,
    unless it is empty, or overwrite is set, slamsim wrote it and its ``SHA256SUMS`` lists every
    file in it; it then stands under its name until the new one does.

    Raises SlamsimError for a name that cannot be written, Locked while another process writes
    there, DiskFull when the disk (or quota, or file size limit) does not suffice.
    """
    final = as_written(final)
    with _staged(final, partial(require_replaceable_folder, final, overwrite)) as staging:
        new = staging / NEW
        with written_to(final):
            new.mkdir()
            (new / WRITTEN_BY_US).write_text(_MARK_TEXT, encoding="utf-8")
        with disk_told(final):
            yield new
        with written_to(final):
            seal_folder(new)
            sync_tree(new)
            require_replaceable_folder(final, overwrite)  # it may have changed meanwhile
            put_in_place(staging, final)


@contextmanager
def partial_file(final: Path, overwrite: bool = False) -> Iterator[Path]:
    """A name to write a file to, which becomes ``final`` if the block ends without an exception.

    An existing file is replaced only if overwrite is set, and never one that slamsim sealed, nor a
    link, folder, pipe or device. Raises as ``partial_folder`` does.
    """
    final = as_written(final)
    with _staged(final, partial(require_replaceable_file, final, overwrite)) as staging:
        with disk_told(final):
            yield staging / NEW
        with written_to(final):
            sync(staging / NEW)
            require_replaceable_file(final, overwrite)
            (staging / NEW).replace(final)
            sync(final.parent)


@contextmanager
def claimed_folder(final: Path, overwrite: bool = False) -> Iterator[None]:
    """Keep a name for a ``partial_folder`` in the block, and refuse now what it would refuse.

    So a second process is told at once, and not when all libraries are loaded.
    """
    final = as_written(final)
    require_replaceable_folder(final, overwrite)
    with _entered(final, claimed(final, partial(restore, final))):
        require_replaceable_folder(final, overwrite)
        yield


def put_away_remains(final: Path) -> None:
    """Remove what a process left beside ``final`` that was killed when that was finished.

    What it left unfinished, or was to replace, stays: ``slamsim recover`` may look for it.
    """
    final = as_written(final)
    staging = staging_of(final)
    if staging is None or any(os.path.lexists(staging / name) for name in (NEW, OLD)):
        return
    with suppress(SlamsimError, OSError), locked(final, partial(restore, final)):
        pass


@contextmanager
def _staged(final: Path, require_free: Callable[[], None]) -> Iterator[Path]:
    """The staging folder of a name that is free, before its lock is taken and after."""
    require_free()
    with _entered(final, locked(final, partial(restore, final))) as staging:
        require_free()
        try:
            with written_to(final):
                make_staging(staging, final)
            yield staging
        finally:
            with suppress(OSError):  # the next writer of this name removes it then
                remove_staging(staging)


@contextmanager
def _entered(final: Path, lock: AbstractContextManager[_Held]) -> Iterator[_Held]:
    """What the operating system says of a lock that cannot be taken, as the user is told it."""
    with ExitStack() as held:
        with written_to(final):
            staging = held.enter_context(lock)
        yield staging


def write_atomic(path: Path, data: bytes, within: Path | None = None) -> None:
    """Write a file under its name only when it is whole and on the disk.

    For files in folders of ours; ``partial_file`` is for those that a user names. Until it is
    whole it has a random name in its folder or in ``within``, a staging folder on the same file
    system. Makes missing parent folders. Raises SlamsimError or DiskFull; an old one then stays,
    unless all that failed was to wait for the new name to be on the disk.
    """
    path = as_written(path)
    unfinished = (within or path.parent) / f".{path.name}.slamsim-{secrets.token_hex(8)}"
    with written_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(path) and not path.is_file():
            raise SlamsimError(f"{path} is there already and is not a file; choose another name")
        try:
            with unfinished.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
        except BaseException:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise
        sync(path.parent)


def require_free_space(folder: Path, needed_bytes: int) -> None:
    """Raise DiskFull now rather than after an hour; folder need not exist yet."""
    if (free := free_bytes(folder)) < needed_bytes:
        raise DiskFull(
            f"{as_written(folder)}: about {as_size(needed_bytes)} are needed, "
            f"{as_size(free)} are free"
        )


def free_bytes(path: Path) -> int:
    """Room on the disk that a file or folder lies on, or will lie on."""
    path = as_written(path)
    while not path.exists():
        path = path.parent
    return shutil.disk_usage(path).free


def as_written(path: Path) -> Path:
    """Without ``..`` and links in its folder, so that the siblings are where the rename is.

    Raises SlamsimError for a name that cannot be written.
    """
    try:
        whole = path.resolve() if path.name in ("", "..") else path.parent.resolve() / path.name
    except (OSError, ValueError, RuntimeError) as error:
        raise SlamsimError(f"{shown(str(path))} cannot be written: {error}") from None
    if not whole.name or "\0" in whole.name:
        raise SlamsimError(f"{shown(str(path))} is not a name that can be written")
    return whole


@contextmanager
def written_to(final: Path) -> Iterator[None]:
    """What the operating system says of a block that only writes, as the user is told it.

    Raises DiskFull, or SlamsimError, where the block ends with an OSError.
    """
    try:
        with disk_told(final):
            yield
    except OSError as error:
        name = f" ({error.filename})" if error.filename else ""
        raise SlamsimError(f"{final}: cannot be written: {error.strerror}{name}") from error


@contextmanager
def disk_told(final: Path) -> Iterator[None]:
    """A disk that is full or fails, told as such where the block ends with its error.

    Raises DiskFull or SlamsimError in its place, also where the block told it of a file of its own
    that is not finished: the user asked for ``final``. Whatever else the block raises passes.
    """
    try:
        yield
    except Exception as error:
        is_refusal = isinstance(error, SlamsimError) and type(error) not in (SlamsimError, DiskFull)
        if is_refusal or (number := _error_number(error, _FULL | _FAILING)) is None:
            raise
        told = f"{final}: {os.strerror(number)}"
        rest = "nothing half-written stands under this name"
        if number in _FULL:
            room = f"({as_size(free_bytes(final))} are free)"
            raise DiskFull(f"{told} {room}; {rest}") from error
        raise SlamsimError(f"{told}; {rest}") from error


def disk_full(error: BaseException | None) -> str | None:
    """What a full disk (or quota) is called, where that is the error, wrapped or not."""
    number = _error_number(error, _FULL)
    return None if number is None else os.strerror(number)


def _error_number(error: BaseException | None, wanted: frozenset[int]) -> int | None:
    """Of the operating system, also when a library wrapped its error in one of its own."""
    for _ in range(8):
        if isinstance(error, OSError) and error.errno in wanted:
            return error.errno
        error = error and (error.__cause__ or error.__context__)
    return None


def sync_tree(folder: Path) -> None:
    """Wait until a folder with all that is in it is on the disk.

    Files are waited for together: a file system writes down many at once as fast as one.
    """
    files, folders = list[Path](), list[Path]()
    for root, _, names in os.walk(folder):
        folders.append(Path(root))
        files += (path for name in names if not (path := Path(root, name)).is_symlink())
    with ThreadPoolExecutor(_SYNCED_TOGETHER) as threads:
        for _ in threads.map(sync, files):
            pass
    for each in folders:
        sync(each)


def discard(opened: ExitStack) -> None:
    """Close writers and folders as an error in their block would: nothing of them is left."""
    with suppress(_Discarded):
        opened.__exit__(_Discarded, _Discarded(), None)


class _Discarded(Exception):
    """Ends the writers."""
