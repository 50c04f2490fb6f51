"""Every stage with every n-th thing that it asks of the disk failing, or the process killed there.

``python fault_nth.py EVERY GROUP:FAULTS ...`` strikes at every EVERY-th place, or where that is 0
at one of each kind of call, and prints a JSON line for each broken promise and one with the counts.
It is a program of its own because a child is forked for each case: what the tests around it have
loaded would make that slow.
"""

from __future__ import annotations

import argparse
import errno
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import support_path  # noqa: F401
from fault_disk import KILL, ODD, Call, Kill, Outcome, Verdict, watched
from fault_stages import FOLDERS, SETS, WRITERS, Stage, contents
from long_run_journal import Journal, Row

from slamsim.dataset.catalogue.verify import verify
from slamsim.guard.errors import SlamsimError
from slamsim.guard.seal import SUMS, WRITTEN_BY_US
from slamsim.run.verifying import verify_path

_GROWING = frozenset(("open", "write", "mkdir", "fsync"))


def _full(first: int, number: int, call: Call) -> int | None:
    """Once the disk is full it stays so; what needs no more room still succeeds."""
    return errno.ENOSPC if number >= first and call.kind in _GROWING else None


def _quota(first: int, number: int, call: Call) -> int | None:
    return errno.EDQUOT if number == first else None


def _broken(first: int, number: int, call: Call) -> int | None:
    """One error, after which the disk works again."""
    return errno.EIO if number == first else None


def _dying(first: int, number: int, call: Call) -> int | None:
    """Nothing can be changed from here on, not even cleaned up."""
    return errno.EIO if number >= first else None


def _killed(first: int, number: int, call: Call) -> Kill | None:
    return KILL if number == first else None


FAULTS: Mapping[str, Callable[[int, int, Call], int | Kill | None]] = {
    "full": _full,
    "quota": _quota,
    "broken": _broken,
    "dying": _dying,
    "killed": _killed,
}
_CODES: Mapping[str, tuple[int, ...]] = {
    "full": (75,),
    "quota": (75,),
    "broken": (1,),
    "dying": (1,),
    "killed": (-9,),
}


@dataclass(frozen=True, slots=True)
class Case:
    """One strike and what came of it. broken: the promises that were not kept."""

    stage: str
    fault: str
    number: int
    call: str
    code: int
    broken: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.stage}, {self.fault} {self.number}"


def strikes(
    stages: Sequence[Stage],
    faults: Sequence[str],
    every: int,
    folder: Path,
    done: Collection[str] = (),
) -> Iterator[Case]:
    """Each stage struck at its calls 0, every, 2 every ... by each of the faults, but for those
    whose names are done. every: 0 for one of each kind of call, another one with each fault."""
    for place, stage in enumerate(stages):
        campaign = _Campaign(stage, folder / str(place))
        for turn, fault in enumerate(faults):
            for number in _struck(campaign.calls, every, (turn + 0.5) / len(faults)):
                if f"{stage.name}, {fault} {number}" not in done:
                    yield campaign.strike(fault, number)


def _struck(calls: Sequence[Call], every: int, share: float) -> Sequence[int]:
    """Numbers of calls. share: where among those of its kind, 0 the first, the one is taken."""
    if every:
        return range(0, len(calls), every)
    kinds: dict[str, list[int]] = {}
    for number, call in enumerate(calls):
        kinds.setdefault(call.kind, []).append(number)
    return [numbers[int(share * len(numbers))] for numbers in kinds.values()]


