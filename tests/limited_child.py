"""Running hostile input where it can do no harm: a child with limits on memory and time."""

from __future__ import annotations

import resource
import subprocess
import sys
import textwrap


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
