"""Ctrl-C and SIGTERM at random moments of every command; a second process on a folder in use.

A signal goes to the process that was started, to the one that works, or, as a terminal does it,
to all of the session.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fault_processes import running
from long_run_journal import Journal, Row

COUNT = 50
STOPPED_WITHIN_S, REFUSED_WITHIN_S = 2.0, 1.0
_STARTS_S = 12.0
"""By then every command is past its imports and compiled kernels, and at work."""
_OUT = ("--out", "out")
STOPPED: tuple[tuple[str, ...], ...] = (
    ("map", "labyrinth", *_OUT),
    ("simulate", "labyrinth", *_OUT),
    ("world", "labyrinth", *_OUT),
    ("dataset", "make", "tiny", "-n", "500", *_OUT),
    ("dataset", "plan", "labyrinths"),
    ("dataset", "preview", "diverse", "-n", "100"),
    ("scenario", "all", *_OUT),
    ("identify", "turtlebot2_study", *_OUT),
    ("demo", "rotation-bug", *_OUT),
    ("bench", "slam"),
    ("bench", "accuracy", "--seeds", "2"),
    ("map", "{run}/log", *_OUT),
    ("localise", "{run}/log", "--in", "{run}", *_OUT),
    ("check", "{run}/log"),
    ("fix", "{run}/log", "out"),
    ("fault", "{run}/log", "out", "--fault", "laser_yaw:2"),
    ("evaluate", "{run}"),
    ("view", "{run}", "--web"),
    ("verify", "{run}"),
    ("recover", "{run}/log", *_OUT),
    ("dataset", "verify", "{set}", "--again", "4"),
)
REFUSED: tuple[tuple[str, ...], ...] = (
    ("map", "tiny", *_OUT),
    ("simulate", "tiny", *_OUT),
    ("world", "tiny", *_OUT),
    ("map", "{run}/log", *_OUT),
    ("localise", "{run}/log", "--in", "{run}", *_OUT),
    ("fix", "{run}/log", "out"),
    ("fault", "{run}/log", "out", "--fault", "laser_yaw:2"),
    ("dataset", "make", "tiny", *_OUT),
    ("scenario", "ramp", *_OUT),
    ("identify", "turtlebot2_study", *_OUT),
    ("demo", "rotation-bug", *_OUT),
    ("recover", "{run}/log", *_OUT),
)
_HOLDER = """
import sys, time
from pathlib import Path
from slamsim.guard.output import partial_folder
with partial_folder(Path("out")):
    print("begun", flush=True)
    time.sleep(1e6)
"""
_MADE = {
    "run": ("map", "tiny", "-q", "--out"),
    "set": ("dataset", "make", "tiny", "-n", "4", "-q", "--out"),
}


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=COUNT, help="stops, and as many refusals")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="slamsim-stops-") as folder:
        places = _made(Path(folder))
        with journal.progress("stop", chosen.count) as told:
            for number in range(chosen.count):
                name = f"stop/{number}"
                if name not in journal.names:
                    journal.add({"name": name, **_stopped(number, places)})
                told()
        with journal.progress("refuse", chosen.count) as told, _held(Path(folder)) as cwd:
            for number in range(chosen.count):
                name = f"refuse/{number}"
                if name not in journal.names:
                    journal.add({"name": name, **_refused(number, places, cwd)})
                told()
    return rows(list(journal.lines.values()), chosen.count)


def _made(folder: Path) -> dict[str, str]:
    """A run and a data set for the commands that read one."""
    for name, words in _MADE.items():
        with running(*words, name, cwd=folder) as made:
            code, told, _ = made.ended(900.0)
        assert code == 0, told
    return {name: str(folder / name) for name in _MADE}


def _stopped(number: int, places: dict[str, str]) -> dict[str, Any]:
    """Signalled while it runs; a command that is quicker than that is signalled sooner."""
    chance = random.Random(number)
    words = [word.format(**places) for word in STOPPED[number % len(STOPPED)]]
    sent = chance.choice((signal.SIGINT, signal.SIGTERM))
    to, at_s = chance.choice(("started", "working", "session")), chance.uniform(0.05, _STARTS_S)
    outcome: tuple[int, str, float] | None = None
    while outcome is None:
        with (
            tempfile.TemporaryDirectory(prefix="slamsim-stop-") as folder,
            running(*words, cwd=Path(folder)) as run,
        ):
            run.await_child()
            with suppress(subprocess.TimeoutExpired):
                run.process.wait(at_s)
            if run.process.poll() is not None:
                at_s /= 2.0
                continue
            _send(run.process.pid, run.child(), to, sent)
            outcome = run.ended()
            orphans = len(run.orphans())
            left = sorted(path.name for path in Path(folder).iterdir())
    code, told, took_s = outcome
    return {
        "command": words[:2], "sent": sent.name, "to": to, "at_s": round(at_s, 3),
        "code": code, "took_s": round(took_s, 3), "orphans": orphans, "left": left,
        "clean": code == 128 + sent and "Traceback" not in told, "told": told[-300:],
    }  # fmt: skip


def _send(started: int, working: int | None, to: str, sent: signal.Signals) -> None:
    if to == "session":
        os.killpg(started, sent)
    else:
        os.kill(working if to == "working" and working else started, sent)


@contextmanager
def _held(folder: Path) -> Iterator[Path]:
    """A folder whose ``out`` another process is writing to."""
    cwd = folder / "held"
    cwd.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", _HOLDER], cwd=cwd, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "begun\n"
        yield cwd
        holder.kill()


def _refused(number: int, places: dict[str, str], cwd: Path) -> dict[str, Any]:
    words = [word.format(**places) for word in REFUSED[number % len(REFUSED)]]
    begin_s, busy_before_s = time.monotonic(), _busy_s()
    with running(*words, cwd=cwd) as run:
        code, told, _ = run.ended()
        took_s, busy_s = time.monotonic() - begin_s, _busy_s() - busy_before_s
    right = code == 11 and "is being written by process" in told
    return {
        "command": words[:2],
        "code": code,
        "took_s": round(took_s, 3),
        "busy_s": round(busy_s, 3),
        "right": right,
        "told": told[-300:],
    }


def _busy_s() -> float:
    """What ended children took of a core."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def rows(lines: Sequence[dict[str, Any]], wanted: int) -> list[Row]:
    stops = [line for line in lines if line["name"].startswith("stop/")]
    refusals = [line for line in lines if line["name"].startswith("refuse/")]
    in_time = sum(one["clean"] and one["took_s"] <= STOPPED_WITHIN_S for one in stops)
    orphans = sum(one["orphans"] for one in stops)
    at_once = sum(one["right"] and one["took_s"] < REFUSED_WITHIN_S for one in refusals)
    return [
        _row("stopped within 2 s, in one sentence", in_time, stops, "took_s"),
        Row("processes left after 2 s", f"{orphans}", "0", orphans == 0),
        _row("second process refused within 1 s", at_once, refusals, "took_s"),
        Row("of a core, the longest", f"{max((one['busy_s'] for one in refusals), default=0.0)} s"),
        Row("cases of each", f"{min(len(stops), len(refusals))}", f"{wanted}"),
    ]


def _row(name: str, good: int, lines: Sequence[dict[str, Any]], key: str) -> Row:
    slowest_s = max((line[key] for line in lines), default=0.0)
    figure = f"{good} of {len(lines)}, the slowest {slowest_s:.2f} s"
    return Row(name, figure, f"{len(lines)} of {len(lines)}", good == len(lines))
