"""What a typed command does, without a process of its own."""

from __future__ import annotations

import contextlib
import io
import signal
from pathlib import Path
from subprocess import CompletedProcess

from slamsim.cli.main import app
from slamsim.process.exit_codes import STOPPING, run_command


def typed(*words: object, cwd: Path) -> CompletedProcess[str]:
    """Exit code, stdout and stderr."""
    arguments = [str(word) for word in words]
    out, err = io.StringIO(), io.StringIO()
    handlers = {number: signal.getsignal(number) for number in STOPPING}
    try:
        with (
            contextlib.chdir(cwd),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            code = run_command(lambda: app(arguments))
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return CompletedProcess(arguments, code, out.getvalue(), err.getvalue())
