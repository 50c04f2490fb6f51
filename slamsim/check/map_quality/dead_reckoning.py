"""Pose of the laser at any instant, from gyroscope and wheels only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.model import (
    GYRO_BIAS,
    GYRO_DELAY,
    GYRO_DRIFT,
    GYRO_GAIN,
    LASER,
    WHEEL_DELAY,
    WHEEL_DRIFT,
    calibrated_path,
)
from slamsim.check.map_quality.views import WindowView
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.core.geometry import compose
from slamsim.core.types import FloatArray
from slamsim.models.differential_drive import poses_along
from slamsim.models.wheel_gyro import calibrated_turn

FINE_S = 0.01
"""Paths are added up in steps of this."""


@dataclass(frozen=True, slots=True)
class Clock:
    """offset_s: stamp of a stream less the lidar's of the same instant, at the middle of what the
    fit compared; drift: its growth per second."""

    offset_s: float
    drift: float

    def later(self, by_s: float) -> Clock:
        """The clock with a larger offset."""
        return replace(self, offset_s=self.offset_s + by_s)


@dataclass(frozen=True, slots=True)
class Clocks:
    """Of both streams."""

    gyro: Clock
    wheel: Clock


def fitted_clocks(calibration: Calibration) -> Clocks:
    """As the joint fit has them."""
    values = calibration.fit.values
    gyro_ns, wheel_ns = calibration.alignment.shifts_ns
    return Clocks(
        Clock(gyro_ns * 1e-9 + float(values[GYRO_DELAY]), float(values[GYRO_DRIFT])),
        Clock(wheel_ns * 1e-9 + float(values[WHEEL_DELAY]), float(values[WHEEL_DRIFT])),
    )


def laser_poses(calibration: Calibration, view: WindowView, clocks: Clocks) -> FloatArray:
    """(k, 3) of the laser when it saw each piece, in any fixed frame.

    The gyroscope gives the heading, the wheels the path along it; wheels alone give both. Of a
    gyroscope alone the heading is taken, and the place from the scans' own motion.
    """
    count = max(int(np.ptp(view.seen_s) / FINE_S), 1) + 1
    fine_s = np.linspace(view.seen_s.min(), view.seen_s.max(), count)
    heading = _heading(calibration, fine_s, clocks)
    if calibration.model.wheels is None:
        return _by_scans(view, fine_s, heading)
    path = _by_wheels(calibration, fine_s, clocks.wheel)[:, 0]
    steps = np.diff(np.column_stack([path, heading]), axis=0)
    base = poses_along(steps, np.array([0.0, 0.0, heading[0]]))
    at = [np.interp(view.seen_s, fine_s, column) for column in base.T]
    return compose(np.column_stack(at), calibration.fit.values[LASER])


def covered(calibration: Calibration, view: WindowView, clocks: Clocks) -> bool:
    """Whether both streams have readings all the time that a window lasts."""
    times_s = np.array([view.seen_s.min(), view.seen_s.max()])
    for motion, clock in (
        (calibration.model.gyro, clocks.gyro),
        (calibration.model.wheels, clocks.wheel),
    ):
        if motion is not None:
            asked_s = _asked_s(calibration, motion, times_s, clock)
            if asked_s[0] < 0.0 or asked_s[1] > motion.times_s[-1]:
                return False
    return True


def _asked_s(
    calibration: Calibration, motion: IntegratedMotion, times_s: FloatArray, clock: Clock
) -> FloatArray:
    """(n,) times by the lidar's clock as those of a stream, since its origin."""
    since_s = (calibration.model.middle_ns - motion.origin_ns) * 1e-9 + clock.offset_s
    return times_s + since_s + clock.drift * times_s


def _totals(
    calibration: Calibration, motion: IntegratedMotion, times_s: FloatArray, clock: Clock
) -> FloatArray:
    """(n, c) what a stream has added up at times by the lidar's clock."""
    return motion.at(_asked_s(calibration, motion, times_s, clock))


def _heading(calibration: Calibration, times_s: FloatArray, clocks: Clocks) -> FloatArray:
    """(n,) of the base, not wrapped."""
    values, model = calibration.fit.values, calibration.model
    if model.gyro is not None:
        turned = _totals(calibration, model.gyro, times_s, clocks.gyro)[:, 0]
        return calibrated_turn(turned, times_s, values[GYRO_GAIN], values[GYRO_BIAS])
    return _by_wheels(calibration, times_s, clocks.wheel)[:, 1]


def _by_wheels(calibration: Calibration, times_s: FloatArray, clock: Clock) -> FloatArray:
    """(n, 2) path of the base along its heading, m, and its turn, rad."""
    wheels = calibration.model.wheels
    assert wheels is not None
    totals = _totals(calibration, wheels, times_s, clock)
    return calibrated_path(calibration.fit.values, wheels, totals)


def _by_scans(view: WindowView, fine_s: FloatArray, heading: FloatArray) -> FloatArray:
    """(k, 3) with the place from the scans; both headings agree on the average."""
    matched = CubicSpline(view.scan_s, view.T_window_laser[:, :2])
    yaw = np.interp(view.seen_s, fine_s, heading)
    by_scans = np.unwrap(view.T_window_laser[:, 2])
    apart = float(np.mean(by_scans - np.interp(view.scan_s, fine_s, heading)))
    return np.column_stack([matched(view.seen_s), yaw + apart])
