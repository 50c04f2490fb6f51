"""A disk that fails, or a process that dies, at the n-th thing it asks of the kernel.

The kernel itself asks us before each system call that changes a folder (seccomp user notification,
Linux 5.5 or newer, no root needed), of any thread and of native code as well: we let it pass, give
back an error number in its place, or kill the process before it. Reading is never touched.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import platform
import resource
import select
import signal
import socket
import struct
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pytest

from slamsim.process.exit_codes import run_command

ODD = 99
"""The exit code of a command that ended in a traceback."""
_LIMIT_S = 60.0

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_AT_CWD, _EXCHANGING = -100, 2

_X86_64 = {
    "write": 1, "close": 3, "pwrite64": 18, "writev": 20, "sendfile": 40, "fsync": 74,
    "fdatasync": 75, "truncate": 76, "ftruncate": 77, "rename": 82, "mkdir": 83, "rmdir": 84,
    "link": 86, "unlink": 87, "symlink": 88, "chmod": 90, "fchmod": 91, "open": 2, "creat": 85,
    "openat": 257, "mkdirat": 258, "unlinkat": 263, "renameat": 264, "fallocate": 285,
    "linkat": 265, "pwritev": 296, "renameat2": 316, "copy_file_range": 326,
}  # fmt: skip
_AARCH64 = {
    "mkdirat": 34, "unlinkat": 35, "linkat": 37, "renameat": 38, "truncate": 45, "ftruncate": 46,
    "fallocate": 47, "fchmod": 52, "openat": 56, "close": 57, "write": 64, "writev": 66,
    "pwrite64": 68, "pwritev": 70, "sendfile": 71, "fsync": 82, "fdatasync": 83,
    "renameat2": 276, "copy_file_range": 285,
}  # fmt: skip
_TABLES: Mapping[str, Mapping[str, int]] = {"x86_64": _X86_64, "aarch64": _AARCH64}
_NUMBERS = _TABLES.get(platform.machine(), {})
_NAMES = {number: name for name, number in _NUMBERS.items()}

# What a call is, and where it says what it is about: a descriptor ("fd", place), a path
# ("path", place) or a path relative to a folder ("at", place of the folder).
_CALLS: Mapping[str, tuple[str, str, int]] = {
    "open": ("open", "path", 0), "creat": ("open", "path", 0), "openat": ("open", "at", 0),
    "write": ("write", "fd", 0), "pwrite64": ("write", "fd", 0), "writev": ("write", "fd", 0),
    "pwritev": ("write", "fd", 0), "sendfile": ("write", "fd", 0),
    "copy_file_range": ("write", "fd", 2), "ftruncate": ("write", "fd", 0),
    "fallocate": ("write", "fd", 0), "truncate": ("write", "path", 0),
    "fsync": ("fsync", "fd", 0), "fdatasync": ("fsync", "fd", 0), "close": ("close", "fd", 0),
    "rename": ("rename", "path", 1), "renameat": ("rename", "at", 2),
    "renameat2": ("rename", "at", 2), "mkdir": ("mkdir", "path", 0),
    "mkdirat": ("mkdir", "at", 0), "rmdir": ("unlink", "path", 0), "unlink": ("unlink", "path", 0),
    "unlinkat": ("unlink", "at", 0), "link": ("open", "path", 1), "linkat": ("open", "at", 2),
    "symlink": ("open", "path", 1),
    "chmod": ("chmod", "path", 0), "fchmod": ("chmod", "fd", 0),
}  # fmt: skip
_FLAGS_AT = {"open": 1, "openat": 2}

# linux/seccomp.h, linux/filter.h, linux/prctl.h
_SECCOMP = {"x86_64": 317, "aarch64": 277}
_SET_MODE_FILTER, _NEW_LISTENER = 1, 1 << 3
_ALLOW, _NOTIFY = 0x7FFF0000, 0x7FC00000
_RECEIVE, _SEND = 0xC0502100, 0xC0182101
_CONTINUE = 1
_NO_NEW_PRIVS = 38
_LOAD, _EQUAL, _ANY_BIT, _RETURN = 0x20, 0x15, 0x45, 0x06
_NOTICE, _ANSWER = struct.Struct("=QIIiIQ6Q"), struct.Struct("=QqiI")


@dataclass(frozen=True, slots=True)
class Call:
    """One thing asked of the disk.

    kind: open (to write), write, fsync, close, rename, exchange (of two names), mkdir, unlink or
    chmod. path: relative to the watched folder; of a rename the new name.
    """

    kind: str
    path: str


class Kill:
    """A verdict: the process is killed before the call is made."""


KILL = Kill()
Verdict = Callable[[int, Call], "int | Kill | None"]
"""Of the number of a call, from 0, and the call: an error number, KILL, or None to let it pass."""


@dataclass(slots=True)
class Outcome:
    """How a command ended. code: as a shell would see it, -9 when it was killed. told: what it
    wrote to standard error. calls: all that it asked for. struck: those not let pass."""

    code: int = 0
    told: str = ""
    calls: list[Call] = field(default_factory=list)
    struck: list[Call] = field(default_factory=list)


def require_watching() -> None:
    """Skip the test where the kernel cannot be asked."""
    if sys.platform != "linux" or not _NUMBERS:
        pytest.skip("system calls are watched on Linux on x86-64 and 64-bit ARM only")


def watched(work: Callable[[], object], folder: Path, verdict: Verdict) -> Outcome:
    """Run a command in a child of this process, each of its changes in a folder judged before."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        child = _Child(work, partial(_offer, theirs))
        theirs.close()
        try:
            _, descriptors, _, _ = socket.recv_fds(ours, 1, 1)
            try:
                _judge(descriptors[0], child.number, folder.resolve(), verdict, child.outcome)
            finally:
                os.close(descriptors[0])
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.number, signal.SIGKILL)
            child.wait()
    return child.outcome


