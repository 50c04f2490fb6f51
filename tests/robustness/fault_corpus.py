"""The hostile corpus: ``long_run.py corpus`` reads it, ``--write FOLDER`` keeps it.

Each input has a folder of its own. Every one is refused with one sentence, or read right, within
two seconds and 300 MB beyond what the process held before.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Timer

import fault_doors as doors
from fault_corpus_bags import hostile_bags
from fault_corpus_base import Hostile, one
from fault_corpus_images import hostile_images
from fault_corpus_meshes import hostile_meshes
from fault_corpus_robots import hostile_robots
from fault_corpus_texts import hostile_texts
from fault_corpus_yaml import hostile_yaml
from fault_judge import Outcome, Try, Verdict, judged
from long_run_journal import Journal, Row

CORPUS: tuple[Hostile, ...] = (
    *hostile_yaml(),
    *hostile_images(),
    *hostile_meshes(),
    *hostile_robots(),
    *hostile_bags(),
    *hostile_texts(),
)

MOST_S = 2.0
MOST_BYTES = 300 << 20
COMMAND_S = 60.0
_PROGRAM = "from slamsim.entry import main; main()"
REFUSED = (1, 3, 10)
"""Exit codes of sizes that do not fit, of a refusal, and of a file that is not there."""


def written(hostile: Hostile, corpus: Path) -> Path:
    """Writes it out; gives what is to be read."""
    folder = corpus / re.sub(r"\W+", "_", hostile.name)
    folder.mkdir(parents=True)
    hostile.fill(folder)
    return folder / hostile.file


def warmed_up(folder: Path) -> None:
    """Loads in this process what the children need, so that they do not wait for it."""
    small = "maze: {rows: 2, columns: 2}\n"
    one("warm.yaml", small)(folder)
    doors.driven_world(folder / "warm.yaml")


def verdicts(some: Sequence[Hostile], corpus: Path) -> Iterator[tuple[Hostile, Verdict]]:
    """Each is written and read in a child."""
    tries = [_try(hostile, written(hostile, corpus)) for hostile in some]
    return zip(some, judged(tries), strict=True)


def _try(hostile: Hostile, path: Path) -> Try:
    def judge(_: object) -> Outcome:
        return "silent" if hostile.words else "right"

    return Try(hostile.name, lambda: hostile.read(path), judge)


def fault_of(hostile: Hostile, verdict: Verdict) -> str:
    """What is wrong with a verdict, in words; nothing if it is as it should be."""
    expected = "refused" if hostile.words else "right"
    if verdict.outcome != expected:
        return f"{verdict.outcome} instead of {expected}: {verdict.detail}"
    if hostile.words not in verdict.detail:
        return f"{hostile.words!r} is not in: {verdict.detail}"
    if verdict.peak_bytes > MOST_BYTES:
        return f"took {verdict.peak_bytes >> 20} MiB"
    return ""


def typed(hostile: Hostile, corpus: Path) -> Verdict:
    """The same by the command line, as a process of its own with all that it imports."""
    path = written(hostile, corpus)
    begun_s = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *hostile.command, str(path.absolute())],
        cwd=corpus,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    watch = Timer(COMMAND_S, lambda: os.killpg(child.pid, signal.SIGKILL))
    watch.start()
    told = child.communicate()[1].strip()
    watch.cancel()
    name, seconds = (
        f"typed/{' '.join(hostile.command)}/{hostile.name}",
        time.perf_counter() - begun_s,
    )
    code = child.returncode
    allowed = REFUSED if hostile.words else (0,)
    outcome: Outcome = "refused" if hostile.words else "right"
    if code not in allowed or "Traceback" in told:
        outcome = "signal" if code < 0 else "odd"
    told = " ".join(told.split())
    return Verdict(name, outcome, f"exit {code}: {told[-300:]}", round(seconds, 2))


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", default="", help="only inputs whose name holds this")
    parser.add_argument("--write", type=Path, help="write the corpus here, and read nothing")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    some = [hostile for hostile in CORPUS if chosen.only in hostile.name]
    if chosen.write is not None:
        return [Row(hostile.name, str(written(hostile, chosen.write))) for hostile in some]
    found = list(_all(some, journal))
    read = [verdict for _, verdict in found if not verdict.name.startswith("typed/")]
    slowest, largest = (
        max(read, key=lambda verdict: verdict.seconds),
        max(read, key=lambda verdict: verdict.peak_bytes),
    )
    wrong = [f"{verdict.name}: {why}" for why, verdict in found if why]
    return [
        Row("inputs", f"{len(read)}", ">= 120", len(read) >= 120 or bool(chosen.only)),
        Row("by the command line", f"{len(found) - len(read)}"),
        Row("refused", f"{sum(verdict.outcome == 'refused' for verdict in read)}"),
        Row("read right", f"{sum(verdict.outcome == 'right' for verdict in read)}"),
        Row(
            "slowest", f"{slowest.seconds:.2f} s, {slowest.name}", "< 2 s", slowest.seconds < MOST_S
        ),
        Row("largest", f"{largest.peak_bytes >> 20} MiB, {largest.name}", "< 300 MB"),
        Row("neither refused nor right", "; ".join(wrong)[:2000] or "0", "0", not wrong),
    ]


def _all(some: Sequence[Hostile], journal: Journal) -> Iterator[tuple[str, Verdict]]:
    """(what is wrong with it, verdict) of each, by the doors and by the command line."""
    commands = [hostile for hostile in some if hostile.command]
    with (
        tempfile.TemporaryDirectory() as folder,
        journal.progress("corpus", len(some) + len(commands)) as told,
    ):
        warmed_up(Path(folder))
        for hostile, verdict in verdicts(some, Path(folder, "read")):
            journal.add(verdict)
            told()
            yield fault_of(hostile, verdict), verdict
        for hostile in commands:
            verdict = typed(hostile, Path(folder, "typed"))
            journal.add(verdict)
            told()
            yield ("" if verdict.good else f"{verdict.outcome}: {verdict.detail}"), verdict
