"""Faults of scans that are no size of a mount: orientation, times of beams, readings, layout."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from independent.fault import Fault, Made, all_round, fault, rolling
from independent.rays import cast
from independent.recorded import Scans
from independent.robots import Robot
from independent.sensors import Scanner, fixed_edge


def _scans(made: Made) -> Scans:
    return made.bag.scans[0]


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


def _times_ranges(made: Made, factor: float, limits: float) -> None:
    """In another unit; the declared limits perhaps too."""
    scans = _scans(made)
    scans.ranges_m = (scans.ranges_m * factor).astype(np.float32)
    scans.range_min *= limits
    scans.range_max *= limits


def _no_return_as(made: Made, zero: bool) -> None:
    scans = _scans(made)
    value = 0.0 if zero else scans.range_max - 0.01
    seen = np.isfinite(scans.ranges_m)
    lost = made.rng.random(scans.ranges_m.shape) < 0.04
    scans.ranges_m = np.where(seen & ~lost, scans.ranges_m, np.float32(value))


def _rounded(made: Made, quantum_m: float) -> None:
    scans = _scans(made)
    scans.ranges_m = (np.round(scans.ranges_m / quantum_m) * quantum_m).astype(np.float32)


def _noisy(made: Made, sigma_m: float) -> None:
    scans = _scans(made)
    noise = made.rng.normal(0.0, sigma_m, scans.ranges_m.shape)
    scans.ranges_m = np.maximum(scans.ranges_m + noise, 0.06).astype(np.float32)


def _lost_beams(made: Made, share: float) -> None:
    scans = _scans(made)
    lost = made.rng.random(scans.ranges_m.shape) < share
    scans.ranges_m = np.where(lost, np.float32(np.inf), scans.ranges_m)


def _sector(made: Made, share: float, reading_m: float) -> None:
    """Some neighbouring beams always read the same."""
    scans = _scans(made)
    beams = scans.ranges_m.shape[1]
    begin = int(made.rng.integers(0, int(beams * (1.0 - share))))
    scans.ranges_m = scans.ranges_m.copy()
    body = reading_m * (1.0 + 0.2 * np.sin(np.arange(int(beams * share))))
    scans.ranges_m[:, begin : begin + len(body)] = np.round(body, 3)


def _frozen(made: Made, begin: float, end: float) -> None:
    """One scan again and again, from one share of the drive to another."""
    scans = _scans(made)
    first, last = (int(share * len(scans.stamps_ns)) for share in (begin, end))
    scans.ranges_m = scans.ranges_m.copy()
    scans.ranges_m[first:last] = scans.ranges_m[first]


def _each_twice(made: Made) -> None:
    scans = _scans(made)
    scans.ranges_m = scans.ranges_m[np.arange(len(scans.ranges_m)) // 2 * 2]


def _stray(made: Made, share: float) -> None:
    """Beams of another lidar: single readings that are too short."""
    scans = _scans(made)
    hit = (made.rng.random(scans.ranges_m.shape) < share) & np.isfinite(scans.ranges_m)
    shorter = scans.ranges_m * made.rng.uniform(0.2, 0.8, scans.ranges_m.shape)
    scans.ranges_m = np.where(hit, np.maximum(shorter, 0.1), scans.ranges_m).astype(np.float32)


def _limits(made: Made, name: str, share: float) -> None:
    """A declared limit in the midst of the readings."""
    scans = _scans(made)
    seen = scans.ranges_m[np.isfinite(scans.ranges_m)]
    setattr(scans, name, float(np.quantile(seen, share)))


def _intensities(made: Made, share: float) -> None:
    """For this share of the beams an intensity, or for more than there are."""
    scans = _scans(made)
    beams = int(share * scans.ranges_m.shape[1])
    shape = (len(scans.stamps_ns), beams)
    scans.intensities = made.rng.uniform(50.0, 200.0, shape).astype(np.float32)


def _more_beams(made: Made, beams: int) -> None:
    """Readings for more or fewer beams than are declared."""
    scans = _scans(made)
    index = np.arange(scans.ranges_m.shape[1] + beams) % scans.ranges_m.shape[1]
    scans.ranges_m = scans.ranges_m[:, index]


def _wide_angle_max(made: Made) -> None:
    _scans(made).angle_max += 10.0 * _scans(made).angle_increment


def _second_lidar(made: Made, topic: str, frame: str, declared: bool) -> None:
    """Another lidar looks backward, from elsewhere."""
    lidar = replace(made.robot.lidar, beams=181, fov_deg=180.0, from_zero=False, rate_hz=10.0)
    robot = replace(made.robot, lidar=lidar, laser=(-0.2, 0.05, np.pi))
    scans, _ = Scanner(robot, made.conditions).scans()
    scans.topic, scans.frame = topic, frame
    scans.stamps_ns = scans.stamps_ns + 31_000_000
    scans.received_ns = scans.received_ns + 31_000_000
    made.bag.scans.append(scans)
    if declared:
        made.bag.edges.append(fixed_edge("base_link", frame, (-0.2, 0.05, 0.2), (0.0, 0.0, np.pi)))


def _is_all_at_once(robot: Robot) -> bool:
    return robot.lidar.at_once


def _has_scan_of_tenth(robot: Robot) -> bool:
    """Long enough a sweep to be told from jitter."""
    return robot.lidar.beam_s * robot.lidar.beams > 0.03


ORIENTATION = [
    fault("mirrored", "turned", "laser_mirrored laser_upside_down", change=_mirrored),
    fault("quarter_turn", "turned", "laser_yaw", change=_turned_by_quarter, fits=all_round),
    fault("halves_swapped", "turned", "laser_yaw", change=_halves_swapped, fits=all_round),
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
    fault("rays_turned_twice", "turned", None, change=partial(_turning_rays, turns=2.0)),
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

READINGS = [
    fault(
        "ranges_mm",
        "unit",
        "range_unit",
        "range_limits",
        change=partial(_times_ranges, factor=1e3, limits=1.0),
    ),
    fault(
        "ranges_mm_all", "unit", "range_unit", change=partial(_times_ranges, factor=1e3, limits=1e3)
    ),
    fault(
        "ranges_cm",
        "unit",
        "range_unit",
        "range_limits",
        change=partial(_times_ranges, factor=1e2, limits=1.0),
    ),
    fault(
        "ranges_feet",
        "unit",
        "range_unit range_scale",
        "range_limits",
        change=partial(_times_ranges, factor=1 / 0.3048, limits=1.0),
    ),
    fault(
        "no_return_as_max",
        "no_return",
        "range_max_no_return",
        change=partial(_no_return_as, zero=False),
    ),
    fault(
        "no_return_as_0",
        "no_return",
        "range_zero_no_return",
        "range_limits",
        change=partial(_no_return_as, zero=True),
    ),
    fault("ranges_10cm_steps", "rounded", None, change=partial(_rounded, quantum_m=0.1)),
    fault("ranges_25cm_steps", "rounded", None, change=partial(_rounded, quantum_m=0.25)),
    fault("noise_15cm", "noise", None, change=partial(_noisy, sigma_m=0.15)),
    fault("half_of_beams_lost", "lost", None, change=partial(_lost_beams, share=0.5)),
    fault(
        "dead_sector",
        "sector",
        "beams_dead",
        change=partial(_sector, share=0.08, reading_m=np.inf),
        pairs=True,
    ),
    fault(
        "own_body",
        "sector",
        "beams_constant",
        change=partial(_sector, share=0.06, reading_m=0.15),
        pairs=True,
    ),
    fault("frozen_10s", "stuck", "scan_stuck", change=partial(_frozen, begin=0.4, end=0.57)),
    fault("frozen_3s", "stuck", "scan_stuck", change=partial(_frozen, begin=0.5, end=0.55)),
    fault("frozen_to_end", "stuck", "scan_stuck", change=partial(_frozen, begin=0.6, end=1.0)),
    fault("each_scan_twice", "stuck", "scan_stuck", change=_each_twice),
    fault("stray_3%", "stray", "scan_interference", change=partial(_stray, share=0.03), pairs=True),
    fault("stray_8%", "stray", "scan_interference", change=partial(_stray, share=0.08)),
    fault(
        "range_max_short",
        "limits",
        "range_limits",
        change=partial(_limits, name="range_max", share=0.7),
        pairs=True,
    ),
    fault(
        "range_min_long",
        "limits",
        "range_limits",
        change=partial(_limits, name="range_min", share=0.2),
        pairs=True,
    ),
]

LAYOUT = [
    fault("intensities_half", "layout", "scan_layout", change=partial(_intensities, share=0.5)),
    fault("intensities_more", "layout", "scan_layout", change=partial(_intensities, share=1.2)),
    fault("beams_more", "layout", "scan_layout", change=partial(_more_beams, beams=7)),
    fault("beams_fewer", "layout", "scan_layout", change=partial(_more_beams, beams=-20)),
    fault("angle_max_wide", "layout", "scan_layout", change=_wide_angle_max, pairs=True),
    fault(
        "two_lidars_one_frame",
        "second",
        "frame_on_two_topics",
        change=partial(_second_lidar, topic="/scan_rear", frame="laser", declared=False),
    ),
    fault(
        "two_lidars_one_topic",
        "second",
        "topic_shared",
        change=partial(_second_lidar, topic="/scan", frame="laser_rear", declared=True),
    ),
    fault(
        "second_lidar_no_tf",
        "second",
        "tf_missing_link tf_unknown_frame",
        change=partial(_second_lidar, topic="/scan_rear", frame="laser_rear", declared=False),
    ),
]

LASER_FAULTS: list[Fault] = [*ORIENTATION, *TIMES, *READINGS, *LAYOUT]
