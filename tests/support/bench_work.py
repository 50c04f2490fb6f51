"""Work for a child process, in a module that is imported quickly."""

from __future__ import annotations

import os

from slamsim.guard.errors import SlamsimError


def work(what: str) -> int:
    if what == "die":
        os._exit(7)
    if what == "refuse":
        raise SlamsimError("no such thing")
    if what == "stumble":
        raise ValueError("over a stone")
    return os.getpid()
