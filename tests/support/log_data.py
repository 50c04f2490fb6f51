"""A made-up drive and made-up readings, for the tests of logs; nothing is simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.types import (
    Drive,
    EncoderStream,
    Float32Array,
    FloatArray,
    ImuStream,
    IntArray,
    ScanGeometry,
)
from slamsim.sensors.readings import EncoderBatch, ImuBatch, Readings, ScanBatch
from slamsim.simulation.header import LogHeader

PHYSICS_HZ = 240.0
BEAMS = 90


@dataclass(frozen=True)
class Edge:
    parent: str
    child: str
    T_parent_child: FloatArray


def header(**changes: object) -> LogHeader:
    T_base_laser = np.eye(4)
    T_base_laser[:3, 3] = 0.1, -0.02, 0.3
    T_base_imu = np.eye(4)
    T_base_imu[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    edges = (
        Edge("base_footprint", "base_link", np.eye(4)),
        Edge("base_link", "laser", T_base_laser),
        Edge("base_link", "imu_link", T_base_imu),
    )
    fields: dict[str, object] = {
        "robot_description": "<robot name='r'/>",
        "static_transforms": edges,
        "scan_rate_hz": 10.0,
        "imu_gyro_variance": 1e-4,
        "imu_accel_variance": 1e-2,
        "metadata": {"slamsim_version": "test", "gyro_noise_density": "1e-3"},
    }
    return LogHeader(**(fields | changes))  # type: ignore[arg-type]


def _stamps(rate_hz: float, start_s: float, end_s: float) -> IntArray:
    """Multiples of the period in (start, end]; at the very beginning also 0."""
    first, last = int(np.floor(start_s * rate_hz)) + 1, int(np.floor(end_s * rate_hz))
    counts = np.arange(0 if start_s == 0.0 else first, last + 1)
    return np.asarray(np.round(counts * (1e9 / rate_hz)), dtype=np.int64)


def drive(start_s: float, end_s: float) -> Drive:
    stamps_ns = _stamps(PHYSICS_HZ, start_s, end_s)
    t = stamps_ns.astype(np.float64) * 1e-9
    zero = np.zeros_like(t)
    yaw = 0.3 * t
    speed = np.column_stack([0.5 * np.cos(yaw), 0.5 * np.sin(yaw), zero])
    position = np.column_stack([np.sin(yaw), 1.0 - np.cos(yaw), zero]) * (0.5 / 0.3)
    return Drive(
        stamps_ns=stamps_ns,
        positions_m=position,
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_velocity_m_s=speed,
        angular_velocity_rad_s=np.column_stack([zero, zero, zero + 0.3]),
        wheel_angles_rad=np.column_stack([12.0 * t, 14.0 * t]),
        wheel_speeds_rad_s=np.column_stack([zero + 12.0, zero + 14.0]),
        commands=np.column_stack([zero + 0.5, zero + 0.3]),
        wall_contact=np.zeros(t.size, dtype=np.bool_),
    )


def _scans(
    start_s: float, end_s: float, rate_hz: float, beams: int, intensities: bool
) -> ScanBatch:
    geometry = ScanGeometry(-1.5, np.radians(270.0) / beams, beams, 15_000, 0.1, 30.0, "laser")
    lasts_s = geometry.duration_ns * 1e-9
    stamps_ns = _stamps(rate_hz, start_s, end_s)
    margin = _stamps(rate_hz, max(start_s - lasts_s, 0.0), end_s)
    done = (margin + geometry.duration_ns) * 1e-9
    stamps_ns = margin[(done > start_s) & (done <= end_s)]
    count = stamps_ns.size
    phase = stamps_ns[:, None] * 1e-9 + np.arange(beams) * 0.1
    ranges: Float32Array = (5.0 + 3.0 * np.sin(phase)).astype(np.float32)
    ranges[:, 3], ranges[:, 7] = np.inf, np.nan
    return ScanBatch(
        geometry=geometry,
        stamps_ns=stamps_ns,
        true_stamps_ns=stamps_ns,
        arrival_ns=stamps_ns + geometry.duration_ns + 30_000_000,
        ranges_m=ranges.reshape(count, beams),
        intensities=(1.0 / ranges).astype(np.float32) if intensities else None,
    )


def readings(
    start_s: float,
    end_s: float,
    scan_hz: float = 10.0,
    beams: int = BEAMS,
    intensities: bool = False,
) -> Readings:
    imu_ns, wheel_ns = _stamps(200.0, start_s, end_s), _stamps(50.0, start_s, end_s)
    t, w = imu_ns * 1e-9, wheel_ns * 1e-9
    imu = ImuStream(
        imu_ns,
        np.column_stack([0.01 * np.sin(t), 0.02 * np.cos(t), 0.3 + 0.0 * t]),
        np.column_stack([0.1 * np.cos(t), 0.2 * np.sin(t), 9.81 + 0.0 * t]),
        "imu_link",
    )
    ticks = np.floor(np.column_stack([12.0 * w, 14.0 * w]) * (2578 / (2.0 * np.pi)))
    encoders = EncoderStream(wheel_ns, ticks.astype(np.int64), 2578, 0.035, 0.23)
    return Readings(
        _scans(start_s, end_s, scan_hz, beams, intensities),
        ImuBatch(imu, imu_ns, imu_ns + 2_000_000),
        EncoderBatch(encoders, wheel_ns, wheel_ns + 1_000_000),
    )
