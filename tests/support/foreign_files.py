"""Files of a user, and whether anything happened to them."""

from __future__ import annotations

import os
import stat
from pathlib import Path

Snapshot = dict[str, tuple[object, ...]]


def snapshot(folder: Path, without: tuple[str, ...] = ()) -> Snapshot:
    """What lies below a folder: kind, inode, time of change, and bytes or goal of a link.

    without: names at its top that are left out. Folders have no times here: names may come and go
    in them.
    """
    found: Snapshot = {}
    for root, folders, names in os.walk(folder):
        if Path(root) == folder:
            folders[:] = [name for name in folders if name not in without]
            names[:] = [name for name in names if name not in without]
        for name in (*folders, *names):
            path = Path(root, name)
            facts = path.lstat()
            held: object = None
            if stat.S_ISREG(facts.st_mode):
                held = (facts.st_mtime_ns, facts.st_nlink, path.read_bytes())
            elif path.is_symlink():
                held = os.readlink(path)  # noqa: PTH115 - a goal that is no path of ours
            found[str(path.relative_to(folder))] = (facts.st_mode, facts.st_ino, held)
    return found
