"""How a command is stopped."""

from __future__ import annotations

import subprocess
import sys

import pytest
from limited_child import hear_interrupts

SWALLOWED = """
import os, signal, sys, time
from slamsim.ending import run_command

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


SUPPRESSED = """
import os, signal, sys, time
from slamsim.ending import run_command

def command():
    try:
        try:
            os.kill(os.getpid(), signal.{name})
            time.sleep(0.005)
        except BaseException:
            pass
        time.sleep(10.0)
        print("went on")
    finally:
        time.sleep(0.2)
        print("cleaned up")

sys.exit(run_command(command))
"""
STOPPED = "slamsim: stopped; nothing was left half-written\n"


def stopped(script: str, name: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script.replace("{name}", name)],
        check=False,
        capture_output=True,
        text=True,
        timeout=30,
        preexec_fn=hear_interrupts,
    )


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_python_cannot_pass_on_stops_the_command_all_the_same(
    name: str, code: int
) -> None:
    done = stopped(SWALLOWED, name)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr == STOPPED


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_a_library_swallows_stops_the_command_and_lets_it_clean_up(
    name: str, code: int
) -> None:
    done = stopped(SUPPRESSED, name)
    assert done.returncode == code
    assert done.stdout == "cleaned up\n"
    assert done.stderr == STOPPED
