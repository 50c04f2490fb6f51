"""Predicts the laser's motion from wheels and gyroscope with given errors."""

from __future__ import annotations

import numpy as np

from slamsim.check.motion.integrated import IntegratedMotion, smooth_curve
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.geometry import between, compose, inverse, wrap_angle
from slamsim.core.types import BoolArray, FloatArray
from slamsim.models.differential_drive import calibrated_motion, chord_of, poses_along
from slamsim.models.wheel_gyro import calibrated_turn

UNKNOWNS = (
    "gyro_gain",
    "gyro_bias_rad_s",
    "gyro_delay_s",
    "gyro_drift",
    "path_gain",
    "turn_gain",
    "curvature_rad_m",
    "wheel_delay_s",
    "wheel_drift",
    "laser_x_m",
    "laser_y_m",
    "laser_yaw_rad",
)
"""Gains: true over reported. bias: of the turn rate, after the gain. delay: a stream's stamp less
the lidar's stamp of the same instant, at the middle of the drive. drift: its growth per second.
curvature: of the path of wheels that report a straight line. laser: pose in the base."""

(GYRO_GAIN, GYRO_BIAS, GYRO_DELAY, GYRO_DRIFT, PATH_GAIN, TURN_GAIN, CURVATURE) = range(7)
(WHEEL_DELAY, WHEEL_DRIFT, LASER_X, LASER_Y, LASER_YAW) = range(7, 12)

CLOCKS = ((GYRO_DELAY, GYRO_DRIFT), (WHEEL_DELAY, WHEEL_DRIFT))

GYRO_UNKNOWNS = slice(GYRO_GAIN, GYRO_DRIFT + 1)
WHEEL_UNKNOWNS = slice(PATH_GAIN, LASER_YAW + 1)
LASER = slice(LASER_X, LASER_YAW + 1)

PRIOR_SIGMAS = np.array([10.0, 1.0, 1.0, 0.01, 10.0, 10.0, 1.0, 1.0, 0.01, 2.0, 2.0, 3.0])
"""Prior standard deviations."""

SLIP_SIGMAS = np.array([0, 0, 0, 0, 3e-4, 1e-4, 0, 3e-4, 4e-6, 7e-4, 3e-4, 0])
"""Standard deviations that no data reduce, for wheels do not quite roll: tyres give when they push,
so that the robot turns at another instant, and about another point. Measured on the simulator's
robot."""

STEP = 1e-4
"""Of the differences that stand for derivatives."""

LEAST_TIME_STEP_S, TIME_STEP_PERIODS = 0.02, 2.0
"""Of differences in time: so far apart that the errors of a stream's own readings are others. A
slope that shares them with the residual would see a delay where nothing turns."""

LEVER_UNSURE = 1.0
"""Standard deviation of the lever of unequal wheels on a track that poses do not tell, a share: it
grows with the square of the track, and tracks to 0.65 m are usual."""

LEAST_ROLLED, MOST_ROLLED = 0.1, 0.95
"""Share of the usual error that is left in a step that hardly rolls: stamps scatter, tyres spring
back. Hardly: by that share of what this quantile of all steps rolls."""

ROWS = 4
"""Of a residual: laser's x, y, yaw by wheels less by scans, turn by gyroscope less by scans."""

AS_TIMED = np.zeros((2, 2))
"""No shift of (gyroscope, wheels) at the (first, second) scan of a pair."""


