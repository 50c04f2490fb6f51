"""Entry point of the ``slamsim`` command: imports little, so that ``--help`` and Ctrl-C are
instant."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable


def main() -> None:
    """Entry point of the ``slamsim`` command."""
    run(_typed)


def run(command: Callable[[], object]) -> None:
    """Run a command in a child process, and end this one with its exit code."""
    _open_standard_streams()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing has begun: no traceback either
    from slamsim.process.exit_codes import run_command
    from slamsim.process.supervisor import supervised

    # Matrices are small here: more threads wait for each other, sevenfold on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(supervised(lambda: run_command(command)))


def _open_standard_streams() -> None:
    """Those that the shell has closed lead nowhere; else files that are opened would be them."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, open(number, "r" if number == 0 else "w", closefd=False))  # noqa: SIM115


def _typed() -> None:
    from slamsim.cli.main import app

    app()
