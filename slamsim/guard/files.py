"""Opens input files: checks that a file exists, is a regular file and is not too large.

Any program may have written it; if it was slamsim, it must be as it was written.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, BinaryIO

from slamsim.guard.errors import InputRefused, NotFound, shown
from slamsim.guard.limits import LIMITS
from slamsim.guard.seal import require_as_written

_noted: ContextVar[list[Path] | None] = ContextVar("_noted", default=None)


@contextmanager
def noted_inputs() -> Iterator[list[Path]]:
    """The files that ``open_input`` opens in the block, as they come."""
    files = list[Path]()
    token = _noted.set(files)
    try:
        yield files
    finally:
        _noted.reset(token)


def open_input(path: Path) -> BinaryIO:
    """Open for reading; the caller closes.

    Raises NotFound if nothing is there, InputRefused for a folder, a pipe or a device (a pipe
    without a writer would block for ever) and for a file that may not be read, DataDamaged for
    one that slamsim sealed and that is not as it was written.
    """
    file = open_as_found(path)
    if (noted := _noted.get()) is not None:
        noted.append(path)
    try:
        require_as_written(path)
    except BaseException:
        file.close()
        raise
    return file


def open_as_found(path: Path) -> BinaryIO:
    """The same for readers of files that may be damaged.

    Raises NotFound, or InputRefused for what is no file.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        raise NotFound(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputRefused(path, f"cannot be opened: {str(reason).lower()}") from None
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or device"
        raise InputRefused(path, f"is {kind}, a file is needed")
    return os.fdopen(descriptor, "rb")


def read_input(path: Path, limit: str) -> bytes:
    """The whole file; raises as ``open_input`` does, and InputRefused above the limit.

    limit: the field of ``limits`` that says how many bytes it may have.
    """
    most: int = getattr(LIMITS, limit)
    with open_input(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            reason = f"is {size:,} bytes long, at most {most:,} are read"
            raise InputRefused(path, reason, limit=limit)
        try:
            return file.read(size)
        except OSError as error:
            raise InputRefused(path, f"cannot be read: {error.strerror}") from None


def require_magic(file: BinaryIO, path: Path, magic: bytes, kind: str) -> None:
    """Read the first bytes of a file; InputRefused if they are not those of its kind."""
    found = file.read(len(magic))
    if found != magic:
        what = f"this is no {kind} (wrong first bytes)" if found else "the file is empty"
        raise InputRefused(path, what)


def leads_outside(root: Path, name: str) -> bool:
    """Whether ``name``, relative to ``root``, is outside of it once all links are followed."""
    try:
        return not (root / name).resolve().is_relative_to(root.resolve())
    except (OSError, ValueError, RuntimeError):
        return True


def require_inside(root: Path, name: str, path: Path, where: str = "") -> Path:
    """The file ``name`` means, relative to ``root``; InputRefused if it lies outside of root.

    path and where say which file asked for it. A name with ``..`` in it is refused too: behind a
    link it means another file than its text does, so a copy would lie in the wrong place.
    """
    if leads_outside(root, name) or Path(name).is_absolute() or ".." in Path(name).parts:
        reason = f"the file {shown(name)} must lie inside the folder {root}"
        raise InputRefused(path, f"{reason}, named without '..'", where)
    return (root / name).resolve()


def own_file(folder: Path, name: str) -> Path:
    """``folder / name``, there or not; InputRefused if a link takes it out of the folder.

    What the user names is read wherever it lies, what is found in a folder must belong to it: a
    folder may come from anyone.
    """
    if leads_outside(folder, name):
        reason = f"is a link that leads out of {folder}; name the file that is meant, or copy it"
        raise InputRefused(folder / name, reason)
    return folder / name


def discard(stream: IO[str]) -> None:
    """From here on what is written to this stream goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
