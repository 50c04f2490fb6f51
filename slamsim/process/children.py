"""Child processes that end with their parent, however the parent ends.

The operating system ends them, even in native code that holds Python's lock. This file is also a
program, ``children.py PARENT COMMAND...``, which becomes the command; it imports next to nothing.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import threading
from collections.abc import Sequence

LOOK_S = 0.5
HALTED_S = 10.0
"""A process that is stopped (SIGSTOP) for so long without a break is not waited for any longer."""
_PR_SET_PDEATHSIG = 1


class Halted(Exception):
    """A process is stopped and does not go on; ``str`` says so, after "its process"."""


class Patience:
    """Looks at one process again and again while it is waited for."""

    def __init__(self, process: int) -> None:
        self._process, self._seen_s = process, 0.0

    def look(self, after_s: float) -> None:
        """after_s: since the last look. Raises Halted; looks count, for we may be stopped too."""
        self._seen_s = self._seen_s + after_s if is_halted(self._process) else 0.0
        if self._seen_s >= HALTED_S:
            raise Halted(f"was stopped (SIGSTOP) and did not go on within {HALTED_S:g} s")

    def wait(self, readable: Sequence[int], writable: Sequence[int] = ()) -> None:
        """Until one of these descriptors can be read or written. Raises Halted."""
        while not any(select.select(readable, writable, (), LOOK_S)):
            self.look(LOOK_S)


def is_halted(process: int) -> bool:
    """Whether it was stopped by a signal; on Linux only, elsewhere that is never seen."""
    try:
        with open(f"/proc/{process}/stat", errors="replace") as file:  # noqa: PTH123 - no imports
            return file.read().rpartition(")")[2].split()[0] == "T"
    except (OSError, IndexError):
        return False


def peak_memory_mb(process: int | str = "self") -> float:
    """The most memory that a process has held at once (resident set), MB; 0 for one that is gone.

    Of a program that a process became, which ru_maxrss is not: that one begins with what the
    process held which started it (300 MB for the physics engine, which takes 110).
    """
    try:
        with open(f"/proc/{process}/status", errors="replace") as file:  # noqa: PTH123
            told = file.read().partition("VmHWM:")[2].split()
    except OSError:
        return 0.0
    return int(told[0]) / 1024.0 if told else 0.0


class MemoryTogether:
    """Peak memory of this process and of children that ran for a part of its life."""

    def __init__(self) -> None:
        self._with_child_mb = 0.0

    def see(self, child: int) -> None:
        """Called while a child runs, as late as possible."""
        self._with_child_mb = max(self._with_child_mb, peak_memory_mb() + peak_memory_mb(child))

    def peak_mb(self) -> float:
        """An upper bound of what all held at any one time, children one after the other."""
        return max(self._with_child_mb, peak_memory_mb())


MEMORY = MemoryTogether()


def end_with_parent(parent: int) -> None:
    """Called in a child: from here on it is killed when its parent is gone.

    parent: process id of the one that started it. On Linux the child ends already with the thread
    that did; elsewhere only a parent that is gone by now is noticed.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def dying_with_us(command: Sequence[str]) -> list[str]:
    """The command line of a program that is killed when this process is gone.

    Started by another thread than the main one, whose end says nothing, it is left as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        return list(command)
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


def return_freed_memory() -> None:
    """Called after much was read and dropped: of a recording of two hours 0.8 GB stay otherwise.

    glibc keeps what is freed between arrays that stay; other C libraries need no such call.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


if __name__ == "__main__":
    end_with_parent(int(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])
