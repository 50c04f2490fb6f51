"""A robot with a lidar in front and one at the rear, on the drive of ``scan_recording``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scan_recording import LIDAR, NOISE_M, raw_scans, recording, truth, world
from simulated import sense_scans

from slamsim.core.geometry import compose, xyzw_from_yaw
from slamsim.core.types import FloatArray, PlanarTrajectory, ScanGeometry
from slamsim.recording import RawScans, Recording, TransformEdge

FRONT, REAR = np.array([0.15, 0.05, 0.1]), np.array([-0.25, -0.1, np.pi - 0.05])
"""(3,) T_base_laser of each."""

HALF_VIEW = replace(LIDAR, angle_min_rad=np.deg2rad(-90.0), beam_count=241)


def scans_of(
    T_base_laser: FloatArray, name: str, geometry: ScanGeometry = LIDAR, seed: int = 0
) -> RawScans:
    path = truth()
    seen = PlanarTrajectory(path.stamps_ns, compose(path.poses, T_base_laser))
    scans = raw_scans(sense_scans(world()[0], seen, geometry, NOISE_M, seed))
    return replace(scans, topic=f"/{name}/scan", frame_ids=(f"{name}_laser",))


def mounted(T_base_sensor: FloatArray, frame: str) -> TransformEdge:
    stamps_ns, (x, y, yaw) = np.zeros(1, dtype=np.int64), T_base_sensor
    return TransformEdge(
        *("/tf_static", "base_footprint", frame, True, stamps_ns, stamps_ns),
        np.array([[x, y, 0.2]]),
        xyzw_from_yaw(np.array([yaw])),
    )


def front_and_rear(geometry: ScanGeometry = LIDAR, rear: FloatArray = REAR) -> Recording:
    """rear: (3,) T_base_laser as it is declared; it sits at ``REAR``."""
    scans = scans_of(FRONT, "front", geometry), scans_of(REAR, "rear", geometry, seed=1)
    whole = recording(scans[0], 0).with_streams(RawScans, scans)
    (odometry,) = whole.odometries
    moving = TransformEdge(
        *("/tf", "odom", "base_footprint", False, odometry.stamps_ns, odometry.stamps_ns),
        *(odometry.positions_m, odometry.quats_xyzw),
    )
    sensors = (FRONT, "front_laser"), (rear, "rear_laser"), (np.zeros(3), "imu")
    return replace(whole, transforms=(moving, *(mounted(*sensor) for sensor in sensors)))
