"""Steps of the scans that no robot makes: its wheels tell nothing of them, and before and after
them they roll as always. Where places look alike, that is all that shows that it was carried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from slamsim.core.geometry import between
from slamsim.core.result import Event
from slamsim.core.types import FloatArray
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.matching.base import Match

FALSE_ALARMS = 1e-9
"""Of steps whose errors are Gaussian, with such sigmas as odometry shows here; there are some
100,000 scans in an hour at most."""

SUDDEN_SIGMAS = float(np.sqrt(chdtri(3, FALSE_ALARMS)))

FRICTION_M_S2 = 9.81
"""No floor pushes a robot harder than about its weight."""

LEARN_GAIN = 0.1
"""Share by which the usual time between matches follows each: the last ten or so tell it. Scans
that come sooner were stamped late: some of intel's are 1 ms apart."""

ROUGH_M = 0.02
"""Walls are rough, and maps of them coarse, by so much at most."""

ROUGH_RAD = 0.02
"""The same, seen on walls 1 m away."""

GYRO_SHARE = 0.9
"""A gyroscope that was read for so much of the time between two scans has felt the turn between
them."""


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """From where odometry has a scan to where it was matched, (3,), and since when."""

    start_ns: int
    end_ns: int
    T_odometry_match: FloatArray


class SuddenSteps:
    """Sees each match; one that is farther from the last than any slipping takes a robot counts if
    the next one is where odometry has it: wheels that slip do so for longer. However it is pushed,
    a gyroscope turns with the robot: a turn that it did not feel is none by slipping."""

    def __init__(self) -> None:
        self._matched_ns: int | None = None
        self._step: _Step | None = None
        self._usual_s = 0.0

    def see(self, prediction: Prediction, match: Match, sigmas: float) -> Event | None:
        """What is to be told of the match before. sigmas: how far this one is from where odometry
        has it, in such sigmas as it shows here."""
        before, self._step = self._step, None
        since_ns, self._matched_ns = self._matched_ns, prediction.stamp_ns
        if prediction.jump or prediction.odometry is None or since_ns is None:
            return None
        off = between(prediction.T_map_base, match.T_map_base)
        gap_s = (prediction.stamp_ns - since_ns) * 1e-9
        seconds = max(gap_s, self._usual_s)
        self._usual_s += LEARN_GAIN * (gap_s - self._usual_s)
        # Pushed for half of the time and stopped in the other half.
        slid_m = 0.25 * FRICTION_M_S2 * seconds**2
        slipped = np.hypot(off[0], off[1]) <= slid_m + ROUGH_M
        if sigmas > SUDDEN_SIGMAS and not (slipped and _felt(prediction, match, sigmas)):
            self._step = _Step(since_ns, prediction.stamp_ns, off)
            return None
        return None if before is None or sigmas > SUDDEN_SIGMAS else _told(before)


def _felt(prediction: Prediction, match: Match, sigmas: float) -> bool:
    """Whether the gyroscope, if there is one, felt all of the turn between two scans."""
    odometry = prediction.odometry
    if odometry is None or not odometry.gyro_s > GYRO_SHARE * odometry.seconds > 0.0:
        return True
    turn_rad = abs(float(between(prediction.T_map_base, match.T_map_base)[2]))
    turn_sigmas = turn_rad / np.sqrt(prediction.covariance[2, 2])
    turn_sigmas *= sigmas / prediction.distance(match)
    return bool(turn_rad <= ROUGH_RAD or turn_sigmas <= SUDDEN_SIGMAS)


def _told(step: _Step) -> Event:
    x_m, y_m, turn_rad = step.T_odometry_match.tolist()
    words = (
        f"the scans went {np.hypot(x_m, y_m):.2f} m and {abs(np.rad2deg(turn_rad)):.0f} degrees "
        "from one to the next of which the odometry says nothing, as no robot can slide: it may "
        "have been carried to a place that looks alike, and the map be torn there"
    )
    return Event(step.start_ns, step.end_ns, "torn", words)
