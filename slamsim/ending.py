"""How a command ends: with an exit code, in one sentence, and cleanly when it is stopped.

Little is imported here, so that Ctrl-C is in good hands before a command loads its libraries.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

from slamsim.safe.errors import DiskFull, SlamsimError, printable

AGAIN_S = 0.05
STOPPING = (signal.SIGINT, signal.SIGTERM)
STOPPED = "stopped; nothing was left half-written"


def run_command(command: Callable[[], object]) -> int:
    """Run a command; what a user may cause ends in one sentence and an exit code.

    The command parser ends the process itself: with 0, or with 2 after a wrong call.
    """
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
        if isinstance(error, OSError):
            return fail(*_told(error))
        raise
    return 0


class _Stopped(BaseException):
    """Ctrl-C or SIGTERM, on its way out through every ``finally``."""


class _StopSignals:
    """Turns the first Ctrl-C or SIGTERM into an exception; later ones change nothing.

    Libraries may wrap the exception in one of their own, as imports of native modules do, so
    what counts is ``received``. They may swallow it, and Python itself cannot pass it on from a
    callback of native code or a finaliser: it is raised again until the command has ended. Never
    while an exception is being handled, for somebody may be cleaning up.
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
        for number in STOPPING:
            if signal.getsignal(number) == self._stop:
                after = signal.SIG_DFL if self.received is None else signal.SIG_IGN
                signal.signal(number, after)

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
    from slamsim.safe.output import disk_full

    place = error.filename or "input/output"
    if disk_full(error):
        return f"{place}: the disk is full", DiskFull.exit_code
    return f"{place}: {error.strerror or error}", SlamsimError.exit_code


def fail(sentence: str, code: int) -> int:
    """The code, once the user has been told; where nobody can be, the code must do."""
    lines = map(printable, f"slamsim: {sentence}".split("\n"))
    with suppress(OSError, ValueError):
        sys.stderr.write("\n".join(lines) + "\n")
        sys.stderr.flush()
    return code
