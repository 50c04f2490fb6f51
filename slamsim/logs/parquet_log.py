"""A recording as a folder of Parquet tables, written while it is being made.

``scans.parquet``, ``imu.parquet``, ``encoders.parquet``, ``joints.parquet``, ``odometry.parquet``
and ``transforms.parquet`` hold what the messages of a rosbag2 recording hold, column by column: no
truth. A stream that is never recorded has no file. Rows are in the order of arrival.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.logs.parquet_file import Cells, Column, ParquetFile
from slamsim.logs.written import Written
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    Recording,
    TransformEdge,
)
from slamsim.types import FloatArray, IntArray

SCANS_PER_GROUP = 512
_STAMPS = (
    Column("stamp_ns", "int64", "as in the message, on the sensor's clock"),
    Column("received_ns", "int64", "when whoever recorded it received it"),
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


class ParquetLog(Written):
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
    found = []
    kinds: list[tuple[str, Sequence[Any], Callable[[str, Any], _Rows]]] = [
        ("scans", recording.scans, _scans),
        ("imu", recording.imus, _imu),
        ("encoders", recording.ticks, _ticks),
        ("joints", recording.joints, _joints),
        ("odometry", recording.odometries, _odometry),
    ]
    for name, streams, rows_of in kinds:
        for number, stream in enumerate(streams):
            found.append(rows_of(name if number == 0 else f"{name}_{number}", stream))
    found.append(_transforms(recording, with_fixed=first))
    return found


def _stream_facts(stream: RawStream) -> dict[str, object]:
    return {"topic": stream.topic, "frame_ids": list(stream.frame_ids)}


def _received(stamps_ns: IntArray, received_ns: IntArray | None) -> IntArray:
    return stamps_ns if received_ns is None else received_ns


def _stamps(stream: RawStream) -> dict[str, Cells]:
    stamps_ns, samples = stream.stamps_ns, stream.samples
    known: dict[str, Cells] = {} if samples is None else {"sample": samples}
    return {"stamp_ns": stamps_ns, "received_ns": _received(stamps_ns, stream.received_ns), **known}


def _scans(table: str, scans: RawScans) -> _Rows:
    ranges_m = np.asarray(scans.ranges_m, dtype=np.float32)
    beams = int(ranges_m.shape[1])
    columns = [
        *_STAMPS,
        _SAMPLE,
        Column("layout", "uint8", "which of the declared layouts of the beams"),
        Column("ranges_m", "float32", "inf: no return, nan: invalid", width=beams, repeats=True),
    ]
    cells = {
        **_stamps(scans),
        "layout": scans.layout_of.astype(np.uint8),
        "ranges_m": ranges_m,
    }
    if scans.intensities is not None:
        columns.append(Column("intensities", "float32", "0 without a return", width=beams))
        cells["intensities"] = np.asarray(scans.intensities, dtype=np.float32)
    facts = {
        **_stream_facts(scans),
        "layouts": [asdict(layout) for layout in scans.layouts],
        "beams": "beam i fires i * beam_dt_s after the stamp at angle_min_rad + i * angle_step_rad",
    }
    return _Rows(table, tuple(columns), facts, cells, SCANS_PER_GROUP)


def _imu(table: str, imu: RawImu) -> _Rows:
    vectors = {
        "angular_velocity_{}_rad_s": imu.angular_velocity_rad_s,
        "linear_acceleration_{}_m_s2": imu.linear_acceleration_m_s2,
    }
    return _numbers(table, imu, vectors, {"acceleration": "specific force: +9.8 on z at rest"})


def _odometry(table: str, odometry: RawOdometry) -> _Rows:
    vectors = {
        "position_{}_m": odometry.positions_m,
        "quat_{}": odometry.quats_xyzw,
        "linear_velocity_{}_m_s": odometry.linear_m_s,
        "angular_velocity_{}_rad_s": odometry.angular_rad_s,
    }
    facts = {
        "child_frame_ids": list(odometry.child_frame_ids),
        "pose": "of the child in the frame; velocities in the child",
    }
    return _numbers(table, odometry, vectors, facts)


def _joints(table: str, joints: RawJoints) -> _Rows:
    cells: dict[str, Cells] = {}
    for index, name in enumerate(joints.names):
        cells[f"{name}_position_rad"] = joints.positions_rad[:, index]
        cells[f"{name}_velocity_rad_s"] = joints.velocities_rad_s[:, index]
    columns = (*_STAMPS, _SAMPLE, *(Column(name, "float64") for name in cells))
    facts = {**_stream_facts(joints), "joints": list(joints.names)}
    return _Rows(table, columns, facts, {**_stamps(joints), **cells})


def _ticks(table: str, ticks: RawTicks) -> _Rows:
    columns = (
        *_STAMPS,
        _SAMPLE,
        Column("ticks_left", "int64", "since the start"),
        Column("ticks_right", "int64", "since the start"),
    )
    cells: dict[str, Cells] = {
        **_stamps(ticks),
        "ticks_left": ticks.ticks[:, 0],
        "ticks_right": ticks.ticks[:, 1],
    }
    facts = {
        **_stream_facts(ticks),
        "ticks_per_revolution": ticks.ticks_per_revolution,
        "wheel_radius_m": ticks.wheel_radius_m,
        "track_m": ticks.track_m,
    }
    return _Rows(table, columns, facts, cells)


def _numbers(
    table: str, stream: RawStream, vectors: Mapping[str, FloatArray], facts: Mapping[str, object]
) -> _Rows:
    """A table of vectors; ``{}`` in a name stands for the axis."""
    cells = split_axes(vectors)
    columns = (*_STAMPS, _SAMPLE, *(Column(name, "float64") for name in cells))
    return _Rows(table, columns, {**_stream_facts(stream), **facts}, {**_stamps(stream), **cells})


def split_axes(vectors: Mapping[str, FloatArray]) -> dict[str, Cells]:
    """One column for each axis of (n, 3) or (n, 4) vectors; ``{}`` in a name becomes x, y, z, w."""
    return {
        name.format(axis): vector[:, index]
        for name, vector in vectors.items()
        for index, axis in enumerate("xyzw"[: vector.shape[1]])
    }


def joined_axes(cells: Mapping[str, Any], name: str, axes: str = "xyz") -> FloatArray:
    """The (n, 3) or (n, 4) vectors that ``split_axes`` made columns of."""
    return np.column_stack([cells[name.format(axis)] for axis in axes])


def _transforms(recording: Recording, *, with_fixed: bool) -> _Rows:
    edges = [edge for edge in recording.transforms if with_fixed or not edge.is_static]
    counts = [edge.stamps_ns.size for edge in edges]
    texts = {
        name: [text for edge, n in zip(edges, counts, strict=True) for text in [value(edge)] * n]
        for name, value in _EDGE_TEXTS.items()
    }
    vectors = {
        "position_{}_m": _stacked([edge.positions_m for edge in edges], 3),
        "quat_{}": _stacked([edge.quats_xyzw for edge in edges], 4),
    }
    none = np.zeros(0, dtype=np.int64)
    cells: dict[str, Cells] = {
        "stamp_ns": np.concatenate([none, *(edge.stamps_ns for edge in edges)]),
        "received_ns": np.concatenate(
            [none, *(_received(edge.stamps_ns, edge.received_ns) for edge in edges)]
        ),
        **texts,
        "is_static": np.repeat(np.array([e.is_static for e in edges], dtype=np.bool_), counts),
        **split_axes(vectors),
    }
    columns = (
        *_STAMPS,
        *(Column(name, "string") for name in _EDGE_TEXTS),
        Column("is_static", "bool", "it came on a latched topic"),
        *(Column(name, "float64") for name in split_axes(vectors)),
    )
    facts = {"robot_description": recording.robot_description}
    return _Rows("transforms", columns, facts, cells)


_EDGE_TEXTS: dict[str, Callable[[TransformEdge], str]] = {
    "topic": lambda edge: edge.topic,
    "parent": lambda edge: edge.parent,
    "child": lambda edge: edge.child,
}


def _stacked(parts: list[FloatArray], width: int) -> FloatArray:
    return np.concatenate([np.zeros((0, width)), *parts])
