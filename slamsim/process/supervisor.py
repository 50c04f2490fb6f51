"""Runs a command in a child process, makes sure that it ends, and reports how.

Native code may hold Python's lock for minutes: until then no signal is heard there. And where it
crashes, nobody is left to say so. This process has loaded nothing, and so it always hears.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable
from typing import NoReturn

from slamsim.guard.errors import SlamsimError
from slamsim.process.children import end_with_parent
from slamsim.process.exit_codes import STOPPED, STOPPING, UNTOUCHED, ended_by, fail

GRACE_S = 1.5
"""So long a command that is stopped may take to put its things in order."""
_AGAIN_S = 0.2


def supervised(command: Callable[[], int]) -> int:
    """The exit code of a command that runs in a child; in the child itself this does not return.

    Ctrl-C, SIGTERM, a terminal that is closed and Ctrl-\\ end both within two seconds, whether this
    process or the child gets the signal.
    """
    heard, told = os.pipe()
    os.set_blocking(told, False)
    parent = os.getpid()
    for number in (*_heeded(), signal.SIGCHLD):
        signal.signal(number, lambda number, frame: None)
    signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    child = os.fork()
    if child == 0:
        os.close(heard)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        end_with_parent(parent)
        _end(command())
    return _code(*_watch(child, heard))


def _end(code: int) -> NoReturn:
    """End the child; once it was stopped, without a wait for what its threads still do."""
    if code > 128:
        os._exit(code)
    sys.exit(code)


def _heeded() -> tuple[int, ...]:
    return tuple(one for one in STOPPING if signal.getsignal(one) is not signal.SIG_IGN)


def _watch(child: int, heard: int) -> tuple[int | None, int]:
    """(the signal that stopped it, how it ended as ``os.waitpid`` tells).

    heard: where this process and the child tell which signals they get, whatever they are doing.
    """
    stopped_by, end_s = None, 0.0
    while True:
        ready, _, _ = select.select((heard,), (), (), None if stopped_by is None else _AGAIN_S)
        numbers = os.read(heard, 512) if ready else b""
        if stopped_by is None:
            stopped_by = next((number for number in numbers if number in STOPPING), None)
            end_s = time.monotonic() + GRACE_S
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return stopped_by, status
        if stopped_by is not None:
            os.kill(child, stopped_by if time.monotonic() < end_s else signal.SIGKILL)


def _code(stopped_by: int | None, status: int) -> int:
    """The exit code that says so, and a sentence where the child could not say it."""
    if os.WIFEXITED(status):
        return os.WEXITSTATUS(status)
    killed_by = os.WTERMSIG(status)
    if stopped_by is not None or killed_by in STOPPING:
        return fail(STOPPED, 128 + (stopped_by or killed_by))
    return fail(f"this run {ended_by(killed_by)}; {UNTOUCHED}", SlamsimError.exit_code)
