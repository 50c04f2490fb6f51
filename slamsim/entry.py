"""Where the ``slamsim`` command begins: with next to nothing loaded, so that it can be stopped."""

from __future__ import annotations

import os
import signal
import sys


def main() -> None:
    """Entry point of the ``slamsim`` command."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing has begun: no traceback either
    from slamsim.ending import run_command
    from slamsim.supervisor import supervised

    # Matrices are small here: more threads wait for each other, sevenfold on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(supervised(lambda: run_command(_typed)))


def _typed() -> None:
    from slamsim.cli import app

    app()
