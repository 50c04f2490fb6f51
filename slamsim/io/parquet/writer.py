"""Writes a recording as a folder of Parquet tables during the simulation.

``scans.parquet``, ``imu.parquet``, ``encoders.parquet``, ``joints.parquet``, ``odometry.parquet``
and ``transforms.parquet`` hold what the messages of a rosbag2 recording hold, column by column: no
truth. A stream that is never recorded has no file. Rows are in the order of arrival.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.core.types import IntArray
from slamsim.io.parquet.file import Cells, Column, ParquetFile
from slamsim.io.staged_writer import StagedWriter
from slamsim.recording import RawScans, RawStream, Recording, TransformEdge
from slamsim.recording.schemas import TRANSFORM, Field

SCANS_PER_GROUP = 512
_STAMPS = (
    Column("stamp_ns", "int64", "as in the message, on the sensor's clock"),
    Column("received_ns", "int64", "when the recorder received it"),
)
_SAMPLE = Column("sample", "int64", "number among all that were sensed, with those a fault lost")


@dataclass(frozen=True, slots=True)
class _Rows:
    """The rows of one table, and what they need of the file if they are its first."""

    table: str
    columns: tuple[Column, ...]
    facts: Mapping[str, object]
    cells: Mapping[str, Cells]
    rows_per_group: int = 1 << 16


class ParquetLog(StagedWriter):
    """A recording being written into a new folder; a context manager.

    sequence: its number, if it is one of a data set.
    """

    def __init__(self, folder: Path, sequence: int | None = None) -> None:
        super().__init__()
        folder.mkdir(parents=True)
        self._folder, self._sequence = folder, sequence
        self._files = dict[str, ParquetFile]()
        self._rows = Counter[str]()

    def write(self, part: Recording) -> None:
        """The next part of the recording: the same streams as before, later messages.

        What does not move (fixed transforms, robot description) is taken from the first part.
        """
        shared = _shared_facts(part)
        for rows in _tables(part, first=not self._files):
            file = self._files.get(rows.table)
            if file is None:
                path = self._folder / f"{rows.table}.parquet"
                about = {"table": rows.table, **shared, **rows.facts}
                opened = ParquetFile(
                    path, rows.columns, about, rows.rows_per_group, sequence=self._sequence
                )
                file = self._files[rows.table] = self._open.enter_context(opened)
            count = len(rows.cells["stamp_ns"])
            numbers = np.arange(self._rows[rows.table], self._rows[rows.table] + count)
            file.append({"sample": numbers, **rows.cells})
            self._rows[rows.table] += count


def _shared_facts(recording: Recording) -> dict[str, object]:
    fixed = [edge for edge in recording.transforms if edge.is_static and len(edge.stamps_ns)]
    return {
        "recording": recording.name,
        "epoch": recording.epoch,
        "conventions": "SI units; frames right-handed, x forward, z up; T_parent_child",
        "static_transforms": [
            {
                "parent": edge.parent,
                "child": edge.child,
                "position_m": edge.positions_m[0].tolist(),
                "quat_xyzw": edge.quats_xyzw[0].tolist(),
            }
            for edge in fixed
        ],
    }


def _tables(recording: Recording, *, first: bool) -> list[_Rows]:
    numbers = Counter[str]()
    found = []
    for stream in recording.streams:
        table = stream.schema.table
        found.append(_rows(f"{table}_{numbers[table]}" if numbers[table] else table, stream))
        numbers[table] += 1
    found.append(_transforms(recording, with_fixed=first))
    return found


def _rows(table: str, stream: RawStream) -> _Rows:
    schema = stream.schema
    found = [*_layout(stream), *_fields(stream)]
    facts = {
        "topic": stream.topic,
        **{name: list(getattr(stream, name)) for name, _ in schema.frames},
        **{field.name: getattr(stream, field.name) for field in schema.fields if field.is_constant},
        **dict(schema.about),
    }
    if isinstance(stream, RawScans):
        facts["layouts"] = [asdict(layout) for layout in stream.layouts]
    if schema.parts:
        facts[schema.table] = list(getattr(stream, schema.parts))
    cells = {**_stamps(stream), **{column.name: values for column, values in found}}
    columns = (*_STAMPS, _SAMPLE, *(column for column, _ in found))
    per_group = SCANS_PER_GROUP if isinstance(stream, RawScans) else 1 << 16
    return _Rows(table, columns, facts, cells, per_group)


def _fields(stream: RawStream) -> Iterator[tuple[Column, Cells]]:
    """What the schema says of its columns, and the values in them."""
    schema = stream.schema
    kept = [f for f in schema.fields if f.column and getattr(stream, f.name) is not None]
    if not schema.parts:
        for field in kept:
            yield from _columns(field, getattr(stream, field.name))
        return
    for number, part in enumerate(getattr(stream, schema.parts)):
        for field in kept:
            yield _column(field, part), getattr(stream, field.name)[:, number]


def _columns(field: Field, values: Any) -> Iterator[tuple[Column, Cells]]:
    if field.parts:
        for number, part in enumerate(field.parts):
            yield _column(field, part), values[:, number]
    else:
        values = np.asarray(values, dtype=field.dtype)
        yield _column(field, width=values.shape[1]), values


def _column(field: Field, part: str = "", width: int = 0) -> Column:
    return Column(field.column.format(part), field.dtype, field.about, width, field.repeats)


def _layout(stream: RawStream) -> Iterator[tuple[Column, Cells]]:
    if isinstance(stream, RawScans):
        about = "which of the declared layouts of the beams"
        yield Column("layout", "uint8", about), stream.layout_of.astype(np.uint8)


def _received(stamps_ns: IntArray, received_ns: IntArray | None) -> IntArray:
    return stamps_ns if received_ns is None else received_ns


def _stamps(stream: RawStream) -> dict[str, Cells]:
    stamps_ns, samples = stream.stamps_ns, stream.samples
    known: dict[str, Cells] = {} if samples is None else {"sample": samples}
    return {"stamp_ns": stamps_ns, "received_ns": _received(stamps_ns, stream.received_ns), **known}


def _transforms(recording: Recording, *, with_fixed: bool) -> _Rows:
    edges = recording.transforms if with_fixed else recording.moving
    counts = [edge.stamps_ns.size for edge in edges]
    none = np.zeros(0, dtype=np.int64)
    received = (_received(edge.stamps_ns, edge.received_ns) for edge in edges)
    texts = {
        name: [text for edge, n in zip(edges, counts, strict=True) for text in [value(edge)] * n]
        for name, value in _EDGE_TEXTS.items()
    }
    numbers = list[tuple[Column, Cells]]()
    for field in TRANSFORM.fields:
        parts = (getattr(edge, field.name) for edge in edges)
        numbers += _columns(field, np.concatenate([np.zeros((0, len(field.parts))), *parts]))
    cells: dict[str, Cells] = {
        "stamp_ns": np.concatenate([none, *(edge.stamps_ns for edge in edges)]),
        "received_ns": np.concatenate([none, *received]),
        **texts,
        "is_static": np.repeat(np.array([e.is_static for e in edges], dtype=np.bool_), counts),
        **{column.name: values for column, values in numbers},
    }
    columns = (
        *_STAMPS,
        *(Column(name, "string") for name in _EDGE_TEXTS),
        Column("is_static", "bool", "it came on a latched topic"),
        *(column for column, _ in numbers),
    )
    facts = {"robot_description": recording.robot_description}
    return _Rows(TRANSFORM.table, columns, facts, cells)


_EDGE_TEXTS: dict[str, Callable[[TransformEdge], str]] = {
    "topic": lambda edge: edge.topic,
    "parent": lambda edge: edge.parent,
    "child": lambda edge: edge.child,
}
