"""SIGKILL at random moments: what is finished stays, and the same command goes on.

A chain kills one command several times in one folder and then lets it end. Which process is
killed is drawn: the one that was started, the one that works, or all of the session.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dataset_run import tree
from fault_processes import Run, running
from long_run_journal import Journal, Row

from slamsim.run.verifying import verify_path

KILLS, DATASETS = 200, 20
_SHORT = ("--set", "drive.route.max_duration_s=8", "--set", "sensors.lidar.rate_hz=5", "-q")
COMMANDS: dict[str, tuple[str, ...]] = {
    "simulate": ("simulate", "tiny", *_SHORT, "--overwrite"),
    "map": ("map", "tiny", *_SHORT, "--overwrite"),
    "dataset": ("dataset", "make", "tiny", "-n", "4", "-q"),
}
_KILLS_OF_A_CHAIN = {"simulate": 10, "map": 10, "dataset": 4}
_LIMIT_S = 600.0
_MOST_OF_IT = 0.9


@dataclass(frozen=True, slots=True)
class Chain:
    """kind: which command. takes_s: undisturbed. right: what a data set must come to."""

    name: str
    kind: str
    takes_s: float
    right: dict[str, bytes]

    def run(self, cwd: Path, journal: Journal, told: Callable[[], None]) -> None:
        """One line for each kill, and one for the end."""
        chance = random.Random(zlib.crc32(self.name.encode()))
        if self.kind != "dataset":
            self._undisturbed(cwd)
        for number in range(_KILLS_OF_A_CHAIN[self.kind]):
            line = self._killed(cwd, chance)
            if line["code"] == 0:  # it was quicker
                break
            journal.add({"name": f"{self.name}/{number}", **line})
            told()
        code, says = self._undisturbed(cwd)
        whole = verify_path(cwd / "out").whole if self.kind != "dataset" else None
        equal = tree(cwd / "out") == self.right if self.kind == "dataset" else None
        beside = sorted(path.name for path in cwd.iterdir() if path.name != "out")
        journal.add(
            {"name": f"{self.name}/end", "code": code, "told": says, "whole": whole}
            | {"equal": equal, "beside": beside}
        )

    def _killed(self, cwd: Path, chance: random.Random) -> dict[str, Any]:
        finished = self._finished(cwd)
        at_s = chance.uniform(0.0, _MOST_OF_IT * self.takes_s)
        with running(*COMMANDS[self.kind], "--out", "out", cwd=cwd) as run:
            with suppress(subprocess.TimeoutExpired):
                run.process.wait(at_s)
            victim = chance.choice(("started", "working", "all"))
            _kill(run, victim)
            code = run.ended()[0]
            orphans = run.orphans()
        lost = sorted(finished - self._finished(cwd))
        return {"at_s": round(at_s, 3), "victim": victim, "code": code, "lost": lost} | {
            "orphans": len(orphans)
        }

    def _finished(self, cwd: Path) -> set[str]:
        """Results that are whole."""
        if self.kind == "dataset":
            return {path.parent.name for path in cwd.glob("out/*/*/sequence.json")}
        whole = (cwd / "out").is_dir() and verify_path(cwd / "out").whole
        return {"out"} if whole else set()

    def _undisturbed(self, cwd: Path) -> tuple[int, str]:
        with running(*COMMANDS[self.kind], "--out", "out", cwd=cwd) as run:
            code, told, _ = run.ended(_LIMIT_S)
        return code, told[-500:]


def _kill(run: Run, victim: str) -> None:
    with suppress(ProcessLookupError):
        if victim == "all":
            os.killpg(run.process.pid, signal.SIGKILL)
        else:
            child = run.child() if victim == "working" else None
            os.kill(child or run.process.pid, signal.SIGKILL)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=KILLS, help="kills over all commands")
    parser.add_argument("--datasets", type=int, default=DATASETS, help="data sets to be compared")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    kinds = list(COMMANDS)
    with tempfile.TemporaryDirectory(prefix="slamsim-kills-") as folder:
        for place, kind in enumerate(kinds):
            left = chosen.count - len(_lines(journal, "victim", tuple(kinds[:place])))
            sets = chosen.datasets if kind == "dataset" else 0
            _chains(kind, left // (len(kinds) - place), sets, Path(folder), journal)
    return rows(list(journal.lines.values()), chosen.count, chosen.datasets)


def _lines(journal: Journal, key: str, kinds: tuple[str, ...]) -> list[dict[str, Any]]:
    return [line for name, line in journal.lines.items() if key in line and name.startswith(kinds)]


def _chains(kind: str, kills: int, sets: int, folder: Path, journal: Journal) -> None:
    """Until there are as many kills, and as many ends."""
    takes_s, number = 0.0, 0
    right: dict[str, bytes] = {}
    with journal.progress(kind, kills) as told:
        while (
            len(_lines(journal, "victim", (kind,))) < kills
            or len(_lines(journal, "beside", (kind,))) < sets
        ):
            name = f"{kind}/{number}"
            if f"{name}/end" not in journal.names:
                if not takes_s:
                    takes_s, right = _undisturbed(kind, folder)
                cwd = folder / name.replace("/", "-")
                cwd.mkdir()
                Chain(name, kind, takes_s, right).run(cwd, journal, told)
                shutil.rmtree(cwd)
            number += 1


def _undisturbed(kind: str, folder: Path) -> tuple[float, dict[str, bytes]]:
    """(seconds, what it leaves); once before for what is compiled and kept."""
    for name in ("first", "right"):
        cwd = folder / f"{kind}-{name}"
        cwd.mkdir()
        begin_s = time.monotonic()
        with running(*COMMANDS[kind], "--out", "out", cwd=cwd) as run:
            code, told, _ = run.ended(_LIMIT_S)
        assert code == 0, told
    return time.monotonic() - begin_s, tree(cwd / "out")


def rows(lines: Sequence[dict[str, Any]], kills_wanted: int, sets_wanted: int) -> list[Row]:
    kills = [line for line in lines if "victim" in line]
    ends = [line for line in lines if "beside" in line]
    lost = sum(len(line["lost"]) for line in kills)
    orphans = sum(line["orphans"] for line in kills)
    hand_work = [end["name"] for end in ends if end["code"] != 0 or end["beside"]]
    hand_work += [end["name"] for end in ends if end["whole"] is False]
    sets = [end["equal"] for end in ends if end["equal"] is not None]
    return [
        Row("kills", f"{len(kills)}", f"{kills_wanted}", len(kills) >= kills_wanted),
        Row("finished results lost", f"{lost}", "0", lost == 0),
        Row("processes left after 2 s", f"{orphans}", "0", orphans == 0),
        Row("runs afterwards", f"{len(ends)}, {len(hand_work)} wrong", "0", not hand_work),
        Row(
            "data sets equal byte for byte",
            f"{sum(sets)} of {len(sets)}",
            f"{sets_wanted}",
            all(sets) and len(sets) >= sets_wanted,
        ),
    ]
