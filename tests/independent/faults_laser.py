"""Faults of where the beams of a scan go, and when."""

from __future__ import annotations

from functools import partial

import numpy as np

from independent.fault import Fault, Made, all_round, fault, rolling
from independent.rays import cast
from independent.recorded import Scans
from independent.robots import Robot
from independent.sensors import Scanner


def _scans(made: Made) -> Scans:
    return made.bag.scans[0]


ROLLED = "flash_scan_timed beam_time_scale time_offset_lidar scan_stamp_middle rolling_scan_untimed"
"""Readings that are moved within a scan have the times of other readings too."""


def _mirrored(made: Made) -> None:
    """Readings in the opposite order of what is declared."""
    _scans(made).ranges_m = _scans(made).ranges_m[:, ::-1].copy()


def _turned_by_quarter(made: Made) -> None:
    scans = _scans(made)
    scans.ranges_m = np.roll(scans.ranges_m, scans.ranges_m.shape[1] // 4, axis=1)


def _halves_swapped(made: Made) -> None:
    scans = _scans(made)
    scans.ranges_m = np.roll(scans.ranges_m, scans.ranges_m.shape[1] // 2, axis=1)


def _first_angle(made: Made, both: bool) -> None:
    """Begins at least half a degree from where it is declared to begin, by whole beams."""
    scans = _scans(made)
    beams = max(1.0, np.ceil(np.deg2rad(0.5) / abs(scans.angle_increment) - 1e-6))
    scans.angle_min += beams * scans.angle_increment
    scans.angle_max += beams * scans.angle_increment * both


def _degrees(made: Made) -> None:
    scans = _scans(made)
    for name in ("angle_min", "angle_max", "angle_increment"):
        setattr(scans, name, float(np.rad2deg(getattr(scans, name))))


def _turning_rays(made: Made, turns: float) -> None:
    """As seen by rays that turn so many times as far as the robot: 0 for a gimbal, or a simulator
    that forgot the heading, 2 where the heading is added twice."""
    scanner, drive = Scanner(made.robot, made.conditions), made.conditions.drive
    lidar, (x, y, yaw) = made.robot.lidar, made.robot.laser
    number = np.arange(lidar.beams)
    times = (scanner.begins_s[:, None] + lidar.beam_s * number).ravel()
    poses = drive.at(times)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    origins = poses[:, :2] + np.column_stack([cos * x - sin * y, sin * x + cos * y])
    beams = np.tile(lidar.first_rad + lidar.step_rad * number, len(scanner.begins_s))
    angles = drive.poses[0, 2] + turns * (poses[:, 2] - drive.poses[0, 2]) + yaw + beams
    found = cast(made.conditions.scene, origins, angles).reshape(-1, lidar.beams)
    _scans(made).ranges_m = scanner.measured(found).astype(np.float32)


def _times(made: Made, increment: float, scan_time: float) -> None:
    """Declared times, as shares of the true ones."""
    _scans(made).time_increment *= increment
    _scans(made).scan_time *= scan_time


def _timed_flash(made: Made) -> None:
    scans = _scans(made)
    scans.time_increment = scans.scan_time / scans.ranges_m.shape[1]


def _stamp_at(made: Made, share: float) -> None:
    """The stamp is that of the beam at this share of the sweep."""
    sweep_s = _scans(made).time_increment * (_scans(made).ranges_m.shape[1] - 1)
    _scans(made).stamps_ns = _scans(made).stamps_ns + round(1e9 * share * sweep_s)


def _is_all_at_once(robot: Robot) -> bool:
    return robot.lidar.at_once


def _has_scan_of_tenth(robot: Robot) -> bool:
    """Long enough a sweep to be told from jitter."""
    return robot.lidar.beam_s * robot.lidar.beams > 0.03


ORIENTATION = [
    fault("mirrored", "turned", "laser_mirrored laser_upside_down", change=_mirrored),
    fault("quarter_turn", "turned", "laser_yaw", ROLLED, change=_turned_by_quarter, fits=all_round),
    fault("halves_swapped", "turned", "laser_yaw", ROLLED, change=_halves_swapped, fits=all_round),
    fault(
        "halves_swapped_of_fan",
        "turned",
        None,
        change=_halves_swapped,
        fits=lambda robot: robot.lidar.fov_deg == 270.0,
    ),
    fault("angle_min", "turned", "laser_yaw scan_layout", change=partial(_first_angle, both=False)),
    fault("angle_min_max", "turned", "laser_yaw", change=partial(_first_angle, both=True)),
    fault("angles_in_degrees", "turned", "laser_degrees", "scan_layout", change=_degrees),
    fault("rays_not_turned", "turned", "laser_world_fixed", change=partial(_turning_rays, turns=0)),
    fault(
        "rays_turned_twice",
        "turned",
        "laser_turned_twice",
        change=partial(_turning_rays, turns=2.0),
    ),
]

TIMES = [
    fault(
        "time_increment_0",
        "sweep",
        "rolling_scan_untimed",
        change=partial(_times, increment=0.0, scan_time=1.0),
        fits=rolling,
    ),
    fault(
        "time_increment_negative",
        "sweep",
        "beam_time_reversed",
        change=partial(_times, increment=-1.0, scan_time=1.0),
        fits=rolling,
    ),
    fault(
        "time_increment_ms",
        "sweep",
        "beam_time_scale scans_overlap",
        change=partial(_times, increment=1e3, scan_time=1e3),
        fits=rolling,
    ),
    fault("flash_timed", "sweep", "flash_scan_timed", change=_timed_flash, fits=_is_all_at_once),
    *(
        fault(
            name,
            "scan_time",
            "scan_time scan_layout",
            change=partial(_times, increment=1.0, scan_time=by),
        )
        for name, by in (("scan_time_x2", 2.0), ("scan_time_x0.1", 0.1), ("scan_time_ms", 1e3))
    ),
    fault(
        "stamp_of_last_beam",
        "stamp",
        "scan_stamp_end time_offset_lidar",
        change=partial(_stamp_at, share=1.0),
        fits=_has_scan_of_tenth,
    ),
    fault(
        "stamp_of_middle_beam",
        "stamp",
        "scan_stamp_middle time_offset_lidar",
        change=partial(_stamp_at, share=0.5),
        fits=_has_scan_of_tenth,
    ),
]

LASER_FAULTS: list[Fault] = [*ORIENTATION, *TIMES]
