"""Calibrated numbers of a robot in the units that a person thinks in."""

from __future__ import annotations

import math

from slamsim.guard.quantities import as_interval

_SHOWN = {
    "wheel_radius_left_m": ("radius of the left wheel", "radius left", "mm", 1e3, 0.0),
    "wheel_radius_right_m": ("radius of the right wheel", "right", "mm", 1e3, 0.0),
    "track_m": ("distance between the wheels", "track", "mm", 1e3, 0.0),
    "path_scale": ("scale of the path by odometry, off by", "path", "%", 1e2, 1.0),
    "turn_scale": ("scale of turns by odometry, off by", "turn", "%", 1e2, 1.0),
    "curvature_rad_per_m": (
        *("curvature of a straight drive", "curvature", "°/m"),
        *(math.degrees(1.0), 0.0),
    ),
    "gyro_bias_rad_s": ("bias of the gyroscope", "gyro bias", "mrad/s", 1e3, 0.0),
    "gyro_scale": ("scale of the gyroscope, off by", "gyro scale", "%", 1e2, 1.0),
    "laser_angle_scale": ("scale of the angle between beams, off by", "angle step", "%", 1e2, 1.0),
    "laser_range_offset_m": ("offset of ranges", "ranges", "mm", 1e3, 0.0),
    "laser_sweep_s": ("time of a sweep", "sweep", "ms", 1e3, 0.0),
    "laser_x_m": ("laser, forward of the base", "laser x", "mm", 1e3, 0.0),
    "laser_y_m": ("laser, left of the base", "y", "mm", 1e3, 0.0),
    "laser_yaw_rad": ("laser, turned to the left", "yaw", "°", math.degrees(1.0), 0.0),
    "laser_delay_s": ("scans, taken after their stamps", "scans late", "ms", 1e3, 0.0),
}
"""Of each number: its name, the short one, the unit, its factor and what is taken off before."""


def calibrated_name(name: str) -> str:
    """What a calibrated number is, for a table."""
    return _SHOWN[name][0]


def calibrated_short(name: str, value: float, sigma: float) -> str:
    """``track 230 ± 0.07 mm``."""
    return f"{_SHOWN[name][1]} {calibrated_interval(name, value, sigma)}"


def calibrated_interval(name: str, value: float, sigma: float) -> str:
    """``230 ± 0.07 mm``. value, sigma: as the name says."""
    _, _, unit, factor, offset = _SHOWN[name]
    return f"{as_interval(factor * (value - offset), factor * sigma)} {unit}"