def limited(work: Callable[[], object], file_bytes: int) -> Outcome:
    """Run a command in a child whose files may not grow beyond a size: to write more is an error.

    It is as good as a full disk, and needs no root.
    """
    child = _Child(work, partial(_limit, file_bytes))
    child.wait()
    return child.outcome


class _Child:
    """A fork of this process that runs a command and tells on a pipe."""

    def __init__(self, work: Callable[[], object], first: Callable[[], None]) -> None:
        self.outcome = Outcome()
        self._told, told = os.pipe()
        self.number = os.fork()
        if self.number == 0:
            _end(work, told, first)
        os.close(told)

    def wait(self) -> None:
        """Until it ends, or is killed because it hangs."""
        end_s = time.monotonic() + _LIMIT_S
        while (ended := os.waitpid(self.number, os.WNOHANG))[0] == 0:
            if time.monotonic() > end_s:
                os.kill(self.number, signal.SIGKILL)
            time.sleep(0.002)
        self.outcome.code = os.waitstatus_to_exitcode(ended[1])
        os.set_blocking(self._told, False)
        with os.fdopen(self._told, "rb") as told:
            self.outcome.told = (told.read() or b"").decode(errors="replace")


def _limit(file_bytes: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))


def _end(work: Callable[[], object], told: int, first: Callable[[], None]) -> None:
    """What the child does: never returns."""
    code = ODD
    try:
        os.setpgid(0, 0)
        os.dup2(told, 1)
        os.dup2(told, 2)
        sys.stdout = sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115
        first()
        code = run_command(work)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _offer(theirs: socket.socket) -> None:
    listener = _install()
    socket.send_fds(theirs, [b"x"], [listener])
    os.close(listener)


