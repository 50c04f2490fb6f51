"""Reads the folder of Parquet tables that ``ParquetLog`` writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Epoch
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import own_file
from slamsim.guard.numbers import MOST_NS
from slamsim.guard.seal import require_complete
from slamsim.io.input_errors import as_input_errors
from slamsim.io.parquet.file import read_table, table_facts
from slamsim.recording import (
    KINDS,
    RawScans,
    RawStream,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.schemas import IMU, ODOMETRY, SCANS, TICKS, TRANSFORM, Field

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
        if not facts:
            reason = "its schema does not say what the table is, as after pandas or polars: take "
            raise InputRefused(path, reason + "the table as slamsim wrote it, or as pyarrow does")
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


_TYPES: dict[str, str] = {
    **dict.fromkeys(("stamp_ns", "received_ns", "sample", "sequence"), "int64"),
    **dict.fromkeys(("topic", "parent", "child"), "object"),
    "layout": "uint8",
    "is_static": "bool",
    **{
        field.column.format(part): field.dtype
        for schema in (SCANS, IMU, ODOMETRY, TICKS, TRANSFORM)
        for field in schema.fields
        if field.column
        for part in field.parts or ("",)
    },
}
_LISTS = tuple(field.column for field in SCANS.fields if field.is_list)
_NUMBER = "float64"
"""Of all other columns, whose names depend on those of joints."""


def require_sound(facts: Mapping[str, Any], cells: Mapping[str, NDArray[Any]]) -> None:
    """Raises ValueError saying what is wrong, KeyError for a fact that is missing.

    cells: of each column (n,) or (n, k).
    """
    for name, column in cells.items():
        dtype = _TYPES.get(name, _NUMBER)
        if column.dtype != dtype or column.ndim != 1 + (name in _LISTS):
            raise ValueError(f"the column {name!r} holds {column.dtype}, not {dtype}")
        if dtype == "object" and not all(_is_name(text) for text in column):
            raise ValueError(f"the column {name!r} holds an invalid name")
    for name in ("stamp_ns", "received_ns"):
        if (np.abs(cells[name]) > MOST_NS).any() or (cells[name] == np.iinfo("i8").min).any():
            raise ValueError(f"the column {name!r} holds an invalid time")
    if not _is_name(facts["recording"]) or facts["epoch"] not in get_args(Epoch):
        raise ValueError("its name or its epoch is none")
    if "topic" in facts:
        _require_stream(facts, cells)
    elif not isinstance(facts["robot_description"], str | None):
        raise ValueError("its robot description is not text")


def _require_stream(facts: Mapping[str, Any], cells: Mapping[str, NDArray[Any]]) -> None:
    for names in ([facts["topic"]], facts["frame_ids"], facts.get("child_frame_ids", ["base"])):
        if not names or not all(map(_is_name, names)):
            raise ValueError("its topic or frame name is invalid")
    if not facts["topic"].strip():
        raise ValueError("its topic has no name")
    if not len(cells["stamp_ns"]):
        raise ValueError("there is no row in it")
    if "layouts" in facts:
        _require_layouts(facts["layouts"], cells["layout"])
    for name in ("ticks_per_revolution", "wheel_radius_m", "track_m"):
        if not isinstance(facts.get(name, 1), int | float):
            raise ValueError(f"{name!r} is no number")


def _require_layouts(layouts: Any, used: NDArray[Any]) -> None:
    expected = {field.name for field in fields(ScanLayout)}
    for layout in layouts:
        if layout.keys() != expected or not all(type(v) is float for v in layout.values()):
            raise ValueError("a layout of the beams is not one of numbers")
    if used.max() >= len(layouts):
        raise ValueError(f"a scan is of layout {used.max()}, there are {len(layouts)}")


def _is_name(text: object) -> bool:
    return isinstance(text, str) and text.isprintable()
