"""Checks that one sequence is complete and unchanged; makes sequences again and compares the
bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slamsim.dataset.make.identity import difference, read_identity, versions
from slamsim.dataset.make.shard import LIMIT_S
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import FileFact
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import SlamsimError
from slamsim.guard.seal import SEQUENCE, SumsDamaged, read_sequence, sha256_of
from slamsim.process.worker import WorkerDied, Workers, time_limit

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


def require_same_software(place: Location) -> None:
    """Raise SlamsimError where other software would make other bytes."""
    identity = read_identity(place) or {}
    if differs := difference(identity.get("versions", {}), versions()):
        raise SlamsimError(
            f"{place.address} was made with other software, which may make other bytes: "
            f"here is {differs}"
        )


def make_again(
    place: Location, indices: Sequence[int], workers: int | None
) -> Iterator[tuple[SequenceFinding, ...]]:
    """What differs, sequence by sequence. Raises SlamsimError for one that cannot be made again."""
    if not indices:
        return
    identity = read_identity(place)
    assert identity is not None
    with Workers(workers) as makers:
        made = [
            makers.submit(partial(_compared, place, identity, index), LIMIT_S) for index in indices
        ]
        for index, one in zip(indices, made, strict=True):
            try:
                yield one.result()
            except WorkerDied as died:
                raise SlamsimError(
                    f"sequence {index} cannot be made again: {died.reason}"
                ) from None


def _compared(
    place: Location, identity: Mapping[str, Any], index: int
) -> tuple[SequenceFinding, ...]:
    from slamsim.dataset.make.produce import produce
    from slamsim.dataset.make.shard import sequence_mark
    from slamsim.dataset.recipe.draw import sequence_spec

    recipe = Recipe.model_validate(identity["recipe"])
    spec = sequence_spec(recipe, index, identity["sequences"])
    there = place.read(f"{spec.name}/{SEQUENCE}") or b""
    with time_limit(LIMIT_S), tempfile.TemporaryDirectory(prefix="slamsim-again-") as folder:
        try:
            facts = produce(spec, Path(folder))
        except SlamsimError as error:
            return (SequenceFinding(spec.name, f"cannot be made again: {error}", index),)
    if sequence_mark(spec, facts) == there:
        return ()
    old = {file["path"]: file["sha256"] for file in read_sequence(there)["files"]}
    new = {file.path: file.sha256 for file in facts.files}
    reason = "made again, its bytes are others"
    paths = [path for path in {**old, **new} if old.get(path) != new.get(path)] or [SEQUENCE]
    return tuple(SequenceFinding(f"{spec.name}/{path}", reason, index) for path in paths)
