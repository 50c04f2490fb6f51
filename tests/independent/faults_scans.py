"""Faults of what scans say: units, no return, stuck and stray readings, layout, second lidars."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from independent.fault import Fault, Made, fault
from independent.recorded import Scans
from independent.sensors import Scanner, fixed_edge


def _scans(made: Made) -> Scans:
    return made.bag.scans[0]


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
    scans = Scanner(robot, made.conditions).scans()
    scans.topic, scans.frame = topic, frame
    made.bag.scans.append(scans)
    if declared:
        made.bag.edges.append(fixed_edge("base_link", frame, (-0.2, 0.05, 0.2), (0.0, 0.0, np.pi)))


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
    fault("ranges_10cm_steps", "rounded", "ranges_coarse", change=partial(_rounded, quantum_m=0.1)),
    fault(
        "ranges_25cm_steps", "rounded", "ranges_coarse", change=partial(_rounded, quantum_m=0.25)
    ),
    fault(
        "noise_15cm",
        "noise",
        "range_noise",
        "range_limits",  # Noise carries readings beyond the longest.
        change=partial(_noisy, sigma_m=0.15),
    ),
    fault("most_beams_lost", "lost", "beams_lost", change=partial(_lost_beams, share=0.7)),
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

SCAN_FAULTS: list[Fault] = [*READINGS, *LAYOUT]
