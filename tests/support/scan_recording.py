"""Recordings in memory with exact truth, for the tests of the checker's laser part."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from simulated import drive, labyrinth, noisy_gyro, noisy_wheels, sense_scans

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry
from slamsim.recording import RawImu, RawOdometry, RawScans, Recording, ScanLayout
from slamsim.slam.laser.scan_motion import ScanMotions, window_motions
from slamsim.slam.laser.scan_windows import choose_windows

LIDAR = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.75), 361, 208_333, 0.1, 30.0)
"""A slow Hokuyo with every third beam: 75 ms from the first to the last."""

DRIVE_S = 20.0
NOISE_M = 0.005


@cache
def world() -> tuple[FloatArray, FloatArray]:
    return labyrinth(3)


@cache
def truth() -> PlanarTrajectory:
    return drive(world()[1], max_s=DRIVE_S)


@cache
def healthy(seed: int = 0, geometry: ScanGeometry = LIDAR) -> Recording:
    """Scans from the base itself, a gyroscope and odometry."""
    scans = sense_scans(world()[0], truth(), geometry, NOISE_M, seed)
    return recording(raw_scans(scans), seed)


@cache
def world_fixed() -> Recording:
    """The same drive, the rays keeping their directions in the world."""
    path = truth()
    still = PlanarTrajectory(path.stamps_ns, path.poses * np.array([1.0, 1.0, 0.0]))
    return recording(raw_scans(sense_scans(world()[0], still, LIDAR, NOISE_M, 0)), 0)


def scan_motions(scans: RawScans) -> ScanMotions:
    """By windows all over the recording."""
    return window_motions(scans, choose_windows(scans.stamps_ns, None))


def raw_scans(scans: list[Scan]) -> RawScans:
    geometry = scans[0].geometry
    span = geometry.angle_step_rad * (geometry.beam_count - 1)
    layout = ScanLayout(
        angle_min_rad=geometry.angle_min_rad,
        angle_max_rad=geometry.angle_min_rad + span,
        angle_step_rad=geometry.angle_step_rad,
        beam_dt_s=geometry.beam_dt_ns * 1e-9,
        scan_time_s=0.1,
        range_min_m=geometry.range_min_m,
        range_max_m=geometry.range_max_m,
    )
    return RawScans(
        topic="/scan",
        frame_ids=("laser",),
        stamps_ns=np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
        received_ns=None,
        layouts=(layout,),
        layout_of=np.zeros(len(scans), dtype=np.int32),
        ranges_m=np.stack([scan.ranges_m for scan in scans]),
    )


def recording(scans: RawScans, seed: int) -> Recording:
    """With a gyroscope and odometry on the drive of ``truth``."""
    path = truth()
    gyro, wheels = noisy_gyro(path, seed), noisy_wheels(path, seed, 1.002, 1.004)
    imu = RawImu(
        *("/imu", ("imu",), gyro.stamps_ns, None),
        *(gyro.angular_velocity_rad_s, gyro.linear_acceleration_m_s2),
    )
    unknown = np.full((len(wheels), 3), np.nan)
    odometry = RawOdometry(
        *("/odom", ("odom",), wheels.stamps_ns, None, ("base_footprint",)),
        np.column_stack([wheels.poses[:, :2], np.zeros(len(wheels))]),
        xyzw_from_yaw(wheels.poses[:, 2]),
        *(unknown, unknown),
    )
    return Recording("simulated", "memory", (scans, imu, odometry))


def with_layout(of: Recording, **changes: float) -> Recording:
    """Another declaration of the same beams."""
    scans = of.scans[0]
    return with_scans(of, replace(scans, layouts=(replace(scans.layouts[0], **changes),)))


def with_ranges(of: Recording, ranges_m: FloatArray) -> Recording:
    return with_scans(of, replace(of.scans[0], ranges_m=ranges_m.astype(np.float32)))


def with_scans(of: Recording, scans: RawScans) -> Recording:
    return of.with_streams(RawScans, (scans,))
