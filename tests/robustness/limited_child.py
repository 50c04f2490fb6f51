"""Children with limits: on memory and time for hostile input, on time for those that go on."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Timer


def run_limited(
    code: str, *arguments: str, memory_bytes: int = 1 << 30, seconds: int = 30
) -> subprocess.CompletedProcess[str]:
    """Run Python code with ``arguments`` as sys.argv[1:]; fails the test on death or time-out."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))

    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        capture_output=True,
        text=True,
        timeout=seconds,
        preexec_fn=limit,
        check=False,
    )
    assert done.returncode == 0, f"exit {done.returncode}: {done.stderr[-2000:]}"
    return done


def hear_interrupts() -> None:
    """In a child before its program: Ctrl-C reaches it even where the tests run in background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def running(code: str, *arguments: str, seconds: float = 60.0) -> Iterator[subprocess.Popen[str]]:
    """A child that runs Python code beside the test, its output piped.

    It dies, and all that it started in its session with it, when the block ends or after
    ``seconds``, so that nobody who reads from it waits for ever.
    """
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )

    def end() -> None:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)

    limit = Timer(seconds, end)
    limit.start()
    try:
        yield child
    finally:
        limit.cancel()
        end()
        child.communicate()
