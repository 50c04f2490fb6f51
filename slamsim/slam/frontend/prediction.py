"""Where the robot should be at the next scan, how surely, and what its odometry is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import adjoint, between, compose, inverse, wrap_angle
from slamsim.core.result import Calibrated, Event
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan
from slamsim.slam.calibration.calibrated import calibrated
from slamsim.slam.calibration.online import Calibrator
from slamsim.slam.calibration.solve import Solved
from slamsim.slam.frontend.motion import Odometry
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep
from slamsim.slam.frontend.slip import Look, SlipWatch, coasted
from slamsim.slam.matching.base import Match

MAX_SPEED_M_S = 10.0
MAX_TURN_RAD_S = 10.0
FLOOR = np.diag(np.square([0.0005, 0.0005, 0.0002]))
REST_FLOOR = np.diag(np.square([0.00005, 0.00005, 0.00002]))
BLIND_SPEED_SIGMA_M_S2 = 1.5
BLIND_TURN_SIGMA_RAD_S2 = 3.0
DISTRUST_GAIN = 0.1
ONE_SIGMA_SHARE = 0.683
MAX_DISTRUST = 100.0
MAX_COAST_S = 1.0
"""A speed is not believed to last for longer."""

MIN_JUMP_S = 0.05
"""Stamps are not believed to be finer than this when a speed is taken from them."""

JUMP_VARIANCE = np.square([0.3, 0.3, 0.2])
"""Of a step that no robot can make, 0.3 m along and across and 0.2 rad: near the place it had, with
little to hold it there."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """T_map_base: (3,) with covariance (3, 3) of a small step of the base in its own frame.

    T_last_base: (3,) the predicted step since the last update, step_covariance: (3, 3) of it alone.
    T_map_hold: (3,) where the robot is
    if the odometry is wrong and it stood. jump: whether no robot can make that step. T_odom_base:
    (3,) by odometry alone. odometry: what that says of the step; None if there is none.
    """

    stamp_ns: int
    T_map_base: FloatArray
    covariance: FloatArray
    T_odom_base: FloatArray
    T_last_base: FloatArray
    T_map_hold: FloatArray
    jump: bool
    odometry: OdometryStep | None
    step_covariance: FloatArray

    def distance(self, match: Match) -> float:
        """How many sigmas (Mahalanobis) the match lies from the prediction."""
        step = between(self.T_map_base, match.T_map_base)
        return float(np.sqrt(step @ np.linalg.solve(self.covariance, step)))


class Predictor:
    """Keeps the pose between scans; odometry None means constant velocity.

    The odometry is calibrated by the matches as they come, each prediction knowing only those
    before it.
    """

    def __init__(self, config: MotionConfig, odometry: Odometry | None) -> None:
        self._config = config
        self._odometry: Odometry | None = None
        self._calibrator: Calibrator | None = None
        self.renew_motion(odometry)
        self._slip = SlipWatch()
        self._last: Prediction | None = None
        self._T_map_base = np.zeros(3)
        self._covariance = FLOOR
        self._velocity = np.zeros(3)
        self._distrust = np.ones(3)
        self.jumps = 0
        """Steps of the odometry that no robot can make, and that were not believed."""
        self.step: OdometryStep | None = None
        """From the last scan but one to the last by odometry, doubted where others contradict."""
        self._held_ns: int | None = None

    @property
    def blind(self) -> bool:
        """Whether there is no odometry at all."""
        return self._odometry is None

    def events(self) -> tuple[Event, ...]:
        """When the wheels were not believed."""
        return self._slip.events()

    def renew_motion(self, odometry: Odometry | None) -> None:
        """The odometry as it is known by now: any window from the last scan on will do."""
        self._odometry = odometry
        if odometry is not None and self._calibrator is None:
            self._calibrator = Calibrator(OdometryNoise(self._config))

    def calibrated(self, solved: Solved | None) -> dict[str, Calibrated]:
        """A calibration in the units of this robot; nothing without odometry."""
        if solved is None or self._odometry is None:
            return {}
        return calibrated(solved, self._odometry.reading, self._odometry.has_gyro)

    @property
    def T_map_base(self) -> FloatArray:  # noqa: N802
        """(3,) at the last scan."""
        return self._T_map_base

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of a small step of the base in its own frame, at the last scan."""
        return self._covariance

    def place(self, T_map_base: FloatArray, covariance: FloatArray) -> None:
        """The robot is known to be somewhere else; its speed stays as it was.

        T_map_base: (3,) with its covariance (3, 3).
        """
        self._T_map_base, self._covariance = T_map_base, covariance
        if self._calibrator is not None:
            self._calibrator.lose()

    def rest(self) -> None:
        """Nothing is known of the speed any more."""
        self._velocity = np.zeros(3)

    def motion_over(self, scan: Scan) -> PlanarTrajectory | None:
        """The base's motion over the scan's beams; None where it was not known yet.

        Where odometry is silent, or has ended, the speed is taken as constant.
        """
        first, last = scan.span_ns
        if self._odometry is None or self._calibrator is None:
            return _arc(self._velocity, first, last)
        if not self._odometry.covers(first, last):
            return None if self._last is None else _arc(self._velocity, first, last)
        path = self._odometry.path(first, last, self._calibrator.parameters)
        if not self._slip.coasting:
            return path
        seconds = max(last - first, 1) * 1e-9
        turned = coasted(path.poses[-1], self._velocity, seconds, self._odometry.has_gyro)
        return _arc(turned / seconds, first, last)

    def motion_after(self, scan: Scan, match: Match) -> PlanarTrajectory:
        """Motion over the scan's beams at the speed that its match shows since the last scan."""
        first, last = scan.span_ns
        velocity = self._velocity
        if self._last is not None and scan.stamp_ns > self._last.stamp_ns:
            seconds = (scan.stamp_ns - self._last.stamp_ns) * 1e-9
            velocity = between(self._T_map_base, match.T_map_base) / seconds
        return _arc(velocity, first, last)

    def predict(self, stamp_ns: int) -> Prediction:
        """The pose at a scan's stamp, which motion_over has found to be covered, from that of the
        last update."""
        at, last = self._T_map_base, self._last
        if last is None:
            zero = np.zeros(3)
            still = np.zeros((3, 3))
            return Prediction(stamp_ns, at, self._covariance, zero, zero, at, False, None, still)
        seconds = max((stamp_ns - last.stamp_ns) * 1e-9, 0.0)
        odometry = self._odometry_since(last.stamp_ns, stamp_ns)
        if odometry is None:
            step, jump = self._velocity * seconds, False
            noise = FLOOR + np.diag(_blind_variance(seconds))
            T_odom_base = compose(last.T_odom_base, step)
        else:
            step, noise, jump = self._expect(odometry)
            T_odom_base = compose(last.T_odom_base, odometry.T_first_last)
        carry = adjoint(inverse(step))
        covariance = carry @ self._covariance @ carry.T + noise
        T_map_base = compose(at, step)
        return Prediction(
            stamp_ns, T_map_base, covariance, T_odom_base, step, at, jump, odometry, noise
        )

    def coasting(self, prediction: Prediction) -> FloatArray:
        """(3,) T_map_base at the prediction's stamp if the robot went on as it did before."""
        if self._last is None:
            return self._T_map_base
        seconds = min((prediction.stamp_ns - self._last.stamp_ns) * 1e-9, MAX_COAST_S)
        return compose(self._T_map_base, self._velocity * seconds)

    def hold(self, prediction: Prediction) -> FloatArray:
        """(3,) T_map_base as predicted of a scan that is to be matched with the next ones; the next
        prediction starts at the same update as this one.
        """
        self.step = self._since_last_scan(prediction, prediction.odometry)
        self._held_ns = prediction.stamp_ns
        return prediction.T_map_base

    def update(self, prediction: Prediction, match: Match | None) -> FloatArray:
        """(3,) T_map_base after the match, or as predicted without one."""
        self.jumps += prediction.jump
        followed = prediction.T_map_hold if prediction.jump else prediction.T_map_base
        T_map_base = followed if match is None else match.T_map_base
        odometry = self._judge(prediction, match)
        if match is None:
            self._covariance = prediction.covariance
            if odometry is not None and self._slip.twisting:  # the gyroscope tells, not the scans
                self._covariance = self._covariance + np.diag(odometry.doubt)
        else:
            prior = np.linalg.inv(prediction.covariance)
            self._covariance = np.linalg.inv(prior + match.information)
        self.step = self._since_last_scan(prediction, odometry)
        self._held_ns = None
        if self._last is not None:
            seconds = (prediction.stamp_ns - self._last.stamp_ns) * 1e-9
            if seconds > 0.0:
                self._velocity = between(self._T_map_base, T_map_base) / seconds
        self._last, self._T_map_base = prediction, T_map_base
        return T_map_base

    def _odometry_since(self, first_ns: int, last_ns: int) -> OdometryStep | None:
        """What wheels and gyroscope say of a stretch, as calibrated by now."""
        odometry, calibrator = self._odometry, self._calibrator
        if odometry is None or calibrator is None or not odometry.covers(first_ns, last_ns):
            return None
        sigma_rad_s = calibrator.bias_sigma_rad_s
        return odometry.step(first_ns, last_ns, calibrator.parameters, sigma_rad_s)

    def _since_last_scan(
        self, prediction: Prediction, since_update: OdometryStep | None
    ) -> OdometryStep | None:
        """The step since the last scan, doubted as the one since the last update is."""
        if since_update is None or self._held_ns is None:
            return since_update
        step = self._odometry_since(self._held_ns, prediction.stamp_ns)
        return None if step is None else step.doubted(since_update.doubt)

    def _expect(self, odometry: OdometryStep) -> tuple[FloatArray, FloatArray, bool]:
        """The step since the last scan, its covariance, and whether it is an impossible one."""
        calibrator, step = self._calibrator, odometry.T_first_last
        assert calibrator is not None
        allowed_s = max(odometry.seconds, MIN_JUMP_S)
        moved_m, turned_rad = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        if moved_m > MAX_SPEED_M_S * allowed_s or turned_rad > MAX_TURN_RAD_S * allowed_s:
            return step, FLOOR + np.diag(JUMP_VARIANCE), True
        own = calibrator.noise.covariance(odometry) + calibrator.uncertainty(odometry)
        if self._slip.coasting:
            gyro = odometry.gyro_s > 0.0
            step = coasted(step, self._velocity, odometry.seconds, gyro)
            own = own + np.diag(_blind_variance(odometry.seconds) * [1.0, 1.0, float(not gyro)])
        floor = REST_FLOOR if odometry.rest_s > 0.0 else FLOOR
        return step, floor + own * np.sqrt(np.outer(self._distrust, self._distrust)), False

    def _judge(self, prediction: Prediction, match: Match | None) -> OdometryStep | None:
        """The step by odometry, after learning from the match what it is worth."""
        odometry, calibrator = prediction.odometry, self._calibrator
        if calibrator is not None and odometry is None:
            calibrator.lose()
        if odometry is None or calibrator is None:
            return None
        if prediction.jump:
            calibrator.lose()
            return odometry.doubted(JUMP_VARIANCE)
        own = calibrator.noise.covariance(odometry) + calibrator.uncertainty(odometry)
        matched = None
        if match is not None and not match.degenerate:
            matched = np.asarray(np.linalg.inv(match.information + np.eye(3)), np.float64)
            self._learn(prediction, match, np.diag(own), np.diag(matched))
        doubt = self._slip.see(self._look(prediction, match, np.diag(own), matched))
        odometry = odometry.doubted(doubt)
        if match is None:
            calibrator.lose()
        else:
            calibrator.follow(odometry, match.T_map_base, match.information)
        return odometry

    def _look(
        self,
        prediction: Prediction,
        match: Match | None,
        own: FloatArray,
        matched: FloatArray | None,
    ) -> Look:
        odometry, calibrator, last = prediction.odometry, self._calibrator, self._last
        assert odometry is not None and calibrator is not None and last is not None
        wheels = coast = variance = np.full(3, np.nan)
        turn_rad = turn_variance = np.nan
        if match is not None and matched is not None:
            found = between(self._T_map_base, match.T_map_base)
            gyro = odometry.gyro_s > 0.0
            steady = coasted(odometry.T_first_last, self._velocity, odometry.seconds, gyro)
            wheels, coast = between(odometry.T_first_last, found), between(steady, found)
            variance = own * self._distrust + 2.0 * np.diag(matched) + np.diag(FLOOR)
        if odometry.gyro_s > 0.9 * odometry.seconds > 0.0:
            turned = odometry.T_first_last[2]
            turn_rad = float(wrap_angle(np.asarray(odometry.wheel_turn_rad - turned)))
            known = odometry.jacobian[3] - odometry.jacobian[2]
            turn_variance = own[2] + odometry.reading_rad**2
            turn_variance += calibrator.noise.wheel_turn_variance(odometry)
            turn_variance += float(known @ calibrator.covariance @ known)
        return Look(
            *(last.stamp_ns, prediction.stamp_ns, wheels, coast, variance),
            *(turn_rad, turn_variance, odometry.path_m),
        )

    def _learn(
        self, prediction: Prediction, match: Match, own: FloatArray, matched: FloatArray
    ) -> None:
        """Believe the odometry less where matches keep contradicting it."""
        if own[0] < FLOOR[0, 0]:
            return
        found = between(prediction.T_map_base, match.T_map_base)
        excess = np.maximum(found * found - matched, 0.0) / (own + FLOOR[2, 2])
        excess[:2] = excess[:2].mean()
        # A step towards the share of one sigma, up or down: outliers count, but not their size.
        towards = np.where(excess > self._distrust, ONE_SIGMA_SHARE, ONE_SIGMA_SHARE - 1.0)
        changed = self._distrust * np.exp(DISTRUST_GAIN * towards)
        self._distrust = np.clip(changed, 1.0, MAX_DISTRUST)


def _blind_variance(seconds: float) -> FloatArray:
    """(3,) of a step at constant velocity."""
    per_s2 = [BLIND_SPEED_SIGMA_M_S2, BLIND_SPEED_SIGMA_M_S2, BLIND_TURN_SIGMA_RAD_S2]
    return np.square(np.array(per_s2) * seconds * seconds)


def _arc(velocity: FloatArray, first_ns: int, last_ns: int) -> PlanarTrajectory:
    """Constant velocity (m/s, m/s, rad/s) of the base for a short while."""
    last_ns = max(last_ns, first_ns + 1)
    end = velocity * (last_ns - first_ns) * 1e-9
    return PlanarTrajectory(np.array([first_ns, last_ns]), np.stack([np.zeros(3), end]))
