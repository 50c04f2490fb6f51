"""The staging folder of an output: created, discarded, or exchanged with the folder it replaces.

``slamsim.guard.lock`` says what it is called and when each of this is done.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from pathlib import Path

from slamsim.guard.errors import SlamsimError
from slamsim.guard.lock import owner_words
from slamsim.guard.seal import WRITTEN_BY_US

_AT_CWD, _EXCHANGE = -100, 2
_CANNOT = frozenset((errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EXDEV))


def exchange(one: Path, other: Path) -> bool:
    """What each stands for is then under the other's name; False where that cannot be done.

    Linux can (renameat2), but not every file system. Raises OSError for names that cannot be
    written.
    """
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    if rename(_AT_CWD, os.fsencode(one), _AT_CWD, os.fsencode(other), _EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANNOT:
        return False
    raise OSError(number, os.strerror(number), str(other))


NEW, OLD, MARKER = "new", "old", "slamsim-staging.json"


def make_staging(staging: Path, final: Path) -> None:
    """With its marker. Raises OSError."""
    staging.mkdir(parents=True)
    (staging / MARKER).write_bytes(owner_words("staging", final.name, staging))


def is_staging(path: Path) -> bool:
    """Whether this, which a lock file names, is a staging folder: marked, or empty as yet."""
    if path.is_symlink() or not path.is_dir():
        return False
    return (path / MARKER).is_file() or not any(path.iterdir())


def remove_staging(staging: Path) -> None:
    """Remove it, its marker last; what is no staging folder stays. Raises OSError."""
    if not is_staging(staging):
        return
    for path in staging.iterdir():
        if path.name != MARKER:
            _remove(path)
    (staging / MARKER).unlink(missing_ok=True)
    staging.rmdir()


def restore(final: Path, staging: Path) -> None:
    """Put away what a killed process left: what it was to replace is put back if it is gone.

    Raises OSError, and SlamsimError if something else took its name meanwhile.
    """
    old = staging / OLD
    if is_staging(staging) and not old.is_symlink() and (old / WRITTEN_BY_US).is_file():
        if not os.path.lexists(final):
            old.rename(final)
        elif os.path.lexists(staging / NEW):  # killed between the two renames
            raise SlamsimError(
                f"{final} took the name of a run that a killed process moved to {old}; "
                "move one of them away"
            )
    remove_staging(staging)


def put_in_place(staging: Path, final: Path) -> None:
    """Give ``new`` its final name; what stood there is then in the staging folder, to be removed.

    Raises OSError; everything is then where it was.
    """
    replaced = final.is_dir() and any(final.iterdir())
    if replaced:
        _replace(staging, final)
    else:
        (staging / NEW).rename(final)
    try:
        sync(final.parent)
    except OSError:
        if replaced:
            _replace(staging, final)
        else:
            final.rename(staging / NEW)
        raise


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _replace(staging: Path, final: Path) -> None:
    """Exchange two folders, in one step where the file system can."""
    new, old = staging / NEW, staging / OLD
    if exchange(new, final):
        return
    final.rename(old)
    try:
        new.rename(final)
    except BaseException:
        old.rename(final)
        raise
    old.rename(new)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
