"""Mutations of valid inputs of every format: read right, refused, or a fault of ours.

Each case is a campaign, the seed's name and a number, which together fix every random choice.
A run that is taken up again also tries anew what failed.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fault_changes import PLAIN, splice_with
from fault_judge import Outcome, Try, Verdict, attempt, judged
from fault_log_seeds import LOG_SEEDS
from fault_seeds import Change, Read, Seed, Unfit, digest
from fault_shape_seeds import SHAPE_SEEDS
from long_run_journal import Journal, Row

SEEDS: tuple[Seed, ...] = (*LOG_SEEDS, *SHAPE_SEEDS)
CASES = 100_000
_BATCH = 250
"""So many are tried by one child: to begin one takes as long as some ten cases."""


@dataclass(slots=True)
class Ground:
    """A seed written out: a folder of its own, the bytes of its files, what is read of it whole.

    path: what is read. files: by name below the folder.
    """

    seed: Seed
    folder: Path
    path: Path
    files: dict[str, bytes]
    right: dict[Read, str]

    @classmethod
    def of(cls, seed: Seed, folder: Path) -> Ground:
        """Written into a new folder."""
        folder.mkdir(parents=True)
        path = seed.make(folder)
        places = sorted(place for place in folder.rglob("*") if place.is_file())
        files = {str(place.relative_to(folder)): place.read_bytes() for place in places}
        return cls(seed, folder, path, files, {})

    def right_digest(self, read: Read) -> str:
        """Of what the untouched input gives."""
        if read not in self.right:
            self.restore()
            self.right[read] = digest(read(self.path))
        return self.right[read]

    def restore(self) -> None:
        """All files as they were made."""
        shutil.rmtree(self.folder)
        for name, data in self.files.items():
            place = self.folder / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(data)


def grounds(seeds: Sequence[Seed], folder: Path) -> list[Ground]:
    """All seeds, each read once, which also loads and compiles what the cases need."""
    made = [Ground.of(seed, folder / f"{i:02d}") for i, seed in enumerate(seeds)]
    for ground in made:
        for read in (ground.seed.read, *(read for _, read in ground.seed.rarely)):
            ground.right_digest(read)
    return made


def mutation(ground: Ground, number: int, campaign: int, donors: Sequence[bytes]) -> Try:
    """The case of this number."""
    name = f"{campaign}/{ground.seed.name}/{number}"
    rng = np.random.default_rng([campaign, zlib.crc32(ground.seed.name.encode()), number])
    read = next((r for n, r in ground.seed.rarely if rng.random() < 1.0 / n), ground.seed.read)
    damaging = not ground.seed.changes or rng.random() < 0.5
    changes = (*PLAIN, splice_with(donors)) if damaging else ground.seed.changes

    def run() -> object:
        ground.restore()
        file, changed = _changed(ground, changes, rng)
        place = ground.folder / file
        place.unlink()
        place.write_bytes(changed)
        return digest(read(ground.path))

    def judge(found: object) -> Outcome:
        if found == ground.right_digest(read):
            return "right"
        return "silent" if ground.seed.sealed and damaging else "other"

    return Try(name, run, judge)


def _changed(
    ground: Ground, changes: Sequence[Change], rng: np.random.Generator
) -> tuple[str, bytes]:
    """(file, its new bytes); one change, sometimes several."""
    for _ in range(100):
        file = sorted(ground.files)[int(rng.integers(len(ground.files)))]
        data = ground.files[file]
        try:
            for _ in range(1 if rng.random() < 0.8 else int(rng.integers(2, 5))):
                data = changes[int(rng.integers(len(changes)))](data, rng)
        except Unfit:
            continue
        return file, data
    raise AssertionError(f"no change fits {ground.seed.name}")


def verdicts(
    made: Sequence[Ground], count: int, campaign: int, done: frozenset[str] = frozenset()
) -> Iterator[Verdict]:
    """Of so many cases in all, the same number of each seed in turn, but for those done."""
    donors = [data for ground in made for data in ground.files.values() if data]
    each = -(-count // len(made))
    for first in range(0, each, _BATCH):
        numbers = range(first, min(first + _BATCH, each))
        tries = [
            tried
            for ground in made
            for number in numbers
            if (tried := mutation(ground, number, campaign, donors)).name not in done
        ]
        for begin in range(0, len(tries), _BATCH):
            yield from judged(tries[begin : begin + _BATCH])


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=CASES, help="cases over all formats")
    parser.add_argument("--campaign", type=int, default=1, help="another number, other cases")
    parser.add_argument("--formats", default="", help="only seeds whose name holds this")
    parser.add_argument("--case", default="", help="run one case here, e.g. '1/ros 1/17'")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    seeds = [seed for seed in SEEDS if chosen.case or chosen.formats in seed.name]
    with tempfile.TemporaryDirectory() as folder:
        made = grounds(seeds, Path(folder))
        if chosen.case:
            return _one(made, chosen.case)
        total = -(-chosen.count // len(made)) * len(made)
        prefix = tuple(f"{chosen.campaign}/{seed.name}/" for seed in seeds)
        done = frozenset(each.name for each in journal.verdicts(prefix) if each.good)
        with journal.progress("mutations", total, len(done)) as told:
            for verdict in verdicts(made, chosen.count, chosen.campaign, done):
                journal.add(verdict)
                told()
    return rows(journal.verdicts(prefix))


def _one(made: Sequence[Ground], case: str) -> list[Row]:
    """With the traceback of whatever is raised."""
    campaign, name, number = case.split("/")
    ground = next(ground for ground in made if ground.seed.name == name)
    donors = [data for each in made for data in each.files.values() if data]
    tried = mutation(ground, int(number), int(campaign), donors)
    verdict = attempt(tried)
    if not verdict.good:
        mutation(ground, int(number), int(campaign), donors).run()
    return [Row(case, f"{verdict.outcome} {verdict.detail}", "", verdict.good)]


def rows(found: Sequence[Verdict]) -> list[Row]:
    """The table: what came of the cases, format by format, and against the targets."""
    formats: dict[str, Counter[str]] = {}
    for verdict in found:
        formats.setdefault(verdict.name.split("/")[1], Counter())[verdict.outcome] += 1
    table = [
        Row(name, ", ".join(f"{n} {outcome}" for outcome, n in counts.most_common()))
        for name, counts in formats.items()
    ]
    total = sum((counts for counts in formats.values()), Counter[str]())
    table.append(Row("cases", f"{len(found):,} of {len(formats)} formats"))
    for outcome in ("signal", "hang", "memory", "silent", "odd", "open files"):
        table.append(Row(outcome, f"{total[outcome]}", "0", total[outcome] == 0))
    return table
