"""Verifies that a data set is complete and that no byte has changed.

``SHA256SUMS`` holds the checksums of itself and of what stands beside the sequences, the manifest
those of each ``sequence.json``, and that those of the files of its sequence: the file that is
damaged is named, and nothing else is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from slamsim.core.progress import Progress, silent
from slamsim.dataset.catalogue.check import check_catalogue
from slamsim.dataset.make.again import make_again, require_same_software
from slamsim.dataset.make.identity import IDENTITY
from slamsim.dataset.make.sequence_check import Checked, SequenceFinding, check_sequence
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.store.place import Location
from slamsim.dataset.store.table import Row
from slamsim.guard.errors import NotFound
from slamsim.guard.sums import SUMS

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
