"""Wheels and gyroscope calibrated against what scan matching found, as the robot drives.

A stretch of odometry depends linearly, near enough, on the errors of wheels and gyroscope (Censi,
Franchi, Marchionni & Oriolo 2013 for the wheels). Held against the matched step of the same
stretch it is a linear measurement of them; a Kalman filter in information form adds these up.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.geometry import between, wrap_angle
from slamsim.core.types import FloatArray
from slamsim.models.wheel_gyro import GYRO_BIAS, PARAMETERS, ROWS
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep

PRIOR_SIGMAS = np.array([0.03, 0.1, 0.05, 0.01, 0.02])
"""Of path scale, turn scale, curvature (rad/m), gyroscope's scale and bias (rad/s) at the start."""

MATCH_SIGMA_SCALE = 2.0
MATCH_FLOOR = np.diag(np.square([0.001, 0.001, 0.0003]))
"""What two matches to one local map are off at the least: m, m, rad."""

HELD = 1.0
"""Least information, 1/m^2 and 1/rad^2, along a direction for it to be known at all."""

STRETCH_M, STRETCH_RAD, STRETCH_S = 0.5, 0.5, 5.0
REST_EVIDENCE_S = 0.2
GYRO_SHARE = 0.5
DOUBT_SIGMAS = 3.0
REMEMBERED = 96
FACTORS = np.geomspace(0.0025, 400.0, 53)
LEAST_GYRO_FACTOR = 0.1
"""Matches cannot tell how good a gyroscope is over seconds; none is better than this."""

USUAL_SHARE, USUAL_SQUARE = 0.8, 1.642
"""Of a normal variable, this share of the squares lies below so many variances."""

ASSUMED = 4
"""So many stretches the configured noise counts for."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What stretches of odometry say about the calibration, by leading axes (...).

    jacobian: (..., 4, 5), residual: (..., 4) odometry less match, weight: (..., 4, 4) its inverse
    covariance, zero where there is nothing to compare.
    """

    jacobian: FloatArray
    residual: FloatArray
    weight: FloatArray

    @property
    def squared(self) -> FloatArray:
        """(...) squared residual in sigmas."""
        weighted = self.weight @ self.residual[..., None]
        return np.asarray((self.residual[..., None, :] @ weighted)[..., 0, 0])


def evidence(
    T_matched: FloatArray,
    information: FloatArray,
    T_odometry: FloatArray,
    wheel_turn_rad: FloatArray,
    jacobian: FloatArray,
    covariance: FloatArray,
) -> Evidence:
    """Odometry against matches: (..., 3) steps, (..., 3, 3) information of the matched ones.

    covariance: (..., 4, 4) of odometry and of the turn by the wheels alone, of infinite variance
    where it is no evidence of its own. Directions that the match does not know weigh nothing.
    """
    residual = np.empty((*np.shape(T_matched)[:-1], ROWS))
    residual[..., :3] = between(T_matched, T_odometry)
    residual[..., 3] = wrap_angle(wheel_turn_rad - T_matched[..., 2])
    known = np.zeros((*residual.shape, ROWS))
    known[..., :3, :3] = np.linalg.inv(covariance[..., :3, :3])
    known[..., 3, 3] = 1.0 / covariance[..., 3, 3]
    # Both yaw rows are compared with one matched yaw; (Woodbury) it may lack a direction.
    spread = np.vstack([np.eye(3), [0.0, 0.0, 1.0]])
    inner = information + spread.T @ known @ spread
    lost = known @ spread @ np.linalg.inv(inner) @ spread.T @ known
    return Evidence(jacobian, residual, known - lost)


def match_information(information: FloatArray) -> FloatArray:
    """(..., 3, 3) of a step between two matches, from that of the later: scans are not independent,
    and no match is better than its floor."""
    both = information / (2.0 * MATCH_SIGMA_SCALE**2)
    floored: FloatArray = both @ np.linalg.inv(np.eye(3) + MATCH_FLOOR @ both)
    return 0.5 * (floored + np.swapaxes(floored, -1, -2))


def step_covariance(step: OdometryStep, noise: OdometryNoise) -> FloatArray:
    """(4, 4) of a step's random errors; the turn by the wheels counts beside a gyroscope only."""
    covariance = np.zeros((ROWS, ROWS))
    covariance[:3, :3] = noise.covariance(step)
    own = step.gyro_s > GYRO_SHARE * step.seconds and step.rest_s < step.seconds
    turn = noise.wheel_turn_variance(step) + step.reading_rad**2 + step.doubt[2]
    covariance[3, 3] = turn if own else np.inf
    return covariance


