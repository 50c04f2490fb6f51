"""Faults with a size: mounts, wheels, clocks, ranges, the gyroscope."""

from __future__ import annotations

import numpy as np

from independent.fault import Fault, fault, rolling, sizes


def _degrees(*each: float) -> list[tuple[str, float]]:
    return [(f"_{one:g}deg", float(np.deg2rad(one))) for one in each]


def _millimetres(*each: float) -> list[tuple[str, float]]:
    return [(f"_{one:g}mm", 1e-3 * one) for one in each]


def _milliseconds(*each: float) -> list[tuple[str, float]]:
    return [(f"_{one:g}ms", 1e-3 * one) for one in each]


def _per_cent(*each: float) -> list[tuple[str, float]]:
    return [(f"_{one:g}%", 1e-2 * one) for one in each]


def _ppm(*each: float) -> list[tuple[str, float]]:
    return [(f"_{one:g}ppm", 1e-6 * one) for one in each]


LASER = [
    *sizes("laser_yaw", "laser_yaw", "laser_yaw", _degrees(0.5, -0.5, 1, -2, 5, -30), pairs=True),
    *sizes("laser_yaw", "laser_yaw", "laser_yaw", _degrees(90, 180)),
    *sizes("laser_x", "laser_position", "laser_x", _millimetres(10, -10, 20, 50, -200), pairs=True),
    *sizes("laser_y", "laser_position", "laser_y", _millimetres(10, -20, 50), pairs=True),
    *sizes(
        "angle_step", "laser_angle_step", "angle_step", _per_cent(0.2, -0.5, 1, -2, 5), pairs=True
    ),
    *sizes("angle_step", "laser_angle_step", "angle_step", [("_180/179", 1.0 / 179.0)]),
    *sizes(
        "range_scale",
        "range_scale range_unit",
        "range_scale",
        _per_cent(0.5, -0.5, 1, -2, 5),
        sized=False,
    ),
    *sizes("range_offset", "range_offset", "range_offset", _millimetres(40, -50, 100), pairs=True),
    *sizes("sweep", "beam_time_scale", "sweep", _per_cent(10, 30, -30, 100), fits=rolling),
]

KNOCKS = [
    fault(f"knocked_{name}", "knocked", "laser_moved", flaws=flaws)
    for name, flaws in (
        ("1.9deg", {"knock_yaw": np.deg2rad(1.9)}),
        ("-1deg", {"knock_yaw": np.deg2rad(-1.0)}),
        ("5deg_late", {"knock_yaw": np.deg2rad(5.0), "knock_at": 0.25}),
        ("30mm", {"knock_x": 0.03}),
        ("-60mm", {"knock_y": -0.06}),
    )
]

WHEELS = [
    *sizes("radius", "wheel_radius", "radius", _per_cent(0.5, -0.5, 1, -3, 10), pairs=True),
    *sizes("radius", "wheel_radius wheel_unit", "radius", _per_cent(100)),
    *sizes("track", "wheel_track", "track", _per_cent(1, -1, 2, -5, 20), pairs=True),
    *sizes("unequal", "wheel_radius", "unequal", _per_cent(0.5, -1, 3), pairs=True),
]

AHEAD = "stamps_future stamps_late"
"""A clock that runs on leaves the recorder's behind, or falls behind it."""

CLOCKS = [
    *sizes(
        "lidar_late",
        "time_offset_lidar",
        "lidar_late_s",
        _milliseconds(3, -3, -10, -40, 300),
        pairs=True,
    ),
    *sizes("imu_late", "time_offset_imu", "imu_late_s", _milliseconds(3, 10, -20, 150), pairs=True),
    *sizes(
        "wheels_late",
        "time_offset_wheels",
        "wheels_late_s",
        _milliseconds(3, 10, -20, 40, 150),
        pairs=True,
    ),
    *sizes("lidar_drift", "clock_drift", "lidar_drift", _ppm(300, -1000, 3000), also=AHEAD),
    *sizes("imu_drift", "clock_drift", "imu_drift", _ppm(500, -2000), also=AHEAD),
    *sizes("wheels_drift", "clock_drift", "wheels_drift", _ppm(1000, -3000), also=AHEAD),
]

GYRO = [
    *sizes("gyro_scale", "gyro_scale", "gyro_scale", _per_cent(2, -5, 10), pairs=True),
    *sizes("gyro_bias", "gyro_bias", "gyro_bias", [("_0.02", 0.02), ("_-0.1", -0.1)], pairs=True),
]

SIZED: list[Fault] = [*LASER, *KNOCKS, *WHEELS, *CLOCKS, *GYRO]
