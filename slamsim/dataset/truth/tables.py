"""The truth of a sequence as Parquet tables, written while the robot drives.

``trajectory.parquet``: the whole motion at the physics rate, from which any instant follows exactly
as the simulator had it (``read_drive``). ``scans.parquet``: of each beam its true range, incidence
and the surface that it met. ``imu.parquet``, ``encoders.parquet``: true stamps, values without
error, biases. The rows of the sensors stand in the order in which they were sensed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.core.types import Drive, FloatArray
from slamsim.dataset.truth.surfaces import NO_SURFACE, TrueSurfaces, rounded, write_surfaces
from slamsim.io.parquet.file import (
    Cells,
    Column,
    ParquetFile,
    joined_axes,
    read_table,
    split_axes,
)
from slamsim.io.parquet.writer import SCANS_PER_GROUP
from slamsim.io.staged_writer import StagedWriter
from slamsim.models.differential_drive import left_and_right
from slamsim.sensors.readings import EncoderBatch, ImuBatch, Readings, ScanBatch
from slamsim.simulation.tails import TruthTail

RANGE_BITS, INCIDENCE_BITS = 13, 10
"""Of truth kept for each beam: multiples of 0.12 mm and of 0.06 degrees."""

_STAMPS = (
    Column("stamp_ns", "int64", "on the sensor's clock, before any fault"),
    Column("true_stamp_ns", "int64", "the same instant in true time"),
)
_MOTION = {
    "positions_m": "position_{}_m",
    "quats_xyzw": "quat_{}",
    "linear_velocity_m_s": "linear_velocity_{}_m_s",
    "angular_velocity_rad_s": "angular_velocity_{}_rad_s",
}
_PAIRS = {
    "wheel_angles_rad": ("wheel_left_rad", "wheel_right_rad"),
    "wheel_speeds_rad_s": ("wheel_left_rad_s", "wheel_right_rad_s"),
    "commands": ("command_forward_m_s", "command_yaw_rate_rad_s"),
}
_SLIPS = ("slip_left_m_s", "slip_right_m_s", "slip_sideways_m_s")


class TruthTables(StagedWriter):
    """The tables of one sequence in a new folder; a context manager.

    wheels_m: true radius and track of the robot. sequence: its number in the data set. A sensor
    without a single sample has no table.
    """

    def __init__(
        self, folder: Path, surfaces: TrueSurfaces, wheels_m: tuple[float, float], sequence: int
    ) -> None:
        super().__init__()
        folder.mkdir(parents=True)
        write_surfaces(folder / "surfaces.parquet", surfaces, sequence)
        self._folder, self._surfaces, self._sequence = folder, surfaces, sequence
        self._wheels = wheels_m
        self._files = dict[str, ParquetFile]()

    def write(self, readings: Readings, window: Drive) -> None:
        """The next window of the drive, and what was sensed during it."""
        self._append_motion(window)
        if len(readings.scans):
            self._append_scans(readings.scans)
        if len(readings.imu):
            self._append_imu(readings.imu)
        if len(readings.encoders):
            self._append_encoders(readings.encoders)

    def _append_motion(self, window: Drive) -> None:
        cells: dict[str, Cells] = {
            "stamp_ns": window.stamps_ns,
            **split_axes({name: getattr(window, field) for field, name in _MOTION.items()}),
        }
        for field, names in _PAIRS.items():
            cells |= dict(zip(names, getattr(window, field).T, strict=True))
        columns = [
            Column("stamp_ns", "int64", "true time"),
            *(Column(name, "float64") for name in cells if name != "stamp_ns"),
            Column("wall_contact", "bool", "the robot touched a wall"),
            *(Column(name, "float32", "of the contact point over the floor") for name in _SLIPS),
        ]
        slips = dict(zip(_SLIPS, slip_m_s(window, *self._wheels).T, strict=True))
        facts = {"frame": "map", "child": "base_footprint", "velocities": "in map axes"}
        cells = {**cells, "wall_contact": window.wall_contact, **slips}
        self._append("trajectory", columns, cells, facts)

    def _append_scans(self, scans: ScanBatch) -> None:
        truth, beams = scans.truth, scans.geometry.beam_count
        if truth is None:
            raise ValueError("the scans were sensed without their truth")
        columns = [
            *_STAMPS,
            Column("true_ranges_m", "float32", "of the beam's middle; inf: nothing", width=beams),
            Column("incidence_rad", "float32", "0 head-on, pi/2 grazing or nothing", width=beams),
            Column("surfaces", "uint16", f"row of surfaces; {NO_SURFACE}: nothing", width=beams),
        ]
        incidence_rad = np.arccos(np.minimum(truth.cos_incidence, np.float32(1.0)))
        cells: dict[str, Cells] = {
            "stamp_ns": scans.stamps_ns,
            "true_stamp_ns": scans.true_stamps_ns,
            "true_ranges_m": rounded(truth.ranges_m, RANGE_BITS),
            "incidence_rad": rounded(incidence_rad, INCIDENCE_BITS),
            "surfaces": self._surfaces.met(truth.triangles),
        }
        facts = {"rounding_m": 0.5**RANGE_BITS, "rounding_rad": 0.5**INCIDENCE_BITS}
        self._append("scans", columns, cells, facts, SCANS_PER_GROUP)

    def _append_imu(self, imu: ImuBatch) -> None:
        truth = imu.truth
        if truth is None:
            raise ValueError("the inertial unit was sensed without its truth")
        values = split_axes(
            {
                "angular_velocity_{}_rad_s": truth.angular_velocity_rad_s,
                "linear_acceleration_{}_m_s2": truth.linear_acceleration_m_s2,
                "gyro_bias_{}_rad_s": truth.gyro_bias_rad_s,
                "accelerometer_bias_{}_m_s2": truth.accelerometer_bias_m_s2,
            }
        )
        columns = [*_STAMPS, *(Column(name, "float32") for name in values)]
        stamps = {"stamp_ns": imu.stream.stamps_ns, "true_stamp_ns": imu.true_stamps_ns}
        self._append("imu", columns, {**stamps, **values}, {"values": "without any error"})

    def _append_encoders(self, encoders: EncoderBatch) -> None:
        if encoders.true_angles_rad is None:
            raise ValueError("the encoders were sensed without their truth")
        left, right = encoders.true_angles_rad.T
        columns = [*_STAMPS, *(Column(name, "float64") for name in _PAIRS["wheel_angles_rad"])]
        cells: dict[str, Cells] = {
            "stamp_ns": encoders.stream.stamps_ns,
            "true_stamp_ns": encoders.true_stamps_ns,
            "wheel_left_rad": left,
            "wheel_right_rad": right,
        }
        facts = {"wheel_radius_m": self._wheels[0], "track_m": self._wheels[1]}
        self._append("encoders", columns, cells, facts)

    def _append(
        self,
        table: str,
        columns: Sequence[Column],
        cells: Mapping[str, Cells],
        facts: Mapping[str, object],
        rows_per_group: int = 1 << 16,
    ) -> None:
        file = self._files.get(table)
        if file is None:
            path = self._folder / f"{table}.parquet"
            about = {"table": table, **facts}
            opened = ParquetFile(path, columns, about, rows_per_group, sequence=self._sequence)
            file = self._files[table] = self._open.enter_context(opened)
        file.append(cells)


def slip_m_s(drive: Drive, wheel_radius_m: float, track_m: float) -> FloatArray:
    """(n, 3) speed of the wheels' surface over the floor, left and right, forward; and sideways.

    A wheel that rolls has 0; one that spins has its rim's speed less that of the robot above it.
    """
    linear, angular = TruthTail.twist_in_base(drive)
    rims = drive.wheel_speeds_rad_s * wheel_radius_m
    left, right = left_and_right(linear[:, 0], angular[:, 2], track_m)
    return np.column_stack([rims[:, 0] - left, rims[:, 1] - right, linear[:, 1]])


def read_drive(path: Path) -> Drive:
    """The drive that a ``trajectory.parquet`` holds, bit by bit.

    ``slamsim.sensors.motion.Motion(drive)`` tells pose, velocities and wheel angles at any instant
    as every sensor had them; ``drive.trajectory()`` gives poses.
    """
    return drive_of(read_table(path))


def drive_of(cells: Mapping[str, Any]) -> Drive:
    """Columns of the table, or some rows of them, as a drive."""
    pairs = {
        field: np.column_stack([cells[name] for name in names]) for field, names in _PAIRS.items()
    }
    return Drive(
        stamps_ns=cells["stamp_ns"],
        positions_m=joined_axes(cells, _MOTION["positions_m"]),
        quats_xyzw=joined_axes(cells, _MOTION["quats_xyzw"], "xyzw"),
        linear_velocity_m_s=joined_axes(cells, _MOTION["linear_velocity_m_s"]),
        angular_velocity_rad_s=joined_axes(cells, _MOTION["angular_velocity_rad_s"]),
        wheel_angles_rad=pairs["wheel_angles_rad"],
        wheel_speeds_rad_s=pairs["wheel_speeds_rad_s"],
        commands=pairs["commands"],
        wall_contact=cells["wall_contact"],
    )
