"""Runs a command in a child process, makes sure that it ends, and reports how.

Native code may hold Python's lock for minutes: until then no signal is heard there. And where it
crashes, nothing is left to say so. This process has loaded nothing, and so it always hears.
"""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import NoReturn

from slamsim.guard.errors import SlamsimError
from slamsim.process.children import end_with_parent
from slamsim.process.exit_codes import STOPPED, STOPPING, UNTOUCHED, ended_by, fail

GRACE_S = 1.5
"""So long a command that is stopped may take to put its things in order."""
_AGAIN_S = 0.2
_FINISHING = 0
"""No signal has this number: the command has heard, and finishes what it is writing."""
_finished = threading.Event()
"""Set in a child that has heard: it ends as one that was stopped."""


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


def finish_in_peace() -> None:
    """Called in the child where a signal to stop has come: it is not killed while it finishes,
    unless a second signal comes. Without a supervisor this does nothing."""
    _finished.set()
    told = signal.set_wakeup_fd(-1)
    if told >= 0:
        os.write(told, bytes([_FINISHING]))
        signal.set_wakeup_fd(told, warn_on_full_buffer=False)


def _end(code: int) -> NoReturn:
    """End the child; once it was stopped, without a wait for what its threads still do, and without
    the second or two in which Python takes its modules apart."""
    if code > 128 or _finished.is_set():
        os._exit(code)
    sys.exit(code)


def _heeded() -> tuple[int, ...]:
    return tuple(one for one in STOPPING if signal.getsignal(one) is not signal.SIG_IGN)


def _watch(child: int, heard: int) -> tuple[int | None, int]:
    """(the signal that stopped it, how it ended as ``os.waitpid`` tells).

    heard: where this process and the child tell which signals they get, whatever they are doing.
    """
    stopped_by, end_s, in_peace_s = None, 0.0, math.inf
    while True:
        waits = stopped_by is None or time.monotonic() > in_peace_s + GRACE_S
        ready, _, _ = select.select((heard,), (), (), None if waits else _AGAIN_S)
        numbers = os.read(heard, 512) if ready else b""
        signals = [number for number in numbers if number in STOPPING]
        if stopped_by is None and signals:
            stopped_by, end_s = signals[0], time.monotonic() + GRACE_S
        elif signals and time.monotonic() > in_peace_s + GRACE_S:
            in_peace_s, end_s = math.inf, 0.0  # a second one, by a person who will not wait
        if _FINISHING in numbers:
            in_peace_s = time.monotonic()
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return stopped_by, status
        if stopped_by is not None and in_peace_s == math.inf:
            os.kill(child, stopped_by if time.monotonic() < end_s else signal.SIGKILL)


def _code(stopped_by: int | None, status: int) -> int:
    """The exit code that says so, and a sentence where the child could not say it."""
    if os.WIFEXITED(status):
        return os.WEXITSTATUS(status)
    killed_by = os.WTERMSIG(status)
    if stopped_by is not None or killed_by in STOPPING:
        return fail(STOPPED, 128 + (stopped_by or killed_by))
    return fail(f"this run {ended_by(killed_by)}; {UNTOUCHED}", SlamsimError.exit_code)
