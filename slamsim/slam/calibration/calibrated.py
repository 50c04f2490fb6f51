"""The calibration in the units of a robot: radii and track, or scales of a given odometry."""

from __future__ import annotations

import numpy as np

from slamsim.core.result import Calibrated
from slamsim.core.types import FloatArray
from slamsim.models.differential_drive import Reading
from slamsim.models.wheel_gyro import CURVATURE, GYRO_BIAS, GYRO_SCALE, PATH_SCALE, TURN_SCALE
from slamsim.slam.calibration.online import PRIOR_SIGMAS
from slamsim.slam.calibration.solve import Solved

OBSERVED_SHARE = 0.3
"""A number counts as observed if the drive left less than this of what was uncertain before."""

STEP = 1e-6
"""Of numerical derivatives: numbers about 1 in double precision have their least error there."""


def calibrated(solved: Solved, reading: Reading, gyro: bool) -> dict[str, Calibrated]:
    """Every number under its name with its unit; ``gyro_bias_rad_s`` is the mean over the drive."""
    values, covariance = solved.mean()
    prior = np.diag(np.square(PRIOR_SIGMAS))
    told = {}
    for name, value, slope in _numbers(values, reading, gyro):
        sigma, before = (float(np.sqrt(slope @ m @ slope)) for m in (covariance, prior))
        told[name] = Calibrated(value, sigma, sigma < OBSERVED_SHARE * before)
    return told


def _numbers(
    values: FloatArray, reading: Reading, gyro: bool
) -> list[tuple[str, float, FloatArray]]:
    """Name, value and derivative (5,) by the parameters."""
    units = np.eye(len(values))
    if reading.wheel_radius_m > 0.0:
        names = ("wheel_radius_left_m", "wheel_radius_right_m", "track_m")
        at = _wheels(values, reading)
        slopes = np.array([(_wheels(values + STEP * unit, reading) - at) / STEP for unit in units])
        numbers = [(name, float(at[n]), slopes[:, n]) for n, name in enumerate(names)]
    else:
        numbers = [
            ("path_scale", 1.0 + float(values[PATH_SCALE]), units[PATH_SCALE]),
            ("turn_scale", 1.0 + float(values[TURN_SCALE]), units[TURN_SCALE]),
            ("curvature_rad_per_m", float(values[CURVATURE]), units[CURVATURE]),
        ]
    if gyro:
        numbers.append(("gyro_bias_rad_s", float(values[GYRO_BIAS]), units[GYRO_BIAS]))
        numbers.append(("gyro_scale", 1.0 + float(values[GYRO_SCALE]), units[GYRO_SCALE]))
    return numbers


def _wheels(values: FloatArray, reading: Reading) -> FloatArray:
    """(3,) radii, left and right, and track."""
    path = 1.0 + values[PATH_SCALE]
    track_m = reading.track_m * path / (1.0 + values[TURN_SCALE])
    apart = 0.5 * values[CURVATURE] * track_m
    radii_m = reading.wheel_radius_m * np.array([path - apart, path + apart])
    return np.append(radii_m, track_m)
