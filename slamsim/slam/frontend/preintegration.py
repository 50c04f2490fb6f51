"""A stretch of odometry as a measurement: what it says, how it hangs on the calibration of wheels
and gyroscope, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import adjoint, compose, inverse
from slamsim.core.types import FloatArray
from slamsim.models.wheel_gyro import PARAMETERS, ROWS


@dataclass(frozen=True, slots=True, eq=False)
class OdometryStep:
    """What wheels and gyroscope say of the motion from one instant to another.

    T_first_last: (3,) for the given parameters (5,); its yaw is the gyroscope's where there is one.
    wheel_turn_rad: the turn by the wheels alone, not wrapped. jacobian: (4, 5) by the parameters,
    of a small step of the base at its end and of wheel_turn_rad. path_m, turned_rad: without regard
    to sign; gyro_s: for how long the yaw is the gyroscope's. rest_s, rest_turn_rad: time at rest,
    and the gyroscope's raw turn in it. reading_m, reading_rad: standard deviation that reading the
    wheels at both ends adds, however long the step. doubt: (3,) variances (m^2, m^2, rad^2) that
    a disagreement with other sensors adds, 0 for none.
    """

    T_first_last: FloatArray
    wheel_turn_rad: float
    parameters: FloatArray
    jacobian: FloatArray
    seconds: float
    path_m: float
    turned_rad: float
    gyro_s: float
    rest_s: float
    rest_turn_rad: float
    reading_m: float
    reading_rad: float
    doubt: FloatArray

    @staticmethod
    def none(parameters: FloatArray) -> OdometryStep:
        """No motion in no time."""
        zero, jacobian = np.zeros(3), np.zeros((ROWS, PARAMETERS))
        return OdometryStep(
            zero, 0.0, parameters, jacobian, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, doubt=zero
        )

    def at(self, parameters: FloatArray) -> OdometryStep:
        """The same for other parameters, to first order."""
        moved = self.jacobian @ (parameters - self.parameters)
        return replace(
            self,
            T_first_last=compose(self.T_first_last, moved[:3]),
            wheel_turn_rad=self.wheel_turn_rad + float(moved[3]),
            parameters=parameters,
        )

    def then(self, onward: OdometryStep) -> OdometryStep:
        """This step and the next as one, for the parameters of the next."""
        before = self.at(onward.parameters)
        carry = np.eye(ROWS)
        carry[:3, :3] = adjoint(inverse(onward.T_first_last))
        return OdometryStep(
            compose(before.T_first_last, onward.T_first_last),
            before.wheel_turn_rad + onward.wheel_turn_rad,
            onward.parameters,
            carry @ before.jacobian + onward.jacobian,
            before.seconds + onward.seconds,
            before.path_m + onward.path_m,
            before.turned_rad + onward.turned_rad,
            before.gyro_s + onward.gyro_s,
            before.rest_s + onward.rest_s,
            before.rest_turn_rad + onward.rest_turn_rad,
            max(before.reading_m, onward.reading_m),
            max(before.reading_rad, onward.reading_rad),
            before.doubt + onward.doubt,
        )

    def doubted(self, variance: FloatArray) -> OdometryStep:
        """The same with more variance (3,): m^2, m^2, rad^2."""
        return replace(self, doubt=self.doubt + variance)


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Random errors of odometry; those of the calibration are told by the jacobian of a step.

    path, turn, gyro: factors on the configured variances of the wheels' path, the wheels' turn and
    the gyroscope's turn, as learnt from matches.
    """

    config: MotionConfig
    path: float = 1.0
    turn: float = 1.0
    gyro: float = 1.0

    def path_variance(self, step: OdometryStep) -> float:
        """m^2, along and across, reading apart; errors add up as those of a random walk."""
        config = self.config
        walked = config.slip_m_per_sqrt_m**2 * step.path_m
        turned = config.slip_m_per_sqrt_rad**2 * step.turned_rad
        return self.path * (walked + turned)

    def wheel_turn_variance(self, step: OdometryStep) -> float:
        """rad^2, reading apart."""
        config = self.config
        walked = config.turn_rad_per_sqrt_m**2 * step.path_m
        turned = config.turn_rad_per_sqrt_rad**2 * step.turned_rad
        return self.turn * (walked + turned)

    def gyro_variance(self, step: OdometryStep) -> float:
        """rad^2."""
        config = self.config
        return self.gyro * (
            config.gyro_rad_per_sqrt_s**2 * step.seconds
            + config.gyro_rad_per_sqrt_rad**2 * step.turned_rad
        )

    def covariance(self, step: OdometryStep) -> FloatArray:
        """(3, 3) of a small step of the base at its end; a heading wrong on the way leads aside."""
        by_gyro = step.gyro_s / step.seconds if step.seconds > 0.0 else 0.0
        yaw = by_gyro * self.gyro_variance(step)
        yaw += (1.0 - by_gyro) * (self.wheel_turn_variance(step) + step.reading_rad**2)
        position = self.path_variance(step) + step.reading_m**2
        half = 0.5 * step.path_m
        covariance = np.diag([position, position + half * half * yaw * 4.0 / 3.0, yaw])
        covariance[1, 2] = covariance[2, 1] = half * yaw
        return np.asarray(covariance + np.diag(step.doubt))


def then(one: OdometryStep | None, other: OdometryStep | None) -> OdometryStep | None:
    """One step after the other, None if one of them is not known."""
    return None if one is None or other is None else one.then(other)
