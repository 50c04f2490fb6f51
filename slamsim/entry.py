"""Where the ``slamsim`` command begins: with next to nothing loaded, so that it can be stopped."""

from __future__ import annotations

import os
import sys

from slamsim.ending import run_command
from slamsim.supervisor import supervised


def main() -> None:
    """Entry point of the ``slamsim`` command."""
    # Matrices are small here: more threads wait for each other, sevenfold on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(supervised(lambda: run_command(_typed)))


def _typed() -> None:
    from slamsim.cli import app

    app()
