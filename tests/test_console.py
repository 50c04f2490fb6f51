"""How a command is stopped."""

from __future__ import annotations

import subprocess
import sys

import pytest

SWALLOWED = """
import os, signal, sys, time
from slamsim.console import run_command

class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0)

def command():
    for _ in range(2000):
        Finalised() if _ == 0 else time.sleep(0.005)
    print("went on")

sys.exit(run_command(command))
"""


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_python_cannot_pass_on_stops_the_command_all_the_same(
    name: str, code: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED.replace("{name}", name)],
        check=False,
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr == "slamsim: stopped; nothing was left half-written\n"
