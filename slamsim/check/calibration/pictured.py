"""Plots of what the joint calibration says: the slope of one stream's motion against another's,
and how well all fit each other by the size that is asked for."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.model import UNKNOWNS
from slamsim.check.findings import Curve, Plot
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray

_TRIED = 41
_AROUND_SIGMAS = 10.0
_ENOUGH = 8
"""Steps from scan to scan below which no curve says anything."""

_SLOPES = {
    "gyro.scale": ("gyro_gain", "turn rate", "rad/s"),
    "wheels.track": ("turn_gain", "turn rate", "rad/s"),
    "wheels.wiring": ("turn_gain", "turn rate", "rad/s"),
    "wheels.radius": ("path_gain", "speed", "m/s"),
    "ranges.scale": ("path_gain", "speed", "m/s"),
}
_CURVES = {
    "gyro.bias": ("gyro_bias_rad_s", "bias (mrad/s)", 1e3),
    "time.offset.imu": ("gyro_delay_s", "stamps of the inertial unit later by (ms)", 1e3),
    "time.offset.wheels": ("wheel_delay_s", "stamps of the wheels later by (ms)", 1e3),
    "wheels.unequal": ("curvature_rad_m", "curve of a straight drive (deg/m)", 57.29577951),
    "odometry.straight": ("curvature_rad_m", "curve of a straight drive (deg/m)", 57.29577951),
    "laser.x": ("laser_x_m", "laser at x (mm)", 1e3),
    "laser.y": ("laser_y_m", "laser at y (mm)", 1e3),
    "laser.yaw": ("laser_yaw_rad", "yaw of the laser (deg)", 57.29577951),
}
"""Of each question: the unknown, the axis of its plot, and the factor to the axis' unit."""


def plot_of(check: str, calibration: Calibration) -> Plot | None:
    """The evidence of a question that rests on the calibration; None of another, or of too few
    scans."""
    if check in _SLOPES:
        return _slope(calibration, *_SLOPES[check])
    if check == "time.offset.lidar":
        check = "time.offset." + ("imu" if calibration.inputs.gyro else "wheels")
    if check == "time.drift":
        gyro = calibration.inputs.gyro is not None
        return _misfit(calibration, "gyro_drift" if gyro else "wheel_drift", "drift (ppm)", 1e6)
    return _misfit(calibration, *_CURVES[check]) if check in _CURVES else None


def _slope(calibration: Calibration, unknown: str, what: str, unit: str) -> Plot | None:
    """Steps of the scans against those of gyroscope or wheels, each divided by its time."""
    model, values = calibration.model, calibration.fit.values.copy()
    gain = float(values[UNKNOWNS.index(unknown)])
    values[UNKNOWNS.index(unknown)] = 1.0
    if unknown == "gyro_gain":
        values[UNKNOWNS.index("gyro_bias_rad_s")] = 0.0
    by_wheels, by_gyro = model.predicted(values)
    gyro, wheels = model.covered(values)
    matched = model.steps.T_first_second
    if unknown == "gyro_gain":
        used, other, scans = gyro, by_gyro, matched[:, 2]
    elif unknown == "turn_gain":
        used, other, scans = wheels, by_wheels[:, 2], matched[:, 2]
    else:
        used = wheels
        other, scans = (np.hypot(*steps[:, :2].T) for steps in (by_wheels, matched))
    streams = calibration.inputs.gyro if unknown == "gyro_gain" else calibration.inputs.wheels
    if np.count_nonzero(used) < _ENOUGH or streams is None:
        return None
    seconds = (model.second_s - model.first_s)[used]
    x, y = other[used] / seconds, scans[used] / seconds
    ends = np.array([x.min(), x.max()])
    return Plot(
        f"{what.capitalize()} of the scans against {streams.topic}",
        f"{what} by {streams.topic} ({unit})",
        f"{what} by the scans ({unit})",
        (
            Curve("steps from scan to scan", x, y),
            Curve("as declared", ends, ends, "line"),
            Curve(f"found: {gain:.4g} times as much", ends, gain * ends, "line"),
        ),
    )


def _misfit(calibration: Calibration, unknown: str, axis: str, factor: float) -> Plot | None:
    """What is left between the streams by the value of one unknown, the others as found."""
    place = UNKNOWNS.index(unknown)
    found, sigma = float(calibration.fit.values[place]), calibration.sigma(unknown)
    declared = _declared(calibration, unknown)
    coarse_s = _coarse_s(calibration, unknown)
    reach = max(1.5 * abs(found + coarse_s - declared), _AROUND_SIGMAS * sigma)
    best = _left_over(calibration, place, found)
    if best is None or not reach > 0.0:
        return None
    tried = np.linspace(found - reach, found + reach, _TRIED)
    left = np.array([_relative(calibration, place, value, best) for value in tried])
    ends = np.array([left.min(), left.max()])
    return Plot(
        "How badly the streams fit each other, by what is asked",
        axis,
        "misfit (1: as found)",
        (
            Curve("misfit", factor * (tried + coarse_s), left, "line"),
            Curve("as declared", np.full(2, factor * declared), ends, "line"),
            Curve("found", np.full(2, factor * (found + coarse_s)), ends, "line"),
        ),
    )


def _coarse_s(calibration: Calibration, unknown: str) -> float:
    """From which offset of the first look the fit counts a delay."""
    stream = {"gyro_delay_s": 0, "wheel_delay_s": 1}.get(unknown)
    return 0.0 if stream is None else 1e-9 * calibration.alignment.shifts_ns[stream]


def _declared(calibration: Calibration, unknown: str) -> float:
    laser = calibration.inputs.T_base_laser
    names = ("laser_x_m", "laser_y_m", "laser_yaw_rad")
    if unknown not in names or laser is None:
        return 0.0
    return float(laser[names.index(unknown)])


def _left_over(calibration: Calibration, place: int, value: float) -> FloatArray | None:
    """(4,) root mean square of each row of the residual, of the steps that count at the fit."""
    values = calibration.fit.values.copy()
    values[place] = value
    gyro, wheels = calibration.model.covered(calibration.fit.values)
    residual = calibration.model.residual(values)
    residual[:, 2:] = wrap_angle(residual[:, 2:])
    weight = calibration.fit.weight * calibration.fit.used
    of_rows = np.column_stack([wheels, wheels, wheels, gyro]) * weight[:, None]
    total = of_rows.sum(axis=0)
    if total.max(initial=0.0) < _ENOUGH:
        return None
    squares = np.square(np.where(of_rows > 0.0, residual, 0.0)) * of_rows
    return np.asarray(np.sqrt(squares.sum(axis=0) / np.maximum(total, 1e-12)))


def _relative(calibration: Calibration, place: int, value: float, best: FloatArray) -> float:
    left = _left_over(calibration, place, value)
    assert left is not None
    there = best > 0.0
    return float(np.sqrt(np.mean(np.square(left[there] / best[there]))))
