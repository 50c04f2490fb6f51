"""Worlds, drives and a robot made by formula, for the tests of the sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.config.lidar import DropoutConfig, LidarConfig, MixedReturnsConfig, RangeNoiseConfig
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import Drive, Float32Array, FloatArray, TriangleMesh
from slamsim.sensors.base import Site
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import joined

SECOND = 1_000_000_000
PERFECT_LIDAR = LidarConfig(
    resolution_m=0.0,
    max_incidence_deg=90.0,
    noise=RangeNoiseConfig(constant_m=0.0, proportional=0.0, spot_mrad=0.0),
    dropout=DropoutConfig(probability=0.0, at_max_range=0.0, at_grazing=0.0),
    mixed=MixedReturnsConfig(divergence_mrad=0.0),
)


@dataclass(frozen=True)
class Robot:
    """Laser ahead of and above the wheel axle, inertial unit off the middle."""

    T_base_laser: FloatArray = field(
        default_factory=lambda: se3_from_parts(np.eye(3), np.array([0.1, 0.0, 0.3]))
    )
    T_base_imu: FloatArray = field(
        default_factory=lambda: se3_from_parts(
            matrix_from_rpy(0.1, -0.2, 0.7), np.array([0.05, -0.08, 0.2])
        )
    )
    wheel_radius_m: float = 0.0352
    track_m: float = 0.230


def prism(corners_m: FloatArray, height_m: float = 1.0) -> TriangleMesh:
    """Upright walls over a closed outline (n, 2), without lids."""
    count = len(corners_m)
    low = np.column_stack([corners_m, np.zeros(count)])
    high = np.column_stack([corners_m, np.full(count, height_m)])
    here, after = np.arange(count), (np.arange(count) + 1) % count
    first = np.column_stack([here, after, after + count])
    second = np.column_stack([here, after + count, here + count])
    return TriangleMesh(np.vstack([low, high]), np.vstack([first, second]).astype(np.int32))


def joined_meshes(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    starts = np.cumsum([0] + [len(mesh.vertices_m) for mesh in meshes[:-1]])
    triangles = [
        mesh.triangles + np.int32(start) for mesh, start in zip(meshes, starts, strict=True)
    ]
    return TriangleMesh(np.vstack([mesh.vertices_m for mesh in meshes]), np.vstack(triangles))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def room(half_x_m: float = 4.0, half_y_m: float = 3.0) -> TriangleMesh:
    return prism(rectangle(-half_x_m, -half_y_m, half_x_m, half_y_m))


def drive_along(
    seconds: float,
    rate_hz: float,
    yaw_rad: FloatArray | float = 0.0,
    yaw_rate_rad_s: float = 0.0,
    speed_m_s: float = 0.0,
    start_m: tuple[float, float] = (0.0, 0.0),
    wobble_rad: float = 0.0,
) -> Drive:
    """Constant speed and turning rate, exactly; wobble adds roll and pitch oscillations."""
    stamps_ns = np.rint(np.arange(int(seconds * rate_hz) + 1) * (SECOND / rate_hz)).astype(np.int64)
    t = stamps_ns * 1e-9
    turned = yaw_rate_rad_s * t
    yaw = yaw_rad + turned
    middle = yaw_rad + 0.5 * turned
    chord = speed_m_s * t * np.sinc(turned / (2 * np.pi))
    zero = np.zeros_like(t)
    positions = np.column_stack(
        [start_m[0] + chord * np.cos(middle), start_m[1] + chord * np.sin(middle), zero]
    )
    pitch, roll = wobble_rad * np.sin(9.0 * t), wobble_rad * np.sin(7.0 * t + 1.0)
    rotation = Rotation.from_euler("ZYX", np.column_stack([yaw + zero, pitch, roll]))
    velocity = speed_m_s * np.column_stack([np.cos(yaw + zero), np.sin(yaw + zero), zero])
    wheel = np.array([speed_m_s - 0.115 * yaw_rate_rad_s, speed_m_s + 0.115 * yaw_rate_rad_s])
    speeds = np.tile(wheel / 0.0352, (t.size, 1))
    return Drive(
        stamps_ns=stamps_ns,
        positions_m=positions,
        quats_xyzw=rotation.as_quat(),
        linear_velocity_m_s=velocity,
        angular_velocity_rad_s=np.column_stack([zero, zero, zero + yaw_rate_rad_s]),
        wheel_angles_rad=speeds * t[:, None],
        wheel_speeds_rad_s=speeds,
        commands=np.tile([speed_m_s, yaw_rate_rad_s], (t.size, 1)),
        wall_contact=np.zeros(t.size, dtype=np.bool_),
    )


def figure_eight(seconds: float = 4.0, rate_hz: float = 240.0) -> Drive:
    """A lying eight with changing speed and turning rate, and some roll and pitch."""
    stamps_ns = np.rint(np.arange(int(seconds * rate_hz) + 1) * (SECOND / rate_hz)).astype(np.int64)
    t = stamps_ns * 1e-9
    zero, w = np.zeros_like(t), 1.3
    velocity = np.column_stack([1.5 * w * np.cos(w * t), 1.5 * w * np.cos(2 * w * t), zero])
    bent = np.column_stack([-1.5 * w * w * np.sin(w * t), -3 * w * w * np.sin(2 * w * t), zero])
    turning = (velocity[:, 0] * bent[:, 1] - velocity[:, 1] * bent[:, 0]) / np.sum(
        velocity[:, :2] ** 2, axis=1
    )
    yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
    rotation = Rotation.from_euler(
        "ZYX", np.column_stack([yaw, 0.02 * np.sin(11 * t), 0.03 * np.sin(8 * t)])
    )
    return Drive(
        stamps_ns=stamps_ns,
        positions_m=np.column_stack([1.5 * np.sin(w * t), 0.75 * np.sin(2 * w * t), zero]),
        quats_xyzw=rotation.as_quat(),
        linear_velocity_m_s=velocity,
        angular_velocity_rad_s=np.column_stack([zero, zero, turning]),
        wheel_angles_rad=np.column_stack([5 * t - np.sin(3 * t), 5 * t + np.sin(3 * t)]),
        wheel_speeds_rad_s=np.zeros((t.size, 2)),
        commands=np.zeros((t.size, 2)),
        wall_contact=np.zeros(t.size, dtype=np.bool_),
    )


def windows(drive: Drive, cuts: Sequence[int]) -> Iterator[Drive]:
    """The drive in consecutive pieces, cut before the given steps; empty pieces left out."""
    edges = [0, *sorted(cuts), len(drive)]
    for first, last in pairwise(edges):
        if last > first:
            parts = {f.name: getattr(drive, f.name)[first:last] for f in fields(Drive)}
            yield replace(drive, **parts)


def scan(
    config: LidarConfig,
    mesh: TriangleMesh,
    drive: Drive,
    T_base_laser: FloatArray | None = None,
    scans: int = 1,
    seed: int = 0,
) -> Float32Array:
    """(scans, beams) ranges, one scan after the other from the start of the drive."""
    mount = (
        se3_from_parts(np.eye(3), np.array([0, 0, 0.3])) if T_base_laser is None else T_base_laser
    )
    lidar = Lidar(config, mount, Site(mesh, seed, start_ns=0))
    stamps = np.arange(scans) * round(SECOND / config.rate_hz)
    return lidar.scan_batch(joined(None, drive), stamps)[0]


def standing(seconds: float, x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> Drive:
    return drive_along(seconds, 240.0, yaw_rad=yaw_rad, start_m=(x_m, y_m))
