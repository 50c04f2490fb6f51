"""Processes that end with the one that started them, however that ends.

The operating system sees to it, so that native code which holds Python's lock is no refuge. This
file is also a program, ``kin.py PARENT COMMAND...``, which becomes the command; it imports next
to nothing.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Sequence

_PR_SET_PDEATHSIG = 1


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


if __name__ == "__main__":
    end_with_parent(int(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])