class Model:
    """Prediction of the steps of all pairs."""

    def __init__(
        self,
        steps: LaserSteps,
        gyro: IntegratedMotion | None,
        wheels: IntegratedMotion | None,
        middle_ns: int,
        shifts_ns: tuple[int, int],
    ) -> None:
        """shifts_ns: how much later the stamps of gyroscope and wheels are, roughly."""
        self.steps, self.gyro, self.wheels = steps, gyro, wheels
        self.middle_ns = middle_ns
        self.first_s = (steps.first_ns - middle_ns) * 1e-9
        self.second_s = (steps.second_ns - middle_ns) * 1e-9
        self._gyro_s = 0.0 if gyro is None else (middle_ns - gyro.origin_ns + shifts_ns[0]) * 1e-9
        self.free = self._free()
        self.trusted: BoolArray = np.ones(len(steps), dtype=np.bool_)
        """(n,) in which steps the wheels are believed at all."""
        self._wheel_s = (
            0.0 if wheels is None else (middle_ns - wheels.origin_ns + shifts_ns[1]) * 1e-9
        )

    @property
    def span_s(self) -> float:
        """From the first scan to the last."""
        return float(self.second_s.max() - self.first_s.min())

    def rolled_share(self) -> FloatArray:
        """(n,) how far the faster wheel rolls in each step, over the median of those that roll.

        By the wheels or by the scans, whichever tells more: the error of wheels that stopped while
        the robot drove on is as large as if they had rolled.
        """
        if self.wheels is None:
            return np.ones(len(self.steps))
        start_s, end_s = self._times(self._wheel_s, 0.0, 0.0)
        path_m, turn_rad = np.abs(self.wheels.at(end_s) - self.wheels.at(start_s)).T
        moved = np.abs(self.steps.T_first_second)
        held = np.diagonal(self.steps.information, axis1=1, axis2=2) > 0.0
        seen = np.where(held, moved, 0.0)
        path_m = np.maximum(path_m, np.hypot(seen[:, 0], seen[:, 1]))
        turn_rad = np.maximum(turn_rad, seen[:, 2])
        rolled_m = path_m + 0.5 * self.wheels.likely_track_m * turn_rad
        rolls = rolled_m > LEAST_ROLLED * np.quantile(rolled_m, MOST_ROLLED)
        if not rolls.any():
            return np.ones(len(self.steps))
        return np.asarray(np.maximum(rolled_m / np.median(rolled_m[rolls]), LEAST_ROLLED))

    def _free(self) -> BoolArray:
        """(p,) which unknowns to look for: without scans the wheels are the measure of all."""
        free = np.zeros(len(UNKNOWNS), dtype=np.bool_)
        free[GYRO_UNKNOWNS] = self.gyro is not None
        seen = bool(np.any(self.steps.information))
        free[WHEEL_UNKNOWNS] = self.wheels is not None and seen
        free[CURVATURE] = self.wheels is not None
        return free

    def covered(self, values: FloatArray) -> tuple[BoolArray, BoolArray]:
        """(n,) for which pairs there is a gyroscope, and wheels."""
        none = np.zeros(len(self.steps), dtype=np.bool_)
        return (
            none if self.gyro is None else self.gyro.covers(*self._gyro_times(values)),
            self.rolling(values) & self.trusted,
        )

    def rolling(self, values: FloatArray) -> BoolArray:
        """(n,) for which pairs there are wheels, trusted or not."""
        if self.wheels is None:
            return np.zeros(len(self.steps), dtype=np.bool_)
        return self.wheels.covers(*self._wheel_times(values))

    def predicted(
        self, values: FloatArray, shifts_s: FloatArray = AS_TIMED
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3) motion of the laser by the wheels and (n,) its turn by the gyroscope."""
        return self._by_wheels(values, shifts_s[1]), self._by_gyro(values, shifts_s[0])

    def reported(self, values: FloatArray) -> FloatArray:
        """(n, 2) path and turn as the wheels report them, of whatever size they are fitted."""
        if self.wheels is None:
            return np.zeros((len(self.steps), 2))
        start_s, end_s = self._wheel_times(values)
        return np.asarray(self.wheels.at(end_s) - self.wheels.at(start_s))

    def residual(self, values: FloatArray, shifts_s: FloatArray = AS_TIMED) -> FloatArray:
        """(n, 4)."""
        T_wheels, turned = self.predicted(values, shifts_s)
        matched = self.steps.T_first_second
        turn = wrap_angle(turned - matched[:, 2])
        return np.column_stack([between(matched, T_wheels), turn])

    def jacobian(self, values: FloatArray) -> FloatArray:
        """(n, 4, p) of the residual."""
        jacobian = np.zeros((len(self.steps), ROWS, len(UNKNOWNS)))
        clocks = np.ravel(CLOCKS)
        for unknown in np.flatnonzero(self.free):
            if unknown not in clocks:
                step = np.zeros(len(UNKNOWNS))
                step[unknown] = STEP * max(1.0, abs(values[unknown]))
                ahead, behind = self.residual(values + step), self.residual(values - step)
                jacobian[:, :, unknown] = _slope(behind, ahead, step[unknown])
        for stream, (delay, drift) in enumerate(CLOCKS):
            if self.free[delay]:
                by_first, by_second = self._slopes_in_time(values, stream)
                jacobian[:, :, delay] = by_first + by_second
                by_growth = self.first_s[:, None] * by_first + self.second_s[:, None] * by_second
                jacobian[:, :, drift] = by_growth
        return jacobian

    def aside(self, values: FloatArray) -> FloatArray:
        """(n,) how far poses lead to the left in each pair, whether that is believed or not."""
        if self.wheels is None or self.wheels.aside_m is None:
            return np.zeros(len(self.steps))
        sums = np.concatenate([[0.0], np.cumsum(self.wheels.aside_m)])
        start, end = (
            np.interp(times_s, self.wheels.times_s, sums) for times_s in self._wheel_times(values)
        )
        return np.asarray(values[PATH_GAIN] * np.sign(values[TURN_GAIN]) * (end - start))

    def _slopes_in_time(self, values: FloatArray, stream: int) -> tuple[FloatArray, FloatArray]:
        """(n, 4) twice: of the residual by the instants of one stream at both ends of a pair."""
        motion = (self.gyro, self.wheels)[stream]
        assert motion is not None
        step_s = max(LEAST_TIME_STEP_S, TIME_STEP_PERIODS * motion.period_s)
        slopes = []
        for end in range(2):
            shifts_s = np.zeros((2, 2))
            shifts_s[stream, end] = step_s
            ahead, behind = self.residual(values, shifts_s), self.residual(values, -shifts_s)
            slopes.append(_slope(behind, ahead, step_s))
        return slopes[0], slopes[1]

    def _gyro_times(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._times(self._gyro_s, values[GYRO_DELAY], values[GYRO_DRIFT])

    def _wheel_times(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._times(self._wheel_s, values[WHEEL_DELAY], values[WHEEL_DRIFT])

    def _times(self, shift_s: float, delay_s: float, drift: float) -> tuple[FloatArray, FloatArray]:
        start, end = self.first_s, self.second_s
        shift_s += delay_s
        return start + shift_s + drift * start, end + shift_s + drift * end

    def _by_gyro(self, values: FloatArray, shifts_s: FloatArray) -> FloatArray:
        if self.gyro is None:
            return np.zeros(len(self.steps))
        start, end = np.add(self._gyro_times(values), shifts_s[:, None])
        turned = (self.gyro.at(end) - self.gyro.at(start))[:, 0]
        return calibrated_turn(turned, end - start, values[GYRO_GAIN], values[GYRO_BIAS])

    def _by_wheels(self, values: FloatArray, shifts_s: FloatArray) -> FloatArray:
        if self.wheels is None:
            return np.zeros((len(self.steps), 3))
        times_s = np.add(self._wheel_times(values), shifts_s[:, None])
        inside = np.clip(times_s, 0.0, self.wheels.times_s[-1])
        rolled = rolled_poses(self.wheels, values)
        curve = smooth_curve(self.wheels.times_s, rolled)
        moved = between(curve(inside[0]), curve(inside[1]))
        T_base_laser = values[LASER]
        return compose(inverse(T_base_laser), compose(moved, T_base_laser))


def _slope(behind: FloatArray, ahead: FloatArray, step: float) -> FloatArray:
    """(n, 4) difference of residuals whose last two rows are angles, by the step either way."""
    apart = ahead - behind
    apart[:, 2:] = wrap_angle(apart[:, 2:])
    return np.asarray(apart / (2.0 * step))


def rolled_poses(wheels: IntegratedMotion, values: FloatArray) -> FloatArray:
    """(n, 3) of the base at each reading, yaw not wrapped, each interval driven as an arc."""
    steps = np.diff(calibrated_path(values, wheels, wheels.totals), axis=0)
    poses = poses_along(steps, np.zeros(3))
    if wheels.sideways_m is not None:
        to_left = poses[:-1, 2] + 0.5 * np.pi
        gain = values[PATH_GAIN] * np.sign(values[TURN_GAIN])  # mirrored, what is left is right
        aside = chord_of(gain * wheels.sideways_m, steps[:, 1], to_left)
        poses[1:, :2] += np.cumsum(np.column_stack(aside), axis=0)
    return poses


def calibrated_path(values: FloatArray, wheels: IntegratedMotion, totals: FloatArray) -> FloatArray:
    """(n, 2) path in m and turn in rad, of totals (n, 2) as the wheels' driver has them."""
    path_gain, turn_gain, curvature = values[[PATH_GAIN, TURN_GAIN, CURVATURE]].tolist()
    return calibrated_motion(totals, path_gain, turn_gain, curvature, wheels.lever_m2)
