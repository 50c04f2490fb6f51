"""Where the robot should be at the next scan, how surely, and what its odometry is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.geometry import between, compose, inverse
from slamsim.slam.matching.base import Match
from slamsim.slam.motion import motion_covariance
from slamsim.types import FloatArray, PlanarTrajectory, Scan

MAX_SPEED_M_S = 10.0
MAX_TURN_RAD_S = 10.0
FLOOR_M = 0.0005
FLOOR_RAD = 0.0002
BLIND_SPEED_SIGMA_M_S2 = 1.5
BLIND_TURN_SIGMA_RAD_S2 = 3.0
LOST_GROWTH = 4.0
"""Each scan that fits nowhere makes the odometry this much more doubtful."""

MAX_VARIANCE = 1.0
DISTRUST_GAIN = 0.1
ONE_SIGMA_SHARE = 0.683
MAX_DISTRUST = 100.0
MAX_COAST_S = 1.0
"""A speed is not believed to last for longer."""

MIN_JUMP_S = 0.05
"""Stamps are not believed to be finer than this when a speed is taken from them."""

JUMP_VARIANCE = np.square([0.3, 0.3, 0.2])


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """T_map_base: (3,) with covariance (3, 3) of a small step of the base in its own frame.

    T_last_base: (3,) the predicted step since the last scan. T_map_hold: (3,) where the robot is
    if the odometry is wrong and it stood. jump: whether no robot can make that step.
    """

    stamp_ns: int
    T_map_base: FloatArray
    covariance: FloatArray
    T_odom_base: FloatArray
    T_last_base: FloatArray
    T_map_hold: FloatArray
    jump: bool

    def distance(self, match: Match) -> float:
        """How many sigmas (Mahalanobis) the match lies from the prediction."""
        step = between(self.T_map_base, match.T_map_base)
        return float(np.sqrt(step @ np.linalg.solve(self.covariance, step)))


class Predictor:
    """Keeps the pose between scans; motion None means constant velocity."""

    def __init__(self, config: MotionConfig, motion: PlanarTrajectory | None, gyro: bool) -> None:
        self._config, self._motion, self._gyro = config, motion, gyro
        self._last: Prediction | None = None
        self._T_map_base = np.zeros(3)
        self._covariance = np.diag(np.square([FLOOR_M, FLOOR_M, FLOOR_RAD]))
        self._velocity = np.zeros(3)
        self._distrust = np.ones(3)
        self.jumps = 0
        """Steps of the odometry that no robot can make, and that were not believed."""

    @property
    def blind(self) -> bool:
        """Whether there is no odometry at all."""
        return self._motion is None

    def renew_motion(self, motion: PlanarTrajectory | None) -> None:
        """``T_odom_base`` as it is known by now: any window from the last scan on will do."""
        self._motion = motion

    @property
    def T_map_base(self) -> FloatArray:  # noqa: N802
        """(3,) at the last scan."""
        return self._T_map_base

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of a small step of the base in its own frame, at the last scan."""
        return self._covariance

    def place(self, T_map_base: FloatArray, covariance: FloatArray) -> None:
        """The robot is known to be somewhere else."""
        self._T_map_base, self._covariance = T_map_base, covariance

    def motion_over(self, scan: Scan) -> PlanarTrajectory | None:
        """The base's motion over the scan's beams, None where it is not known."""
        first, last = min(scan.stamp_ns, scan.end_ns), max(scan.stamp_ns, scan.end_ns)
        if self._motion is None:
            return _arc(self._velocity, first, last)
        covered = self._motion.stamps_ns
        return self._motion if first >= covered[0] and last <= covered[-1] else None

    def motion_after(self, scan: Scan, match: Match) -> PlanarTrajectory:
        """Motion over the scan's beams at the speed that its match shows since the last scan."""
        first, last = min(scan.stamp_ns, scan.end_ns), max(scan.stamp_ns, scan.end_ns)
        velocity = self._velocity
        if self._last is not None and scan.stamp_ns > self._last.stamp_ns:
            seconds = (scan.stamp_ns - self._last.stamp_ns) * 1e-9
            velocity = between(self._T_map_base, match.T_map_base) / seconds
        return _arc(velocity, first, last)

    def predict(self, stamp_ns: int) -> Prediction:
        """The pose at a scan's stamp, which motion_over has found to be covered."""
        T_odom_base = self._odometry_at(stamp_ns)
        if self._last is None:
            at = self._T_map_base
            return Prediction(stamp_ns, at, self._covariance, T_odom_base, np.zeros(3), at, False)
        seconds = max((stamp_ns - self._last.stamp_ns) * 1e-9, 0.0)
        step, noise, jump = self._step(self._last.T_odom_base, T_odom_base, seconds)
        self.jumps += jump
        T_map_base = compose(self._T_map_base, step)
        carry = _adjoint(inverse(step))
        covariance = carry @ self._covariance @ carry.T + noise
        still = self._T_map_base
        return Prediction(stamp_ns, T_map_base, covariance, T_odom_base, step, still, jump)

    def coasting(self, prediction: Prediction) -> FloatArray:
        """T_map_base at the prediction's stamp if the robot went on as it did before."""
        if self._last is None:
            return self._T_map_base
        seconds = min((prediction.stamp_ns - self._last.stamp_ns) * 1e-9, MAX_COAST_S)
        return compose(self._T_map_base, self._velocity * seconds)

    def update(self, prediction: Prediction, match: Match | None) -> FloatArray:
        """T_map_base after the match, or as predicted without one."""
        followed = prediction.T_map_hold if prediction.jump else prediction.T_map_base
        T_map_base = followed if match is None else match.T_map_base
        if match is None:
            widest = float(np.diag(prediction.covariance).max())
            self._covariance = prediction.covariance * min(LOST_GROWTH, MAX_VARIANCE / widest)
        else:
            prior = np.linalg.inv(prediction.covariance)
            self._covariance = np.linalg.inv(prior + match.information)
            self._learn(prediction, match)
        if self._last is not None:
            seconds = (prediction.stamp_ns - self._last.stamp_ns) * 1e-9
            if seconds > 0.0:
                self._velocity = between(self._T_map_base, T_map_base) / seconds
        self._last, self._T_map_base = prediction, T_map_base
        return T_map_base

    def _odometry_at(self, stamp_ns: int) -> FloatArray:
        if self._motion is not None:
            return np.asarray(self._motion.at(np.array([stamp_ns]))[0])
        if self._last is None:
            return np.zeros(3)
        seconds = (stamp_ns - self._last.stamp_ns) * 1e-9
        return compose(self._T_map_base, self._velocity * seconds)

    def _step(
        self, T_odom_last: FloatArray, T_odom_base: FloatArray, seconds: float
    ) -> tuple[FloatArray, FloatArray, bool]:
        """The step since the last scan, its covariance, and whether it is an impossible one."""
        floor = np.diag(np.square([FLOOR_M, FLOOR_M, FLOOR_RAD]))
        if self._motion is None:
            sigma_m = BLIND_SPEED_SIGMA_M_S2 * seconds * seconds
            sigma_rad = BLIND_TURN_SIGMA_RAD_S2 * seconds * seconds
            noise = floor + np.diag(np.square([sigma_m, sigma_m, sigma_rad]))
            return self._velocity * seconds, noise, False
        step = between(T_odom_last, T_odom_base)
        allowed_s = max(seconds, MIN_JUMP_S)
        moved_m, turned_rad = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        if moved_m > MAX_SPEED_M_S * allowed_s or turned_rad > MAX_TURN_RAD_S * allowed_s:
            return step, floor + np.diag(JUMP_VARIANCE), True
        noise = motion_covariance(step, seconds, self._gyro, self._config)
        return (
            step,
            floor + noise * np.sqrt(np.outer(self._distrust, self._distrust)),
            False,
        )

    def _learn(self, prediction: Prediction, match: Match) -> None:
        """Believe the odometry less where matches keep contradicting it."""
        if self._motion is None or match.degenerate or prediction.jump:
            return
        found = between(prediction.T_map_base, match.T_map_base)
        own = np.diag(motion_covariance(prediction.T_last_base, 0.0, self._gyro, self._config))
        if own[0] < FLOOR_M**2:
            return
        matched = np.diag(np.linalg.inv(match.information + np.diag([1.0, 1.0, 1.0])))
        excess = np.maximum(found * found - matched, 0.0) / (own + FLOOR_RAD**2)
        excess[:2] = excess[:2].mean()
        # A step towards the share of one sigma, up or down: outliers count, but not their size.
        towards = np.where(excess > self._distrust, ONE_SIGMA_SHARE, ONE_SIGMA_SHARE - 1.0)
        self._distrust = np.clip(
            self._distrust * np.exp(DISTRUST_GAIN * towards), 1.0, MAX_DISTRUST
        )


def _arc(velocity: FloatArray, first_ns: int, last_ns: int) -> PlanarTrajectory:
    """Constant velocity (m/s, m/s, rad/s) of the base for a short while."""
    last_ns = max(last_ns, first_ns + 1)
    end = velocity * (last_ns - first_ns) * 1e-9
    return PlanarTrajectory(np.array([first_ns, last_ns]), np.stack([np.zeros(3), end]))


def _adjoint(T_a_b: FloatArray) -> FloatArray:
    """(3, 3): takes a small step in frame b to the same step in frame a."""
    x, y, yaw = T_a_b
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, y], [sin, cos, -x], [0.0, 0.0, 1.0]])
