"""Exit codes: one error sentence, and clean shutdown on signals.

Little is imported here, so that Ctrl-C is in good hands before a command loads its libraries.
"""

from __future__ import annotations

import errno
import resource
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

from slamsim.guard.errors import DiskFull, SlamsimError, printable
from slamsim.guard.files import discard

AGAIN_S = 0.05
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
STOPPED = "stopped; nothing was left half-written"
UNTOUCHED = "what is finished stays, nothing half-written stands under a final name"
_CPU, _TICK_S = resource.RLIMIT_CPU, 0.1
_UNLOADED = ("failed to map segment", "annot allocate memory")
"""What the dynamic linker says where memory does not suffice for a library."""


def run_command(command: Callable[[], object]) -> int:
    """Run a command; what a user may cause ends in one sentence and an exit code.

    What was printed has arrived then: a full disk behind standard output is told as any other.
    """
    code = _ran(command)
    try:
        sys.stdout.flush()
    except OSError as error:
        error.filename = error.filename or "standard output"
        closed = error.errno == errno.EPIPE  # who reads has seen enough
        code = code if closed or code else fail(*_told(error))
        with suppress(OSError):  # else Python tries again as it ends
            discard(sys.stdout)
    return code


def _ran(command: Callable[[], object]) -> int:
    stop = _StopSignals()
    try:
        try:
            stop.heed()
            command()
        finally:
            stop.over()
    except BaseException as error:
        if stop.received is not None:
            return fail(STOPPED, 128 + stop.received)
        if isinstance(error, SlamsimError):
            return fail(str(error), error.exit_code)
        if isinstance(error, SystemExit) and isinstance(error.code, int | None):
            return error.code or 0  # the command parser ends so, after a wrong call with 2
        if _lacks_memory(error):
            return fail(f"memory ran out; {UNTOUCHED}", SlamsimError.exit_code)
        if isinstance(error, OSError):
            return fail(*_told(error))
        raise
    return 0


def _lacks_memory(error: BaseException | None) -> bool:
    """Whether that is the error, or what a library made another one of."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if isinstance(error, ImportError) and any(words in str(error) for words in _UNLOADED):
            return True
        error = error.__cause__ or error.__context__
    return False


class _Stopped(BaseException):
    """A signal to stop, on its way out through every ``finally``."""


class _StopSignals:
    """Turns the first signal to stop into an exception; later ones change nothing.

    Libraries may wrap the exception in one of their own, as imports of native modules do, so
    what counts is ``received``. They may swallow it, and Python itself cannot pass it on from a
    callback of native code or a finaliser: it is raised again until the command has ended. Never
    while an exception is being handled, for cleaning up may go on.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self._is_over = False
        self._unraisable = sys.unraisablehook

    def heed(self) -> None:
        """From here on a first signal is raised, perhaps before this returns."""
        sys.unraisablehook = self._tell_others
        for number in STOPPING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._stop)

    def over(self) -> None:
        """From here on a first signal ends the process at once: there is nothing to undo."""
        self._is_over = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = self._unraisable
        if self.received is not None:
            return  # _stop ignores what comes; SIG_IGN would let Python tell of a race
        for number in STOPPING:
            if signal.getsignal(number) == self._stop:
                signal.signal(number, signal.SIG_DFL)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self._is_over or self.received is not None:
            return
        self.received = number
        signal.signal(signal.SIGALRM, self._raise)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        self._raise(number, frame)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        if not self._is_over and sys.exc_info()[1] is None:
            raise _Stopped

    def _tell_others(self, unraisable: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraisable.exc_value, _Stopped):
            self._unraisable(unraisable)


def _told(error: OSError) -> tuple[str, int]:
    from slamsim.guard.output import disk_full

    place = error.filename or "input/output"
    if disk_full(error):
        return f"{place}: the disk is full", DiskFull.exit_code
    return f"{place}: {error.strerror or error}", SlamsimError.exit_code


def ended_by(number: int) -> str:
    """In words, for a child process that a signal has ended, and was waited for."""
    told = f"was ended by {signal.Signals(number).name}"
    used, limit_s = resource.getrusage(resource.RUSAGE_CHILDREN), resource.getrlimit(_CPU)[0]
    spent = 0 <= limit_s <= used.ru_utime + used.ru_stime + _TICK_S
    if number == signal.SIGXCPU or (number == signal.SIGKILL and spent):
        return f"{told}, as the system does at the limit of processor time ({limit_s} s, ulimit -t)"
    if number == signal.SIGKILL:
        return f"{told}, as the system does where memory runs out"
    return told


def fail(sentence: str, code: int) -> int:
    """The code, once the user has been told; where no message can be shown, the code must do."""
    lines = map(printable, f"slamsim: {sentence}".split("\n"))
    with suppress(OSError, ValueError):
        sys.stderr.write("\n".join(lines) + "\n")
        sys.stderr.flush()
    return code
