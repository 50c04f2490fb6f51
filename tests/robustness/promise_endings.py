"""A command in a fork of this process, ended in one of many ways, with all that it starts.

What it loads is loaded already, so it must not have started threads: see ``promise``.
"""

from __future__ import annotations

import atexit
import ctypes
import errno
import fcntl
import os
import resource
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NoReturn

from fault_disk import KILL, ODD, Call, Kill, watched

from slamsim import entry

_PIPE_BYTES = 1 << 20
_SET_CHILD_SUBREAPER = 36
_GROWING = frozenset(("open", "write", "mkdir", "fsync"))


@dataclass(frozen=True)
class Ending:
    """How it is to end. after: seconds until a signal, bytes a file may grow to, or the number of
    the change to the disk at which it is struck.
    """

    kind: str = "let run"
    after: float = 0.0

    @property
    def is_kill(self) -> bool:
        return self.kind in ("SIGKILL", "SIGKILL at a change")


@dataclass(frozen=True)
class Ended:
    """code: as a shell sees it, -9 when it was killed. after_signal_s: until it was gone.
    left: whether a process of it was still there five seconds later.
    """

    code: int
    told: str
    after_signal_s: float = 0.0
    hung: bool = False
    left: bool = False


def run(typed: Sequence[str], root: Path, ending: Ending, limit_s: float) -> Ended:
    """In the working folder of a tree. Whatever it starts is gone afterwards."""
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    if ending.kind in ("SIGKILL at a change", "full at a change"):
        ended = _struck(typed, root, ending)
    else:
        ended = _signalled(typed, root, ending, limit_s)
    return ended if _reaped() else Ended(ended.code, ended.told, left=True)


def _struck(typed: Sequence[str], root: Path, ending: Ending) -> Ended:
    """At one of its changes to the tree the kernel kills it, or has no more room from there on."""

    def verdict(number: int, call: Call) -> int | Kill | None:
        if number < ending.after:
            return None
        if ending.is_kill:
            return KILL
        return errno.ENOSPC if call.kind in _GROWING else None

    outcome = watched(partial(_command, typed, root), root, verdict)
    return Ended(1 if outcome.code == ODD else outcome.code, outcome.told)


def _signalled(typed: Sequence[str], root: Path, ending: Ending, limit_s: float) -> Ended:
    told, tells = os.pipe()
    fcntl.fcntl(told, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(tells, 1)
        os.dup2(tells, 2)
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115
        if ending.kind == "file size":
            limit = int(ending.after)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        _command(typed, root)
    os.close(tells)
    begin_s = time.monotonic()
    sent_s = begin_s + ending.after if ending.kind.startswith("SIG") else begin_s + limit_s
    number = {"SIGTERM": signal.SIGTERM}.get(ending.kind, signal.SIGKILL)
    status = _wait(child, sent_s)
    hung = status is None and not ending.kind.startswith("SIG")
    if status is None:
        with suppress(ProcessLookupError):
            os.killpg(child, number)
        status = _wait(child, sent_s + limit_s)
    late_s = time.monotonic() - sent_s
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if status is None:
        hung, (_, status) = True, os.waitpid(child, 0)
    os.set_blocking(told, False)
    with os.fdopen(told, "rb") as file:
        text = (file.read() or b"").decode(errors="replace")
    return Ended(os.waitstatus_to_exitcode(status), text, max(late_s, 0.0), hung)


def _wait(child: int, until_s: float) -> int | None:
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status
        if time.monotonic() > until_s:
            return None
        time.sleep(0.003)


def _reaped(within_s: float = 20.0) -> bool:
    """Whether all that the command started is gone; what is not is killed."""
    end_s = time.monotonic() + within_s
    while True:
        try:
            ended, _ = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return time.monotonic() < end_s
        if not ended:
            time.sleep(0.005)
            if time.monotonic() > end_s:
                _kill_children()


def _kill_children() -> None:
    for task in Path("/proc/self/task").iterdir():
        for number in (task / "children").read_text().split():
            with suppress(ProcessLookupError):
                os.kill(int(number), signal.SIGKILL)


def _command(typed: Sequence[str], root: Path) -> NoReturn:
    """What the program ``slamsim`` does, to its end."""
    os.chdir(root / "work")
    os.environ.update(HOME=str(root / "home"), TMPDIR=str(root / "tmp"), COLUMNS="200")
    tempfile.tempdir = None
    sys.argv = ["slamsim", *typed]
    code = 1
    try:
        entry.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    with suppress(Exception):
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
