"""Work that is killed in the middle, in a fork of this process."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable


def killed(work: Callable[[], object]) -> None:
    """Run this in a fork of this process, which must not come to its end."""
    if (child := os.fork()) == 0:
        try:
            work()
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


def die(*_: object) -> None:
    """What work does where it is to be killed, whatever it is called with."""
    os.kill(os.getpid(), signal.SIGKILL)
