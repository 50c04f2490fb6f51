"""Reads the folder of Parquet tables that ``ParquetLog`` writes: as a recording, or as a log."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from slamsim.core.types import (
    BoolArray,
    EncoderStream,
    ImuStream,
    IntArray,
    Log,
    PlanarTrajectory,
    Trajectory,
)
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import own_file
from slamsim.guard.numbers import is_sound
from slamsim.guard.seal import require_complete
from slamsim.io.input_errors import refusing
from slamsim.io.parquet.file import read_table, table_facts
from slamsim.io.parquet.validation import require_sound
from slamsim.io.ros.bag_log import imu_mounting_of, laser_mounting_of
from slamsim.io.ros.bag_scans import Survey, scan_from_message
from slamsim.io.ros.bag_streams import are_wheels, in_order, lengths
from slamsim.recording import (
    KINDS,
    RawScans,
    RawStream,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.cleaning.scans import StoredScans
from slamsim.recording.mountings import BASE_FRAME, tree_of
from slamsim.recording.schemas import TRANSFORM, Field

SCANS_NAME = "scans.parquet"

Table = dict[str, Any]
_Raw = TypeVar("_Raw", bound=RawStream)
_Made = TypeVar("_Made")


def read_parquet_recording(folder: Path) -> Recording:
    """What the tables say, nothing mended.

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


def read_parquet(folder: Path) -> Log:
    """The log in the tables, put in order as that of a bag is; its scans are in memory."""
    recording = read_parquet_recording(folder)
    if not recording.scans:
        raise InputRefused(folder / SCANS_NAME, "there is no scan in it")
    raw, survey = recording.scans[0], Survey()
    received_ns = raw.stamps_ns if raw.received_ns is None else raw.received_ns
    for number in range(len(raw)):
        survey.add(_message(raw, number), int(received_ns[number]))
    try:
        times = survey.times()
    except ValueError as error:
        raise InputRefused(folder / SCANS_NAME, str(error)) from None
    moved: list[str] = []
    odometry, base = _path(recording, moved)
    limit, told = survey.limit(times, odometry)
    found = (scan_from_message(_message(raw, number), limit) for number in range(len(raw)))
    scans = times.applied(scan for scan in found if scan is not None)
    warnings = [f"{raw.topic}: {words}" for words in (*survey.warnings(times), *told)] + moved
    tree, laser = tree_of(recording.transforms), survey.frame_id
    imu = _imu_stream(recording, warnings)
    return Log(
        name=recording.name,
        epoch=recording.epoch,
        scans=StoredScans(list(scans)),
        odometry=odometry,
        imu=imu,
        encoders=_encoders(recording, warnings),
        T_base_laser=laser_mounting_of(tree, base, laser, warnings),
        T_base_imu=None if imu is None else imu_mounting_of(tree, base, imu, warnings),
        warnings=tuple(warnings),
        recorded_scans=survey.recorded,
    )


def _streams(folder: Path, kind: type[_Raw]) -> tuple[_Raw, ...]:
    """All of one kind: ``odometry``, ``odometry_1`` and so on, as many as there are."""
    table = kind.schema.table
    names = (table if number == 0 else f"{table}_{number}" for number in count())
    there = takewhile(lambda name: (folder / f"{name}.parquet").is_file(), names)
    return tuple(_made(folder, name, partial(stream_of, kind)) for name in there)


def _made(folder: Path, table: str, made: Callable[[Table, Table], _Made]) -> _Made:
    path = own_file(folder, f"{table}.parquet")
    with refusing(path, "its columns"):
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


def _message(raw: RawScans, number: int) -> SimpleNamespace:
    layout = raw.layout(number)
    sec, nanosec = divmod(int(raw.stamps_ns[number]), 1_000_000_000)
    return SimpleNamespace(
        header=SimpleNamespace(
            stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=raw.frame_ids[0]
        ),
        angle_min=layout.angle_min_rad,
        angle_max=layout.angle_max_rad,
        angle_increment=layout.angle_step_rad,
        time_increment=layout.beam_dt_s,
        range_min=layout.range_min_m,
        range_max=layout.range_max_m,
        ranges=raw.ranges_m[number],
        intensities=() if raw.intensities is None else raw.intensities[number],
    )


def _all(stamps_ns: IntArray) -> BoolArray:
    return np.ones(stamps_ns.size, dtype=np.bool_)


def _path(recording: Recording, warnings: list[str]) -> tuple[PlanarTrajectory | None, str]:
    """(T_odom_base, the frame that it moves)."""
    for moved in recording.odometries:
        norms = lengths(moved.quats_xyzw)
        sound = is_sound(moved.positions_m) & (np.abs(norms - 1.0) < 0.1)
        stamps_ns, rows, odd = in_order(
            moved.stamps_ns, np.asarray(sound), moved.topic, moved.received_ns
        )
        warnings += odd
        quats_xyzw = moved.quats_xyzw[rows] / norms[rows, None]
        path = Trajectory(stamps_ns, moved.positions_m[rows], quats_xyzw)
        return path.planar(), moved.child_frame_ids[0]
    warnings.append("a log without odometry")
    return None, BASE_FRAME


def _imu_stream(recording: Recording, warnings: list[str]) -> ImuStream | None:
    for imu in recording.imus:
        rates, forces = imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2
        sound = is_sound(np.hstack([rates, forces]))
        stamps_ns, rows, odd = in_order(
            imu.stamps_ns, np.asarray(sound), imu.topic, imu.received_ns
        )
        warnings += odd
        return ImuStream(stamps_ns, rates[rows], forces[rows], imu.frame_ids[0])
    return None


def _encoders(recording: Recording, warnings: list[str]) -> EncoderStream | None:
    for wheels in recording.ticks:
        stamps_ns, rows, odd = in_order(
            wheels.stamps_ns, _all(wheels.stamps_ns), wheels.topic, wheels.received_ns
        )
        warnings += odd
        constants = (wheels.ticks_per_revolution, wheels.wheel_radius_m, wheels.track_m)
        if are_wheels(*constants):
            return EncoderStream(stamps_ns, wheels.ticks[rows], *constants)
        warnings.append(f"{wheels.topic}: ticks a turn, radius and track make no wheels: left out")
    return None
