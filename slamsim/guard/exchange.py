"""Two names exchanged in one step, so that at every moment something whole stands under each."""

from __future__ import annotations

import ctypes
import errno
import os
from pathlib import Path

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
