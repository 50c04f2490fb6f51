"""Checks that one sequence is complete and unchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.parquet as pq

from slamsim.dataset.recipe.sequence import FileFact
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import SlamsimError
from slamsim.guard.sums import SEQUENCE, SumsDamaged, read_sequence, sha256_of

EXTRA = "no part of the data set"
"""The reason of a finding whose file was never written by us."""


@dataclass(frozen=True, slots=True)
class SequenceFinding:
    """What is not as it should be. path: relative to the data set. index: of the sequence."""

    path: str
    reason: str
    index: int | None = None


@dataclass(frozen=True, slots=True)
class Checked:
    """What was looked at, and what was found."""

    files: int
    size_bytes: int
    findings: tuple[SequenceFinding, ...]


def check_sequence(place: Location, index: int, name: str, sha256: str) -> Checked:
    """sha256: of its ``sequence.json``, as the manifest has it."""
    path = f"{name}/{SEQUENCE}"
    try:
        mark = place.read(path)
    except SlamsimError as error:
        return Checked(0, 0, (SequenceFinding(path, str(error), index),))
    if mark is None:
        return Checked(0, 0, (SequenceFinding(path, "missing", index),))
    if sha256_of(mark) != sha256:
        reason = "not as the manifest has it, so that its other files cannot be judged"
        return Checked(1, len(mark), (SequenceFinding(path, reason, index),))
    try:
        facts = tuple(FileFact(**file) for file in read_sequence(mark)["files"])
    except (SumsDamaged, TypeError) as error:
        return Checked(1, len(mark), (SequenceFinding(path, str(error), index),))
    findings = [
        SequenceFinding(f"{name}/{fact.path}", reason, index)
        for fact in facts
        for reason in file_faults(place, f"{name}/{fact.path}", fact.sha256, fact.size_bytes)
    ]
    told = {SEQUENCE, *(fact.path for fact in facts)}
    extra = [path for path in place.files(name) if path not in told and not is_hidden(path)]
    findings += [SequenceFinding(f"{name}/{path}", EXTRA, index) for path in extra]
    size_bytes = len(mark) + sum(fact.size_bytes for fact in facts)
    return Checked(1 + len(facts), size_bytes, tuple(findings))


def file_faults(
    place: Location, path: str, sha256: str, size_bytes: int | None = None
) -> Iterator[str]:
    """What is wrong with one file, in words; nothing where all is well."""
    try:
        found = place.digest(path)
        if found is None:
            yield "missing"
        elif size_bytes is not None and found[0] != size_bytes:
            yield f"{found[0]:,} bytes long instead of {size_bytes:,}"
        elif found[1] != sha256:
            yield "its bytes are not those that were written"
        elif path.endswith(".parquet"):
            yield from _page_faults(place, path)
    except SlamsimError as error:
        yield str(error)


def is_hidden(path: str) -> bool:
    """Whether any part of a path begins with a dot: such files are never part of the data."""
    return any(part.startswith(".") for part in path.split("/"))


def _page_faults(place: Location, path: str) -> Iterator[str]:
    """Whether the checksums of all pages hold."""
    with place.open(path) as file:
        try:
            table = pq.ParquetFile(file, page_checksum_verification=True)
            for group in range(table.num_row_groups):
                table.read_row_group(group)
        except (pa.ArrowException, OSError) as error:
            yield f"its pages do not agree with their checksums: {error}"
