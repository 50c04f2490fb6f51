"""A command ends when it is told to, whatever it is doing, takes all that it started with it, and
says how it ended in its exit code."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fault_processes import Run, running
from waiting import TIMEOUT_S, wait_for

pytestmark = pytest.mark.fault

STOPPED = "slamsim: stopped; nothing was left half-written\n"
BEGIN = """
import ctypes, os, signal, subprocess, sys, time
from pathlib import Path
from slamsim.process.exit_codes import run_command
from slamsim.process.children import dying_with_us
from slamsim.guard.output import partial_folder
from slamsim.process.supervisor import supervised

def deaf():
    "As native code that holds Python's lock."
    with partial_folder(Path("run")) as folder:
        (folder / "half").write_text("x")
        ctypes.PyDLL(None).sleep(1000)

def working():
    with partial_folder(Path("run")) as folder:
        (folder / "half").write_text("x")
        time.sleep(1000)

def parent():
    sleep = dying_with_us(["/bin/sleep", "1000"])
    subprocess.Popen(sleep, start_new_session=True)
    working()

def crash():
    os.kill(os.getpid(), signal.SIGSEGV)

def killed():
    os.kill(os.getpid(), signal.SIGKILL)

def greedy():
    with partial_folder(Path("run")) as folder:
        bytearray(1 << 60)

def wrapped():
    try:
        greedy()
    except MemoryError as error:
        raise RuntimeError("a library fails") from error

def unloaded():
    raise ImportError("libarrow.so: failed to map segment from shared object")

def tell():
    print("told")
    sys.exit(7)

sys.exit(supervised(lambda: run_command(globals()[sys.argv[1]])))
"""
SHELL = """
import os, signal, subprocess, sys, time
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
job = subprocess.Popen([sys.executable, "-c", sys.argv[1], "working"], process_group=0)
os.tcsetpgrp(0, job.pid)
working = f"/proc/{job.pid}/task/{job.pid}/children"
os.waitpid(job.pid, os.WUNTRACED)
time.sleep(0.2)
child = open(working).read().strip()
print("paused", open(f"/proc/{child}/stat").read().rpartition(")")[2].split()[0] == "T", flush=True)
os.killpg(job.pid, signal.SIGCONT)
print("ended", job.wait(), flush=True)
"""


def begun(run: Run, cwd: Path, processes: int) -> None:
    """Wait until it is at work, with so many processes."""

    def works() -> bool:
        assert run.process.poll() is None
        return bool(list(cwd.glob(".run.slamsim-*/new/half"))) and len(run.kin()) >= processes

    wait_for(works)


def to_started(run: Run, number: int) -> None:
    os.kill(run.process.pid, number)


def to_child(run: Run, number: int) -> None:
    child = run.child()
    assert child is not None
    os.kill(child, number)


def to_session(run: Run, number: int) -> None:
    os.killpg(run.process.pid, number)


@pytest.mark.parametrize(
    ("doing", "processes", "send", "number"),
    [  # by default each pair of two of these once
        pytest.param(*doing, send, number, marks=() if (i + j + k) % 3 == 0 else pytest.mark.slow)
        for i, doing in enumerate((("deaf", 2), ("working", 2), ("parent", 3)))
        for j, send in enumerate((to_started, to_child, to_session))
        for k, number in enumerate((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    ],
)
def test_a_command_ends_whatever_it_is_doing_and_whoever_is_told(
    doing: str,
    processes: int,
    send: Callable[[Run, int], None],
    number: signal.Signals,
    tmp_path: Path,
) -> None:
    with running(doing, cwd=tmp_path, code=BEGIN) as run:
        begun(run, tmp_path, processes)
        send(run, number)
        code, told, _ = run.ended(TIMEOUT_S)
        assert (code, told) == (128 + number, STOPPED)
        assert run.orphans() == []
    assert not (tmp_path / "run").exists()
    if doing != "deaf":
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("send", [to_started, to_child])
def test_whatever_a_command_started_is_killed_with_it(
    send: Callable[[Run, int], None], tmp_path: Path
) -> None:
    with running("parent", cwd=tmp_path, code=BEGIN) as run:
        begun(run, tmp_path, 3)
        send(run, signal.SIGKILL)
        run.ended(TIMEOUT_S)
        assert run.orphans() == []


@pytest.mark.parametrize(
    ("doing", "says"),
    [
        ("crash", "ended by SIGSEGV;"),
        ("killed", "ended by SIGKILL, as the system does where"),
        ("greedy", "slamsim: memory ran out; what is finished stays"),
        ("wrapped", "slamsim: memory ran out; what is finished stays"),
        ("unloaded", "slamsim: memory ran out; what is finished stays"),
    ],
)
def test_a_crash_is_told(doing: str, says: str, tmp_path: Path) -> None:
    with running(doing, cwd=tmp_path, code=BEGIN) as run:
        code, told, _ = run.ended(TIMEOUT_S)
    assert code == 1
    assert says in told and told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_a_command_says_and_its_code_pass_through(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", BEGIN, "tell"], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (7, "told\n", "")


def test_a_command_that_is_to_ignore_ctrl_c_does(tmp_path: Path) -> None:
    """As the shell starts what runs in the background."""
    ignoring = f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n{BEGIN}"
    with running("working", cwd=tmp_path, code=ignoring) as run:
        begun(run, tmp_path, 2)
        to_session(run, signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            run.process.wait(2.0)
        to_started(run, signal.SIGTERM)
        assert run.ended(TIMEOUT_S)[0] == 143


def test_a_terminal_that_is_closed_ends_a_command(tmp_path: Path) -> None:
    """And what it started, and what it had begun to write; there is nobody to be told."""
    shell, terminal = pty.fork()
    if shell == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-c", BEGIN, "parent"])
    wait_for(lambda: list(tmp_path.glob(".run.slamsim-*/new/half")))
    os.close(terminal)
    _, status = os.waitpid(shell, 0)
    assert os.waitstatus_to_exitcode(status) == 129
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_pauses_and_stops_a_command(tmp_path: Path) -> None:
    """Ctrl-Z and Ctrl-C as a terminal sends them: to all that runs in its foreground."""
    shell, terminal = pty.fork()
    if shell == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-c", SHELL, BEGIN])
    wait_for(lambda: list(tmp_path.glob(".run.slamsim-*/new/half")))
    os.write(terminal, b"\x1a")
    told = _read(terminal, "paused")
    os.write(terminal, b"\x03")
    told += _read(terminal, "ended")
    os.waitpid(shell, 0)
    assert "paused True" in told and "ended 130" in told
    assert told.count("slamsim: stopped; nothing was left half-written") == 1
    assert list(tmp_path.iterdir()) == []


def _read(terminal: int, until: str) -> str:
    """What it shows until the end of a line with this word; the test fails if none comes."""
    told = ""
    while until not in told or not told.endswith("\n"):
        ready, _, _ = select.select((terminal,), (), (), TIMEOUT_S)
        assert ready, told
        told += os.read(terminal, 1000).decode()
    return told
