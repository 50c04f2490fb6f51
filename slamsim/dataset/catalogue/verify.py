"""Verifies that a data set is complete and that no byte has changed.

``SHA256SUMS`` holds the checksums of itself and of what stands beside the sequences, the manifest
those of each ``sequence.json``, and that those of the files of its sequence: the file that is
damaged is named, and nothing else is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from slamsim.core.progress import Progress, silent
from slamsim.dataset.catalogue.statistics import MANIFEST
from slamsim.dataset.make.identity import IDENTITY, read_identity
from slamsim.dataset.make.sequence_check import (
    EXTRA,
    Checked,
    SequenceFinding,
    check_sequence,
    file_faults,
    is_hidden,
    make_again,
    require_same_software,
)
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.recipe.sequence import SPLITS
from slamsim.dataset.store.lazy_table import Row, rows_from_parquet
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.seal import SUMS, SumsDamaged, read_sums

_AT_ONCE = 256
"""So many sequences, of perhaps a million, are handed to the readers at a time."""


@dataclass(frozen=True, slots=True)
class Verification:
    """What was looked at, and what is not as it was made.

    sequences: that there are to be. failed: those that could not be made, as the manifest says.
    checked: those of the others that were read, size_bytes of them. again: indices of those made
    once more.
    """

    address: str
    sequences: int
    failed: int
    checked: int
    again: tuple[int, ...]
    files: int
    size_bytes: int
    findings: tuple[SequenceFinding, ...]

    @property
    def whole(self) -> bool:
        """Whether nothing was found."""
        return not self.findings


def verify(
    address: str,
    *,
    share: float = 1.0,
    again: int = 0,
    workers: int | None = None,
    progress: Progress = silent,
) -> Verification:
    """Read a data set and compare it with what was written down when it was made.

    address: a folder or URL. share: of the sequences, evenly spread; the catalogue is always read
    whole. again: so many sequences are made once more and compared byte for byte. workers: how
    many read, or make, at a time.

    Raises NotFound where there is no data set, SlamsimError where it cannot be read, and where
    sequences are to be made again with other software than that which made them.
    """
    place = Location(address)
    if place.read(IDENTITY) is None and place.read(SUMS) is None:
        raise NotFound(f"{address} holds no data set: there is no {IDENTITY}")
    with ThreadPoolExecutor(workers) as readers:
        catalogue = check_catalogue(place, readers)
        again = again if catalogue.identity_is_sound else 0
        if again:
            require_same_software(place)
        rows = [row for row in catalogue.rows if row["status"] == MADE]
        chosen = spread(rows, max(round(share * len(rows)), 1))
        total = len(chosen) + again
        checked = list[Checked]()
        for one in _checked(place, chosen, readers):
            checked.append(one)
            progress(len(checked), total)
    sound = [row for row, one in zip(chosen, checked, strict=True) if not one.findings]
    twice = tuple(_index(row) for row in spread(sound, again))
    remade = list[SequenceFinding]()
    for number, findings in enumerate(make_again(place, twice, workers), start=len(checked) + 1):
        remade += findings
        progress(number, total)
    of_sequences = (finding for one in checked for finding in one.findings)
    return Verification(
        address=address,
        sequences=catalogue.count,
        failed=len(catalogue.rows) - len(rows),
        checked=len(checked),
        again=twice,
        files=catalogue.files + sum(one.files for one in checked),
        size_bytes=sum(one.size_bytes for one in checked),
        findings=(*catalogue.findings, *of_sequences, *remade),
    )


def _checked(place: Location, rows: Sequence[Row], readers: Executor) -> Iterator[Checked]:
    """One after the other, some of them being read meanwhile."""
    for first in range(0, len(rows), _AT_ONCE):
        yield from readers.map(partial(_check, place), rows[first : first + _AT_ONCE])


def spread(rows: Sequence[Row], number: int) -> list[Row]:
    """So many of the rows, or all, evenly spread."""
    number = min(number, len(rows))
    return [rows[place * len(rows) // number] for place in range(number)]


def _check(place: Location, row: Row) -> Checked:
    return check_sequence(place, _index(row), str(row["name"]), str(row["sha256"]))


def _index(row: Row) -> int:
    return int(str(row["index"]))


_NEEDED = ("index", "name", "status", "sha256")
_ALSO = frozenset(("logs", "shards", SUMS, *SPLITS))
"""Beside what ``SHA256SUMS`` lists; logs are no part of the data."""


@dataclass(frozen=True, slots=True)
class Catalogue:
    """count: of the sequences that there are to be. rows: of those that are told of.

    They come from the manifest, or from the shards where that is damaged. files: looked at.
    """

    count: int
    rows: Sequence[Row]
    files: int
    findings: tuple[SequenceFinding, ...]

    @property
    def identity_is_sound(self) -> bool:
        """Whether ``dataset.yaml`` is as it was written."""
        return all(finding.path not in (IDENTITY, SUMS) for finding in self.findings)


def check_catalogue(place: Location, readers: Executor) -> Catalogue:
    """Every file beside the sequences, completeness, and that nothing else lies there."""
    sums, findings = _sums(place)

    def look(path: str) -> list[SequenceFinding]:
        return [SequenceFinding(path, reason) for reason in file_faults(place, path, sums[path])]

    for found in readers.map(look, sorted(sums)):
        findings += found
    bad = frozenset(finding.path for finding in findings)
    rows, all_told = _rows(place, bad)
    told, unread = _count(place, bad)
    count = len(rows) if told is None else told
    findings += unread
    if all_told:
        findings += _incomplete(rows, count)
        findings += _extra(place, sums, rows)
    return Catalogue(count, rows, 1 + len(sums), tuple(findings))


def _sums(place: Location) -> tuple[dict[str, str], list[SequenceFinding]]:
    data = place.read(SUMS)
    try:
        sums = {} if data is None else read_sums(data)
    except SumsDamaged:
        reason = "not as it was written, so that what it lists cannot be judged"
        return {}, [SequenceFinding(SUMS, reason)]
    told = "missing" if data is None else "tells of no file"
    return sums, [] if sums else [SequenceFinding(SUMS, f"{told}: the data set was never finished")]


def _rows(place: Location, bad: Collection[str]) -> tuple[list[Row], bool]:
    """The rows, and whether there should be one of every sequence among them."""
    if MANIFEST not in bad and (rows := _read_rows(place, MANIFEST, _NEEDED)) is not None:
        return rows, True
    shards = [f"shards/{name}" for name in sorted(place.names("shards")) if not is_hidden(name)]
    found = [None if path in bad else _read_rows(place, path) for path in shards]
    return [row for rows in found for row in rows or ()], None not in found


def _read_rows(
    place: Location, path: str, columns: Sequence[str] | None = None
) -> list[Row] | None:
    try:
        return list(rows_from_parquet(place.read(path) or b"", columns))
    except ValueError:
        return None


def _count(place: Location, bad: Collection[str]) -> tuple[int | None, list[SequenceFinding]]:
    """How many sequences there are to be, if ``dataset.yaml`` can be read."""
    if IDENTITY in bad:
        return None, []
    try:
        identity = read_identity(place)
    except InputRefused as error:
        return None, [SequenceFinding(IDENTITY, str(error))]
    return (None, []) if identity is None else (int(identity["sequences"]), [])


def _incomplete(rows: Sequence[Row], count: int) -> Iterator[SequenceFinding]:
    """Whether every index is there once."""
    times = Counter(row["index"] for row in rows)
    missing = [index for index in range(count) if index not in times]
    if missing:
        reason = (
            f"tells nothing of {len(missing):,} of {count:,} sequences; the first: {missing[0]}"
        )
        yield SequenceFinding(MANIFEST, reason)
    for index, number in times.items():
        if number > 1 or not isinstance(index, int) or not 0 <= index < count:
            yield SequenceFinding(
                MANIFEST, f"sequence {index} is there {number} times, of {count:,}"
            )


def _extra(
    place: Location, sums: Mapping[str, str], rows: Sequence[Row]
) -> Iterator[SequenceFinding]:
    """Whatever else lies in the folders of the data set."""
    if not sums:
        return
    named = {*sums, *(str(row["name"]) for row in rows if row["status"] == MADE)}
    folders = {path.partition("/")[0] for path in named if "/" in path}
    paths = [
        *sorted(place.names("") - _ALSO - folders),
        *(f"{folder}/{name}" for folder in sorted(folders) for name in sorted(place.names(folder))),
    ]
    for path in paths:
        if path not in named and not is_hidden(path):
            yield SequenceFinding(path, EXTRA)