class Calibrator:
    """Estimates the calibration and the noise of odometry from all matches so far."""

    def __init__(self, noise: OdometryNoise) -> None:
        self.parameters: FloatArray = np.zeros(PARAMETERS)
        """(5,), see ``steps``."""
        self.covariance: FloatArray = np.diag(np.square(PRIOR_SIGMAS))
        """(5, 5)."""
        self.noise = noise
        self._learners = (_Factor(), _Factor(), _Factor())
        self._stretch = OdometryStep.none(self.parameters)
        self._T_map_start: FloatArray | None = None
        self._rest_s = self._rest_turn_rad = 0.0

    @property
    def bias_sigma_rad_s(self) -> float:
        return float(np.sqrt(self.covariance[GYRO_BIAS, GYRO_BIAS]))

    def uncertainty(self, step: OdometryStep) -> FloatArray:
        """(3, 3) of a step, from what is not known of the calibration."""
        jacobian = step.jacobian[:3]
        return np.asarray(jacobian @ self.covariance @ jacobian.T)

    def follow(self, step: OdometryStep, T_map_base: FloatArray, information: FloatArray) -> None:
        """Take a step that ended in a match of the given information; see ``lose`` without one."""
        walk = self.noise.config.gyro_bias_walk
        self.covariance[GYRO_BIAS, GYRO_BIAS] += walk**2 * step.seconds
        self._rest(step)
        if self._T_map_start is None:
            self._begin(T_map_base)
            return
        self._stretch = self._stretch.then(step)
        stretch = self._stretch
        if stretch.doubt.any():
            self._begin(T_map_base)
        elif (
            stretch.path_m >= STRETCH_M
            or stretch.turned_rad >= STRETCH_RAD
            or (stretch.seconds >= STRETCH_S and stretch.path_m > 0.0)
        ):
            self._take(between(self._T_map_start, T_map_base), match_information(information))
            self._begin(T_map_base)

    def lose(self) -> None:
        """The robot's place is not known: what was gathered since the last stretch is void."""
        self._T_map_start = None

    def _begin(self, T_map_base: FloatArray) -> None:
        self._T_map_start = T_map_base
        self._stretch = OdometryStep.none(self.parameters)

    def _take(self, T_matched: FloatArray, information: FloatArray) -> None:
        step = self._stretch.at(self.parameters)
        own = step_covariance(step, self.noise)
        found = evidence(
            *(T_matched, information, step.T_first_last, np.asarray(step.wheel_turn_rad)),
            *(step.jacobian, own),
        )
        if np.linalg.eigvalsh(information)[0] > HELD:
            matched = np.asarray(np.linalg.inv(information), dtype=np.float64)
            self._learn(step, found, matched, own)
        expected = self.covariance + _tiny()
        innovation = float(found.squared) / (1.0 + _spread(found, expected))
        doubt = 1.0 / (1.0 + innovation / DOUBT_SIGMAS**2 / ROWS)
        weight = doubt * found.weight
        gained = found.jacobian.T @ weight @ found.jacobian
        self.covariance = np.asarray(np.linalg.inv(np.linalg.inv(expected) + gained), np.float64)
        push = found.jacobian.T @ weight @ found.residual
        self.parameters = self.parameters - self.covariance @ push

    def _rest(self, step: OdometryStep) -> None:
        """At rest the gyroscope shows its bias."""
        self._rest_s += step.rest_s
        self._rest_turn_rad += step.rest_turn_rad
        if self._rest_s < REST_EVIDENCE_S:
            return
        scale = 1.0 + self.parameters[GYRO_BIAS - 1]
        bias = scale * self._rest_turn_rad / self._rest_s
        variance = self.noise.config.gyro_rad_per_sqrt_s**2 / self._rest_s
        gain = self.covariance[GYRO_BIAS] / (self.covariance[GYRO_BIAS, GYRO_BIAS] + variance)
        self.parameters = self.parameters + gain * (bias - self.parameters[GYRO_BIAS])
        self.covariance = self.covariance - np.outer(gain, self.covariance[GYRO_BIAS])
        self._rest_s = self._rest_turn_rad = 0.0

    def _learn(
        self, step: OdometryStep, found: Evidence, matched: FloatArray, own: FloatArray
    ) -> None:
        """Fit the noise of path, wheels' turn and gyroscope to what was found."""
        known = found.jacobian @ self.covariance @ found.jacobian.T
        unit = replace(self.noise, path=1.0, turn=1.0, gyro=1.0)
        squares = np.square(found.residual)
        by_gyro = bool(np.isfinite(own[3, 3]))
        path, turn, gyro = self._learners
        if step.path_m > 0.0:
            fixed = matched[0, 0] + known[0, 0] + step.reading_m**2
            path.see(squares[0], fixed, unit.path_variance(step))
            fixed = matched[2, 2] + known[3, 3] + step.reading_rad**2
            turn.see(squares[3], fixed, unit.wheel_turn_variance(step))
        if by_gyro:
            gyro.see(squares[2], matched[2, 2] + known[2, 2], unit.gyro_variance(step))
        least = max(gyro.factor, LEAST_GYRO_FACTOR)
        self.noise = replace(self.noise, path=path.factor, turn=turn.factor, gyro=least)


class _Factor:
    """By how much a variance must be multiplied for residuals to be what it says."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float, float]] = deque(
            [(USUAL_SQUARE, 0.0, 1.0)] * ASSUMED, maxlen=REMEMBERED
        )
        self.factor = 1.0

    def see(self, square: float, fixed: float, variance: float) -> None:
        """A squared residual of variance ``fixed + factor * variance``."""
        self._seen.append((square, fixed, variance))
        self.factor = fit_factor(np.array(self._seen))


def fit_factor(seen: FloatArray) -> float:
    """The least factor with which the usual share of (n, 3) rows (square, fixed, variance) keep
    below ``USUAL_SQUARE * (fixed + factor * variance)``: outliers count, their size does not."""
    square, fixed, variance = seen.T
    allowed = USUAL_SQUARE * (fixed[:, None] + variance[:, None] * FACTORS)
    share = (square[:, None] <= allowed * (1.0 + 1e-9)).mean(axis=0)
    enough = np.flatnonzero(share >= USUAL_SHARE)
    return float(FACTORS[enough[0]] if enough.size else FACTORS[-1])


def _tiny() -> FloatArray:
    """Keeps the filter able to learn for ever: no calibration is constant to the last digit."""
    return np.diag(np.square(np.array([1e-6, 1e-6, 1e-6, 1e-6, 0.0])))


def _spread(found: Evidence, covariance: FloatArray) -> float:
    """How many times its own variance the residual may have for the calibration's sake."""
    known = found.jacobian @ covariance @ found.jacobian.T
    return float(np.trace(found.weight @ known)) / ROWS