def _install() -> int:
    """From here on the kernel asks before each of the calls; the descriptor on which it does."""

    class Program(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("filter", ctypes.c_char_p))

    steps = [(_LOAD, 0, 0, 0)]
    for name, number in _NUMBERS.items():
        if name in _FLAGS_AT:
            flags = 16 + 8 * _FLAGS_AT[name]
            steps += [(_EQUAL, 0, 4, number), (_LOAD, 0, 0, flags), (_ANY_BIT, 0, 1, _WRITING)]
            steps += [(_RETURN, 0, 0, _NOTIFY), (_RETURN, 0, 0, _ALLOW)]
        else:
            steps += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _NOTIFY)]
    steps.append((_RETURN, 0, 0, _ALLOW))
    program = Program(len(steps), b"".join(struct.pack("=HBBI", *step) for step in steps))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_NO_NEW_PRIVS, 1, 0, 0, 0)
    listener = libc.syscall(
        _SECCOMP[platform.machine()], _SET_MODE_FILTER, _NEW_LISTENER, ctypes.byref(program)
    )
    if listener < 0:
        raise OSError(ctypes.get_errno(), "the kernel does not let itself be asked")
    return int(listener)


def _judge(listener: int, child: int, folder: Path, verdict: Verdict, outcome: Outcome) -> None:
    """Answer the kernel until the child and all that it started are gone."""
    asked = select.poll()
    asked.register(listener, select.POLLIN)
    while True:
        events = asked.poll(_LIMIT_S * 1000.0)
        assert events, "the command hangs"
        if not events[0][1] & select.POLLIN:
            return
        notice = bytearray(_NOTICE.size)
        try:
            fcntl.ioctl(listener, _RECEIVE, notice)
        except OSError:  # killed meanwhile
            continue
        number, thread, _, name, _, _, *arguments = _NOTICE.unpack(notice)
        call = _call(_NAMES[name], thread, arguments, folder)
        judged = None
        if call is not None:
            judged = verdict(len(outcome.calls), call)
            outcome.calls.append(call)
            if judged is not None:
                outcome.struck.append(call)
        if isinstance(judged, Kill):
            os.killpg(child, signal.SIGKILL)
            continue
        answer = (number, 0, 0, _CONTINUE) if judged is None else (number, 0, -judged, 0)
        with suppress(OSError):  # killed meanwhile
            fcntl.ioctl(listener, _SEND, _ANSWER.pack(*answer))


def _call(name: str, thread: int, arguments: list[int], folder: Path) -> Call | None:
    """What is asked for, if it is a change in the folder."""
    kind, how, at = _CALLS[name]
    try:
        if how == "fd":
            path = _opened(thread, arguments[at])
            if kind == "close" and not _writes(thread, arguments[at]):
                return None
        else:
            base = f"/proc/{thread}/cwd"
            if how == "at":
                descriptor = ctypes.c_int(arguments[at]).value
                at += 1
                if descriptor != _AT_CWD:
                    base = f"/proc/{thread}/fd/{descriptor}"
            path = os.path.normpath(os.path.join(os.readlink(base), _text(thread, arguments[at])))  # noqa: PTH115, PTH118
    except OSError:  # killed meanwhile, or a wrong descriptor
        return None
    if name == "renameat2" and arguments[4] == _EXCHANGING:
        kind = "exchange"
    if path != str(folder) and not path.startswith(f"{folder}/"):
        return None
    return Call(kind, path[len(str(folder)) + 1 :] or ".")


def _opened(thread: int, descriptor: int) -> str:
    return os.readlink(f"/proc/{thread}/fd/{descriptor & 0xFFFFFFFF}")  # noqa: PTH115


def _writes(thread: int, descriptor: int) -> bool:
    text = Path(f"/proc/{thread}/fdinfo/{descriptor}").read_text()
    flags = next(line for line in text.splitlines() if line.startswith("flags:"))
    return bool(int(flags.split()[1], 8) & (os.O_WRONLY | os.O_RDWR))


def _text(thread: int, address: int) -> str:
    with open(f"/proc/{thread}/mem", "rb", buffering=0) as memory:  # noqa: PTH123
        memory.seek(address)
        return memory.read(4096).split(b"\0")[0].decode(errors="surrogateescape")
