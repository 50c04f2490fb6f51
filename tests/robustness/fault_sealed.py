"""One to eight bytes changed in what slamsim wrote: seen by whoever reads it, named by verify.

Each case changes one file of one sealed folder in place, size and time of last change as before.
Everything that reads that file must refuse it, and ``slamsim verify`` must name it and no other.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from fault_sealed_folders import KINDS, Sealed
from fault_seeds import digest
from long_run_journal import Journal, Row

from slamsim.dataset.store import lazy_table
from slamsim.guard import seal
from slamsim.guard.errors import SlamsimError

CASES = 2000

_watched: list[set[str] | None] = [None]


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _watched[0] is not None and isinstance(arguments[0], str | os.PathLike):
        _watched[0].add(os.path.realpath(arguments[0]))


sys.addaudithook(_watch)


@contextmanager
def opened() -> Iterator[set[str]]:
    """The files that the block opens."""
    _watched[0] = found = set[str]()
    try:
        yield found
    finally:
        _watched[0] = None


@dataclass(frozen=True, slots=True)
class Ground:
    """files: by name below the folder. right: what each reader gives, and what it opens."""

    sealed: Sealed
    files: Mapping[str, bytes]
    right: Mapping[str, str]
    opens: Mapping[str, frozenset[str]]

    @classmethod
    def of(cls, sealed: Sealed) -> Ground:
        """Every reader run once."""
        root = sealed.folder.resolve()
        paths = [str(place.relative_to(root)) for place in root.rglob("*") if place.is_file()]
        files = {path: (root / path).read_bytes() for path in sorted(paths) if _is_data(path)}
        right, opens = dict[str, str](), dict[str, frozenset[str]]()
        for name, reader in sealed.readers.items():
            _forget()
            with opened() as found:
                right[name] = digest(reader(root))
            inside = (Path(path) for path in found if Path(path).is_relative_to(root))
            opens[name] = frozenset(str(path.relative_to(root)) for path in inside)
        return cls(replace(sealed, folder=root), files, right, opens)

    def readers_of(self, file: str) -> list[str]:
        """Names of the readers that open a file."""
        return [name for name, files in self.opens.items() if file in files]


def _is_data(path: str) -> bool:
    """The logs of a data set's making are no part of it."""
    return not path.startswith("logs/")


def _forget() -> None:
    """As in a process that has read nothing yet."""
    for kept in (lazy_table._footer, lazy_table._group, seal._seal, seal._digest):
        kept.cache_clear()


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """One to eight bytes are others: side by side, or anywhere."""
    count = min(int(rng.integers(1, 9)), len(data))
    first = int(rng.integers(len(data) - count + 1))
    places = first + np.arange(count)
    if rng.random() < 0.5:
        places = rng.choice(len(data), count, replace=False)
    found = bytearray(data)
    for place in places:
        found[place] ^= int(rng.integers(1, 256))
    return bytes(found)


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit of one byte is another."""
    found = bytearray(data)
    found[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(found)


def case(ground: Ground, number: int, campaign: int) -> dict[str, Any]:
    """What came of one change: seen, silent or odd; whether verify names it and nothing else."""
    rng = np.random.default_rng([campaign, len(ground.files), number])
    chosen = _file(ground, rng)
    data = ground.files[chosen]
    change = flipped if number % 2 else changed
    path = ground.sealed.folder / chosen
    times = path.stat()
    path.write_bytes(change(data, rng))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    try:
        readers = ground.readers_of(chosen)
        outcomes = {name: _outcome(ground, name) for name in readers}
        named = ground.sealed.damaged(ground.sealed.folder)
    finally:
        path.write_bytes(data)
    return {
        "name": f"{campaign}/{ground.sealed.name}/{number}",
        "file": chosen,
        "change": change.__name__,
        "readers": len(readers),
        "outcomes": {name: outcome for name, outcome in outcomes.items() if outcome != "seen"},
        "named": named == {path.name},
    }


def _file(ground: Ground, rng: np.random.Generator) -> str:
    """Any file, every kind as often as any other."""
    kinds: dict[str, list[str]] = {}
    for name, data in sorted(ground.files.items()):
        if data:
            kinds.setdefault(Path(name).suffix or name, []).append(name)
    kind = list(kinds.values())[int(rng.integers(len(kinds)))]
    return kind[int(rng.integers(len(kind)))]


def _outcome(ground: Ground, name: str) -> str:
    _forget()
    try:
        found = digest(ground.sealed.readers[name](ground.sealed.folder))
    except SlamsimError:
        return "seen"
    except Exception as error:
        return f"odd: {type(error).__name__}: {error}"[:200]
    return "unhurt" if found == ground.right[name] else "silent"


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=CASES, help="cases over all kinds of folders")
    parser.add_argument("--campaign", type=int, default=1, help="another number, other cases")


def run(chosen: argparse.Namespace, journal: Journal) -> list[Row]:
    with tempfile.TemporaryDirectory() as scratch:
        home = Path(scratch)
        grounds = [Ground.of(kind(home / kind.__name__)) for kind in KINDS]
        names = [f"{chosen.campaign}/{ground.sealed.name}/" for ground in grounds]
        each = -(-chosen.count // len(grounds))
        with journal.progress("sealed", each * len(grounds)) as told:
            for ground, name in zip(grounds, names, strict=True):
                for number in range(each):
                    if f"{name}{number}" not in journal.names:
                        journal.add(case(ground, number, chosen.campaign))
                    told()
    lines = [line for name, line in journal.lines.items() if name.startswith(tuple(names))]
    return rows(lines)


def rows(lines: Sequence[Mapping[str, Any]]) -> list[Row]:
    """The table of a campaign."""
    outcomes = Counter(found.split(":")[0] for line in lines for found in line["outcomes"].values())
    flips = [line for line in lines if line["change"] == "flipped"]
    named = sum(line["named"] for line in lines)
    named_flips = sum(line["named"] for line in flips)
    reads = sum(line["readers"] for line in lines)
    return [
        Row("changes", f"{len(lines):,} in {len({line['file'] for line in lines}):,} files"),
        Row("reads of a changed file", f"{reads:,}"),
        Row("silent", f"{outcomes['silent']:,}", "0", outcomes["silent"] == 0),
        Row("odd exceptions", f"{outcomes['odd']:,}", "0", outcomes["odd"] == 0),
        Row("read rightly all the same", f"{outcomes['unhurt']:,}"),
        Row("single flips named by verify", f"{named_flips:,} of {len(flips):,}", "all",
            named_flips == len(flips)),
        Row("changes named by verify, nothing else", f"{named:,} of {len(lines):,}", "all",
            named == len(lines)),
    ]  # fmt: skip
