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
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

import support_path  # noqa: F401

if TYPE_CHECKING:
    from long_run_journal import Journal, Row
    from promise_arguments import Command
    from promise_endings import Ended, Ending

_LOADED = (
    *("slamsim.cli.main", "slamsim.run.checking", "slamsim.run.fixing"),
    *("slamsim.run.recovering", "slamsim.run.verifying", "slamsim.run.evaluation"),
    *(
        "slamsim.run.recording",
        "slamsim.dataset.recipe.preview",
        "slamsim.dataset.catalogue.verify",
    ),
    *("promise_tree", "promise_commands", "promise_endings", "promise_oracle"),
    *("slamsim.config.loading", "slamsim.config.dump", "matplotlib.figure"),
)
"""Nothing that loads Open3D, PyBullet or Rerun: they have threads of their own."""
_FAST_S, _SLOW_S = 60.0, 240.0
"""A command that is not done by then hangs: twenty times what it takes on an idle machine."""
_MEMORY = Path("/dev/shm")


@dataclass(frozen=True)
class Case:
    """One command. told: the end of what it said. broken: the promises that were not kept."""

    name: str
    typed: str
    ending: str
    code: int
    seconds: float
    told: str
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
    how = f"{ending.kind}, {ending.after:.3g}" if ending.after else ending.kind
    seconds = round(time.monotonic() - begin_s, 2)
    typed, last, *told = (
        text.replace(str(place), "TREE")
        for text in (shlex.join(command.typed), ended.told[-300:], *broken)
    )
    return Case(f"seed {seed}", typed, how, ended.code, seconds, last, told)


def _ending(command: Command, chance: random.Random) -> Ending:
    from promise_endings import Ending

    seconds = 10 ** chance.uniform(-2.0, 1.0 if command.slow else 0.4)
    number = int(10 ** chance.uniform(0.0, 2.3))
    size = int(10 ** chance.uniform(0.0, 6.0))
    kinds = {
        Ending(): 0 if command.endless else 50,
        Ending("SIGKILL", seconds): 10,
        Ending("SIGTERM", seconds): 13,
        Ending("file size", size): 0 if command.endless else 9,
        Ending("SIGKILL at a change", number): 0 if command.slow else 10,
        Ending("full at a change", number): 0 if command.slow else 8,
    }
    return chance.choices(list(kinds), list(kinds.values()))[0]


def _judged(command: Command, place: Path, ending: Ending, before: Any) -> tuple[Ended, list[str]]:
    """What came of it, and of the same command once more where the first was struck."""
    from promise_endings import Ending, run
    from promise_oracle import Before, Judge, unmarked

    limit_s = _SLOW_S if command.slow else _FAST_S
    ended = run(command.typed, place, ending, limit_s)
    judge, after = Judge(place, command, before, set()), Before.of(place)
    broken = list(judge.broken(ended, ending, _without_tmp(after.there, place, ending)))
    hidden = judge.hidden(set(after.there))
    broken += unmarked(hidden)
    if ending.kind != "let run" and ended.code not in (0, 2, 3) and not command.endless:
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


def lines_of(
    seeds: range, inputs: Path | None, *, jobs: int, slow: bool
) -> Iterator[dict[str, Any]]:
    """What comes of these seeds, in a program of its own; inputs: where they are kept."""
    options = ["--seeds", f"{seeds.start}:{seeds.stop}", "--jobs", str(jobs)]
    options += ["--slow"] if slow else []
    options += ["--inputs", str(inputs)] if inputs is not None else []
    program = [sys.executable, __file__, *options]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as found:
        assert found.stdout is not None
        yield from map(json.loads, found.stdout)
    assert found.returncode == 0, "the program that runs the cases failed"


def repeat(line: Mapping[str, Any], *, slow: bool = False) -> str:
    """The command that runs this one case again."""
    seed = int(line["name"].split()[1])
    more = " --slow" if slow else ""
    return f"{sys.executable} {__file__} --seeds {seed}:{seed + 1}{more}"


def options(parser: argparse.ArgumentParser) -> None:
    """Of ``long_run.py promise``."""
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=2)


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    """All cases that the journal does not have."""
    from long_run_journal import Row

    inputs = chosen.out / "promise-inputs"
    done = {int(name.split()[1]) for name in journal.names}
    with journal.progress("commands", chosen.count, len(done)) as told:
        for seeds in _gaps(done, chosen.count):
            for line in lines_of(seeds, inputs, jobs=chosen.jobs, slow=True):
                journal.add(line)
                told()
    lines = list(journal.lines.values())
    broken = [line for line in lines if line["broken"]]
    ends = Counter(f"{line['ending'].split(',')[0]}: {line['code']}" for line in lines)
    return [
        Row("commands", f"{len(lines)}", f"{chosen.count}", len(lines) >= chosen.count),
        Row("that broke the promise", f"{len(broken)}", "0", not broken),
        *(Row(name, f"{number}") for name, number in sorted(ends.items())),
        *(Row(line["name"], repeat(line, slow=True)) for line in broken[:20]),
    ]


def _gaps(done: set[int], count: int) -> Iterator[range]:
    """The numbers below count that are not done, in pieces."""
    left = [seed for seed in range(count) if seed not in done]
    while left:
        length = 1
        while length < len(left) and left[length] == left[0] + length:
            length += 1
        yield range(left[0], left[0] + length)
        left = left[length:]


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
    return Case(f"seed {seed}", "", "", 0, 0.0, "", [told]).__dict__


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
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))  # of compiled kernels
    for name in _LOADED:
        importlib.import_module(name)
    inputs = chosen.inputs or Path(mkdtemp(prefix="promise-inputs-")) / "inputs"
    try:
        if not inputs.is_dir():
            _make(inputs, whole=chosen.slow)
        _compile(inputs / "log.clf")
        found = cases(range(first, last), inputs.resolve(), jobs=chosen.jobs, slow=chosen.slow)
        for line in found:
            sys.stdout.write(f"{json.dumps(line)}\n")
            sys.stdout.flush()
    finally:
        if chosen.inputs is None:
            shutil.rmtree(inputs.parent)
    return 0


def _compile(recording: Path) -> None:
    """Here, so that no case has to: kernels are compiled, or loaded, at their first call."""
    from slamsim.console.reporter import Reporter
    from slamsim.run.checking import check_log

    check_log(recording, Reporter(quiet=True))


def _make(inputs: Path, *, whole: bool) -> None:
    """In processes of their own: what they start stays out of this one."""
    from promise_inputs import make_inputs

    def command(typed: Sequence[str], folder: Path) -> int:
        code = "from slamsim.entry import main; main()"
        return subprocess.run(
            [sys.executable, "-c", code, *typed], cwd=folder, check=False
        ).returncode

    make_inputs(inputs, command, whole=whole)


if __name__ == "__main__":
    sys.exit(_main())
