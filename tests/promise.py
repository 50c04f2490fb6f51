"""Any command in any tree of user files, ended in any way: nothing of the user's is changed.

``python promise.py --seeds FIRST:LAST`` runs those cases and prints a JSON line for each. It is a
program of its own, as each case is a fork of it: it loads what commands need, and starts no thread.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import random
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from long_run_journal import Journal, Row
    from promise_commands import Command
    from promise_endings import Ended, Ending

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
_LOADED = (
    *("slamsim.cli", "slamsim.run.checking", "slamsim.run.fixing", "slamsim.run.faulting"),
    *("slamsim.run.recovering", "slamsim.run.verifying", "slamsim.run.evaluation"),
    *("slamsim.run.world", "slamsim.view.check_page", "slamsim.dataset.preview"),
    *("slamsim.dataset.verify", "slamsim.config.loading", "slamsim.config.dump"),
)
"""None of Open3D, PyBullet, GTSAM and Rerun: they have threads of their own."""
_FAST_S, _SLOW_S = 30.0, 180.0
_MEMORY = Path("/dev/shm")


@dataclass(frozen=True)
class Case:
    """One command. broken: the promises that were not kept."""

    name: str
    typed: str
    ending: str
    code: int
    seconds: float
    broken: list[str]


def case(seed: int, place: Path, masters: Path, *, slow: bool) -> Case:
    """What follows from a seed alone, but for the moment at which a signal arrives."""
    from promise_commands import draw
    from promise_oracle import Before
    from promise_tree import build

    begin_s = time.monotonic()
    chance = random.Random(seed)
    tree = build(place, masters, chance)
    command = draw(tree)
    while command.slow and not slow:
        command = draw(tree)
    ending = _ending(command, chance)
    before = Before.of(place)
    ended, broken = _judged(command, place, ending, before)
    how = f"{ending.kind} {ending.after:.3g}" if ending.after else ending.kind
    told = [text.replace(f"{place}/", "") for text in broken]
    seconds = round(time.monotonic() - begin_s, 2)
    return Case(f"seed {seed}", shlex.join(command.typed), how, ended.code, seconds, told)


def _ending(command: Command, chance: random.Random) -> Ending:
    from promise_endings import Ending

    seconds = 10 ** chance.uniform(-2.0, 1.0 if command.slow else 0.4)
    number = int(10 ** chance.uniform(0.0, 2.3))
    size = int(10 ** chance.uniform(0.0, 6.0))
    kinds = {
        Ending(): 50,
        Ending("SIGKILL", seconds): 10,
        Ending("SIGTERM", seconds): 13,
        Ending("file size", size): 9,
        Ending("SIGKILL at a change", number): 0 if command.slow else 10,
        Ending("full at a change", number): 0 if command.slow else 8,
    }
    return chance.choices(list(kinds), list(kinds.values()))[0]


def _judged(
    command: Command, place: Path, ending: Ending, before: Any
) -> tuple[Ended, list[str]]:
    """What came of it, and of the same command once more where the first was struck."""
    from promise_endings import Ending, run
    from promise_oracle import Before, Judge, unmarked

    limit_s = _SLOW_S if command.slow else _FAST_S
    ended = run(command.typed, place, ending, limit_s)
    judge, after = Judge(place, command, before, set()), Before.of(place)
    broken = list(judge.broken(ended, ending, _without_tmp(after.there, place, ending)))
    hidden = judge.hidden(set(after.there))
    broken += unmarked(hidden)
    if ending.kind != "let run" and ended.code not in (0, 2, 3):
        again = run(command.typed, place, Ending(), limit_s)
        at_last, judge = Before.of(place), Judge(place, command, after, hidden)
        broken += [f"next run: {text}" for text in judge.broken(again, Ending(), at_last.there)]
        stays = [path for path in sorted(hidden) if path in at_last.there]
        if stays and again.code == 0:
            broken.append(f"next run: remains stay: {stays[0]}")
    return ended, broken


def _without_tmp(there: Any, place: Path, ending: Ending) -> Any:
    """A killed process cannot empty the folder of temporary files."""
    if not ending.is_kill:
        return there
    return {path: entry for path, entry in there.items() if not path.startswith(f"{place}/tmp/")}


def cases(
    seeds: Sequence[int], masters: Path, *, jobs: int, slow: bool
) -> Iterator[dict[str, Any]]:
    """In forks of this process, so many at a time."""
    folder = Path(mkdtemp(prefix="promise-", dir=_MEMORY if _MEMORY.is_dir() else None))
    running: dict[int, tuple[int, int]] = {}
    left = list(reversed(seeds))
    try:
        while left or running:
            while left and len(running) < jobs:
                seed = left.pop()
                told, tells = os.pipe()
                if (child := os.fork()) == 0:
                    _tell(tells, seed, folder / str(seed), masters, slow)
                os.close(tells)
                running[child] = seed, told
            child, status = os.wait()
            seed, told = running.pop(child)
            with os.fdopen(told) as file:
                text = file.read()
            yield json.loads(text or json.dumps(_lost(seed, status)))
            shutil.rmtree(folder / str(seed), ignore_errors=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _lost(seed: int, status: int) -> dict[str, Any]:
    told = f"the case itself failed: {os.waitstatus_to_exitcode(status)}"
    return Case(f"seed {seed}", "", "", 0, 0.0, [told]).__dict__


def _tell(tells: int, seed: int, place: Path, masters: Path, slow: bool) -> None:
    """What the fork for a case does: never returns."""
    code = 1
    try:
        place.mkdir()
        with os.fdopen(tells, "w") as file:
            json.dump(case(seed, place, masters, slow=slow).__dict__, file)
        code = 0
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        os._exit(code)


def _main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:100", metavar="FIRST:LAST")
    parser.add_argument("--inputs", type=Path, help="where they are, or are made and kept")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--slow", action="store_true", help="commands that take seconds, too")
    chosen = parser.parse_args()
    first, last = map(int, chosen.seeds.split(":"))
    for name in _LOADED:
        importlib.import_module(name)
    inputs = chosen.inputs or Path(mkdtemp(prefix="promise-inputs-")) / "inputs"
    try:
        if not inputs.is_dir():
            _make(inputs, whole=chosen.slow)
        found = cases(range(first, last), inputs.resolve(), jobs=chosen.jobs, slow=chosen.slow)
        for line in found:
            sys.stdout.write(f"{json.dumps(line)}\n")
            sys.stdout.flush()
    finally:
        if chosen.inputs is None:
            shutil.rmtree(inputs.parent)
    return 0


def _make(inputs: Path, *, whole: bool) -> None:
    """In processes of their own: what they start stays out of this one."""
    from promise_inputs import make_inputs

    def command(typed: Sequence[str], folder: Path) -> int:
        code = "from slamsim.entry import main; main()"
        return subprocess.run([sys.executable, "-c", code, *typed], cwd=folder, check=False).returncode

    make_inputs(inputs, command, whole=whole)


if __name__ == "__main__":
    sys.exit(_main())
