"""Reads the folder of Parquet tables that ``ParquetLog`` writes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from slamsim.guard.files import own_file
from slamsim.guard.seal import require_complete
from slamsim.io.input_errors import as_input_errors
from slamsim.io.parquet.file import read_table, table_facts
from slamsim.io.parquet.validation import require_sound
from slamsim.recording import (
    KINDS,
    RawScans,
    RawStream,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.schemas import TRANSFORM, Field

Table = dict[str, Any]
_Raw = TypeVar("_Raw", bound=RawStream)
_Made = TypeVar("_Made")


def read_parquet(folder: Path) -> Recording:
    """What the tables say, nothing changed.

    Raises InputRefused for a file that cannot be read, DataDamaged for one that is not as it was
    written, or is missing.
    """
    require_complete(folder)
    facts, transforms = _made(
        folder, "transforms", lambda facts, cells: (facts, _transforms(cells))
    )
    return Recording(
        name=str(facts.get("recording", folder.name)),
        format="parquet",
        streams=tuple(stream for kind in KINDS for stream in _streams(folder, kind)),
        transforms=transforms,
        robot_description=facts["robot_description"],
        epoch=facts["epoch"],
    )


def _streams(folder: Path, kind: type[_Raw]) -> tuple[_Raw, ...]:
    """All of one kind: ``odometry``, ``odometry_1`` and so on, as many as there are."""
    table = kind.schema.table
    names = (table if number == 0 else f"{table}_{number}" for number in count())
    there = takewhile(lambda name: (folder / f"{name}.parquet").is_file(), names)
    return tuple(_made(folder, name, partial(stream_of, kind)) for name in there)


def _made(folder: Path, table: str, made: Callable[[Table, Table], _Made]) -> _Made:
    path = own_file(folder, f"{table}.parquet")
    with as_input_errors(path, "its columns"):
        facts, cells = table_facts(path), read_table(path)
        require_sound(facts, cells)
        return made(facts, cells)


def stream_of(kind: type[_Raw], facts: Table, cells: Table) -> _Raw:
    """Of what a table says of itself, and its columns or some rows of them."""
    schema = kind.schema
    read: dict[str, Any] = {name: tuple(facts[name]) for name, _ in schema.frames}
    if kind is RawScans:
        read["layouts"] = tuple(ScanLayout(**layout) for layout in facts["layouts"])
        read["layout_of"] = cells["layout"].astype(np.int32)
    if schema.parts:
        read[schema.parts] = tuple(facts[schema.table])
    for field in schema.fields:
        if field.is_constant:
            read[field.name] = facts[field.name]
        elif field.column:
            read[field.name] = _values(field, cells, read.get(schema.parts, field.parts))
    return kind(
        topic=facts["topic"],
        stamps_ns=cells["stamp_ns"],
        received_ns=cells["received_ns"],
        samples=cells["sample"],
        **read,
    )


def _values(field: Field, cells: Table, parts: tuple[str, ...]) -> Any:
    """(n, parts) of a field, or what its one column holds."""
    if "{}" in field.column:
        return np.column_stack([cells[field.column.format(part)] for part in parts])
    return cells.get(field.column) if field.is_optional else cells[field.column]


def _transforms(cells: Table) -> tuple[TransformEdge, ...]:
    """One edge for each topic and pair of frames, in the order of their first messages."""
    keys = list(zip(cells["topic"], cells["parent"], cells["child"], strict=True))
    rows: dict[tuple[str, str, str], list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    values = {field.name: _values(field, cells, field.parts) for field in TRANSFORM.fields}
    return tuple(
        TransformEdge(
            *key,
            bool(cells["is_static"][mine[0]]),
            cells["stamp_ns"][mine],
            cells["received_ns"][mine],
            **{name: value[mine] for name, value in values.items()},
        )
        for key, mine in rows.items()
    )
