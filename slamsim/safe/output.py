"""The one way out: everything is written beside its final name and renamed when whole."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from slamsim.quantities import as_size
from slamsim.safe.errors import DiskFull, Locked, SlamsimError, shown
from slamsim.safe.exchange import exchange
from slamsim.safe.lock import claimed, folder_lock, held
from slamsim.safe.seal import WRITTEN_BY_US, seal_folder

_MARK_TEXT = "Written by slamsim, which may replace this folder when told to overwrite it.\n"
_SYNCED_TOGETHER = 8
_FULL = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
_FAILING = frozenset((errno.EIO, errno.EROFS, errno.ENXIO, errno.ENODEV, errno.ESTALE))


@contextmanager
def partial_folder(final: Path, overwrite: bool = False) -> Iterator[Path]:
    """A folder to write into, which becomes ``final`` if the block ends without an exception.

    It is ``<final>.partial`` until everything in it is sealed with ``SHA256SUMS`` and on the
    disk; then it is renamed. After an exception, Ctrl-C included, it is removed and what stood
    under ``final`` still stands. An existing folder is refused at once, unless it is empty, or
    overwrite is set and slamsim wrote it; it then stands under its name until the new one does.

    Raises SlamsimError for a name that cannot be written, Locked while another process writes
    there, DiskFull when the disk (or quota, or file size limit) does not suffice.
    """
    final = _absolute(final)
    partial, retired = _sibling(final, ".partial"), _sibling(final, ".old")
    with ExitStack() as clean_up:
        with written_to(final):
            clean_up.enter_context(folder_lock(final))
            _restore(final, partial, retired)
            _require_free_name(final, overwrite)
            _remove(partial)
            clean_up.callback(_discard, partial)
            partial.mkdir()
            (partial / WRITTEN_BY_US).write_text(_MARK_TEXT, encoding="utf-8")
        with disk_told(final):
            yield partial
        with written_to(final):
            seal_folder(partial)
            sync_tree(partial)
            _put_in_place(partial, final, retired)


@contextmanager
def claimed_folder(final: Path, overwrite: bool = False) -> Iterator[None]:
    """Keep a name for a ``partial_folder`` in the block, and refuse now what it would refuse.

    So a second process is told at once, and not when all libraries are loaded.
    """
    final = _absolute(final)
    with ExitStack() as clean_up:
        with written_to(final):
            clean_up.enter_context(claimed(final))
            _restore(final, _sibling(final, ".partial"), _sibling(final, ".old"))
            _require_free_name(final, overwrite)
        yield


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file under its name only when it is whole and on the disk.

    It is ``.<name>.partial`` until then; what a kill leaves of that is gone when the name is next
    written. Makes missing parent folders. Raises SlamsimError, DiskFull, or Locked while somebody
    else writes the file; an old one then stays, unless all that failed was to wait for the new
    name to be on the disk.
    """
    path = _absolute(path)
    partial = path.with_name(f".{path.name}.partial")
    with written_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(path) and not path.is_file():
            raise SlamsimError(f"{path} is there already and is not a file; choose another name")
        with _alone(partial, path) as file:
            try:
                file.truncate()
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
                partial.replace(path)
            except BaseException:
                _discard(partial)
                raise
        sync(path.parent)


def _alone(partial: Path, path: Path) -> BinaryIO:
    try:
        return os.fdopen(held(partial), "wb")
    except BlockingIOError:
        raise Locked(f"{path} is being written by another process") from None


def require_free_space(folder: Path, needed_bytes: int) -> None:
    """Raise DiskFull now rather than after an hour; folder need not exist yet."""
    if (free := free_bytes(folder)) < needed_bytes:
        raise DiskFull(
            f"{_absolute(folder)}: about {as_size(needed_bytes)} are needed, "
            f"{as_size(free)} are free"
        )


def free_bytes(path: Path) -> int:
    """Room on the disk that a file or folder lies on, or will lie on."""
    path = _absolute(path)
    while not path.exists():
        path = path.parent
    return shutil.disk_usage(path).free


def _absolute(path: Path) -> Path:
    """Without ``..`` and links in its folder, so that the siblings are where the rename is."""
    try:
        whole = path.resolve() if path.name in ("", "..") else path.parent.resolve() / path.name
    except (OSError, ValueError, RuntimeError) as error:
        raise SlamsimError(f"{shown(str(path))} cannot be written: {error}") from None
    if not whole.name or "\0" in whole.name:
        raise SlamsimError(f"{shown(str(path))} is not a name that can be written")
    return whole


def _sibling(final: Path, suffix: str) -> Path:
    return final.with_name(final.name + suffix)


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

    Raises DiskFull or SlamsimError in its place. Whatever else the block raises passes.
    """
    try:
        yield
    except SlamsimError:
        raise
    except Exception as error:
        if (number := _error_number(error, _FULL | _FAILING)) is None:
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


def _require_free_name(final: Path, overwrite: bool) -> None:
    if not os.path.lexists(final):
        return
    if final.is_symlink() or not final.is_dir():
        raise SlamsimError(f"{final} is there already and is not a folder; choose another name")
    if not any(final.iterdir()):
        return
    if not (final / WRITTEN_BY_US).is_file():
        raise SlamsimError(
            f"{final} holds files that slamsim did not write; choose another name for the output"
        )
    if not overwrite:
        raise SlamsimError(f"{final} is there already; choose another name or overwrite it")


def _restore(final: Path, partial: Path, retired: Path) -> None:
    """Mend what a kill between the renames of ``_replace`` left behind."""
    if retired.is_dir() and not retired.is_symlink() and (retired / WRITTEN_BY_US).is_file():
        if os.path.lexists(final):
            _remove(partial)
            retired.rename(partial)
        else:
            retired.rename(final)


def _put_in_place(partial: Path, final: Path, retired: Path) -> None:
    """What stood under the name is then in ``partial``, to be removed."""
    replaced = final.is_dir() and any(final.iterdir())
    if replaced:
        _replace(partial, final, retired)
    else:
        partial.rename(final)
    try:
        sync(final.parent)
    except OSError:
        if replaced:
            _replace(partial, final, retired)
        else:
            final.rename(partial)
        raise


def _replace(partial: Path, final: Path, retired: Path) -> None:
    """Exchange two folders, in one step where the file system can."""
    if exchange(partial, final):
        return
    final.rename(retired)
    try:
        partial.rename(final)
    except BaseException:
        retired.rename(final)
        raise
    retired.rename(partial)


def _remove(partial: Path) -> None:
    if partial.is_dir() and not partial.is_symlink():
        shutil.rmtree(partial)
    else:
        partial.unlink(missing_ok=True)


def _discard(partial: Path) -> None:
    """Remove what nobody needs; what cannot be removed now is when the name is next used."""
    with suppress(OSError):
        _remove(partial)


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


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