class _Campaign:
    """One stage: what it finds, and what it leaves when nothing disturbs it."""

    def __init__(self, stage: Stage, folder: Path) -> None:
        self._stage, self._folder = stage, folder
        self._sound = set[str]()
        self._count = 0
        folder.mkdir()
        out = stage.prepared(folder / "before")
        self._before = self._contents(out)
        stage.work(out)
        self._whole = self._contents(out)
        self.calls = self._run(lambda number, call: None)[0].calls

    def strike(self, fault: str, number: int) -> Case:
        outcome, out = self._run(partial(FAULTS[fault], number))
        if not outcome.struck:
            return Case(self._stage.name, fault, number, "", outcome.code, ())
        found = [*self._told_wrong(fault, outcome, out), *self._left_wrong(outcome, out)]
        found += self._next_wrong(out)
        call = outcome.struck[0]
        text = f"{call.kind} {call.path}"
        return Case(self._stage.name, fault, number, text, outcome.code, tuple(found))

    def _run(self, verdict: Verdict) -> tuple[Outcome, Path]:
        self._count += 1
        place = self._folder / str(self._count)
        out = self._stage.prepared(place)
        return watched(partial(self._stage.work, out), place, verdict), out

    def _contents(self, out: Path) -> dict[str, bytes]:
        """But for what is never twice the same."""
        found = contents(out)
        return {name: data for name, data in found.items() if name not in self._stage.varies}

    def _told_wrong(self, fault: str, outcome: Outcome, out: Path) -> Iterator[str]:
        if outcome.code == ODD:
            yield f"it ends in a traceback: {outcome.told[-800:]}"
        elif outcome.code not in (0, *_CODES[fault]):
            yield f"it ends with {outcome.code}: {outcome.told}"
        elif outcome.code > 0:
            one_line = outcome.told.startswith("slamsim: ") and outcome.told.count("\n") == 1
            if not one_line or str(out) not in outcome.told:
                yield f"no sentence that names the path: {outcome.told[-800:]!r}"

    def _left_wrong(self, outcome: Outcome, out: Path) -> Iterator[str]:
        left = self._contents(out)
        if outcome.code == 0:
            if left != self._whole:
                yield f"it says that it succeeded, but {_difference(left, self._whole)}"
        elif not self._stage.in_parts:
            if left not in (self._before, self._whole):
                yield f"neither the old nor the new stands there: {_difference(left, self._whole)}"
            if out.is_dir() and not vouched(out):
                yield "what stands there is not found whole"
        else:
            yield from self._parts_wrong(left)
            if vouched(out) and left not in (self._before, self._whole):
                yield f"it is found whole, but {_difference(left, self._whole)}"

    def _parts_wrong(self, left: Mapping[str, bytes]) -> Iterator[str]:
        """Each file is the old or the new one, each sequence is there with all of its files.

        Only what says that all is finished may be gone.
        """
        for name, data in left.items():
            if data not in (self._before.get(name), self._whole.get(name)):
                yield f"{name} is neither the old nor the new one"
        for name in self._before.keys() - left.keys() - {SUMS}:
            yield f"{name} is lost"
        for folder in {_sequence(name) for name in left} - {""}:
            if _below(folder, left) != _below(folder, self._whole):
                yield f"{folder} is not whole"

    def _next_wrong(self, out: Path) -> Iterator[str]:
        """The same command again, with nothing repaired by hand."""
        state = _state(out.parent)
        if state in self._sound:
            return
        try:
            self._stage.work(out)
        except SlamsimError as error:
            taken = self._contents(out) == self._whole and "is there already" in str(error)
            if not taken:
                yield f"the next run ends with: {error}"
        if (left := self._contents(out)) != self._whole:
            yield f"after the next run {_difference(left, self._whole)}"
        if out.is_dir() and not vouched(out):
            yield "what the next run leaves is not found whole"
        beside = sorted(path.name for path in out.parent.iterdir() if path != out)
        if beside:
            yield f"the next run leaves {', '.join(beside)}"
        self._sound.add(state)


def _sequence(name: str) -> str:
    parts = name.split("/")
    return "/".join(parts[:2]) if parts[0] in ("train", "val", "test") else ""


def _below(folder: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if name.startswith(f"{folder}/")}


def vouched(out: Path) -> bool:
    """Whether ``slamsim verify`` finds it whole."""
    with suppress(SlamsimError):
        return verify_path(out).whole if (out / WRITTEN_BY_US).is_file() else verify(str(out)).whole
    return False


def _difference(left: Mapping[str, bytes], whole: Mapping[str, bytes]) -> str:
    lacking = sorted(whole.keys() - left.keys())
    more = sorted(left.keys() - whole.keys())
    other = sorted(name for name in left.keys() & whole.keys() if left[name] != whole[name])
    return f"absent {lacking[:5]}, too many {more[:5]}, other bytes {other[:5]}"


def _state(place: Path) -> str:
    """All that lies there, in one word; process numbers in names differ and do not count."""
    digest = hashlib.sha256()
    for path in sorted(place.rglob("*")):
        digest.update(f"{path.relative_to(place)}\0".encode())
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def stages_of(group: str) -> tuple[Stage, ...]:
    """Those of one group: folders, writers, sets or commands."""
    if group == "commands":
        from fault_recorded import COMMANDS

        return COMMANDS
    return {"folders": FOLDERS, "writers": WRITERS, "sets": SETS}[group]


def quick_folder() -> str | None:
    """Where waiting for the disk takes no time."""
    memory = Path("/dev/shm")
    return str(memory) if memory.is_dir() and os.access(memory, os.W_OK) else None


def options(parser: argparse.ArgumentParser) -> None:
    """Of ``long_run.py disk``."""
    parser.add_argument("--groups", default="folders,writers,sets,commands")
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--every", type=int, default=1, help="strike at every so-many-th call")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    """All cases that the journal does not have."""
    faults = chosen.faults.split(",")
    with TemporaryDirectory(dir=quick_folder()) as place:
        for group in chosen.groups.split(","):
            (folder := Path(place) / group).mkdir()
            for stage in stages_of(group):
                found = strikes([stage], faults, chosen.every, folder, journal.names)
                with journal.progress(stage.name, 0) as step:
                    for case in found:
                        journal.add({**asdict(case), "name": case.name})
                        step()
                shutil.rmtree(folder / "0")
    struck = [case for case in journal.lines.values() if case["call"]]
    broken = [case["name"] for case in struck if case["broken"]]
    figure = f"{len(broken)} of {len(struck):,}" + "".join(f"; {name}" for name in broken[:5])
    return [Row("n-th call fails: broken promises", figure, "0", not broken)]


def main(every: str, *plans: str) -> int:
    """The command; 1 if a promise was broken."""
    struck = failures = 0
    for group, _, faults in (plan.partition(":") for plan in plans):
        with TemporaryDirectory(dir=quick_folder()) as folder:
            for case in strikes(stages_of(group), faults.split(","), int(every), Path(folder)):
                struck += bool(case.call)
                failures += bool(case.broken)
                if case.broken:
                    sys.stdout.write(json.dumps(asdict(case)) + "\n")
                    sys.stdout.flush()
    sys.stdout.write(json.dumps({"struck": struck, "broken": failures}) + "\n")
    return min(failures, 1)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
