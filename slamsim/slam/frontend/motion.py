"""What wheels and gyroscope report of the robot's motion, piece by piece."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from slamsim.core.geometry import wrap_angle
from slamsim.core.result import Calibrated
from slamsim.core.stamps import merged
from slamsim.core.types import BoolArray, FloatArray, ImuStream, IntArray, Log, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.models.differential_drive import (
    Reading,
    arcs_between,
    encoder_reading,
    pose_reading,
    wheel_odometry,
)
from slamsim.models.wheel_gyro import (
    GYRO_BIAS,
    GYRO_SCALE,
    PARAMETERS,
    ROWS,
    turn_at_samples,
    walk,
)
from slamsim.slam.frontend.preintegration import OdometryStep

GYRO_GAP_S = 0.1
AHEAD_S, AHEAD_FROM_S = 0.2, 0.05
"""So far beyond the last report the speed is taken to be that of the last moments."""

GAP_NS = 1_000_000_000
"""Reports farther apart than this do not tell how the robot went in between."""

REST_S, STAYS_S = 0.5, 0.1
"""A robot rests that has not moved for so long, and does not set off before a moment later."""

REST_RANGE_M = (3e-4, 1e-3)
REST_RANGE_RAD = (1e-3, 4e-3)
REST_READINGS = 2.5
REST_TURN_RAD_S = 4e-3
"""A standing robot's gyroscope shows its bias, give or take this and its own uncertainty."""

REST_BIAS_SIGMAS = 4.0
"""Of the noise of a gyroscope: by chance one reading in 16,000 is farther off."""
FORWARD, SIDEWAYS, WHEEL_TURN, GYRO_TURN = range(4)


class NoMotion(SlamsimError):
    """A log that says nothing about how the robot moved."""


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """The motion between consecutive stamps as reported, uncalibrated.

    stamps_ns: (n,) increasing. steps: (n - 1, 4) forward and sideways along the arc in metres,
    turn by the wheels and turn by the gyroscope in radians, nan while that is silent.
    """

    stamps_ns: IntArray
    steps: FloatArray


class Odometry:
    """Wheels and gyroscope of one robot: what they say about any stretch of time they cover.

    reading: resolution and track of the wheels.
    """

    def __init__(self, increments: Increments, reading: Reading) -> None:
        self._stamps_ns, self._steps = increments.stamps_ns, increments.steps
        self.reading = reading

    @property
    def stamps_ns(self) -> IntArray:
        """(n,) the instants at which something was reported."""
        return self._stamps_ns

    @property
    def has_gyro(self) -> bool:
        """Whether a gyroscope reports at all."""
        return bool(np.isfinite(self._steps[:, GYRO_TURN]).any())

    def extend(self, increments: Increments) -> None:
        """More of the same; it begins where the last ended. Raises SlamsimError if not."""
        if increments.stamps_ns[0] != self._stamps_ns[-1]:
            raise SlamsimError(
                f"odometry that ends at {self._stamps_ns[-1]} ns "
                f"cannot go on at {increments.stamps_ns[0]} ns"
            )
        self._stamps_ns = np.concatenate([self._stamps_ns, increments.stamps_ns[1:]])
        self._steps = np.concatenate([self._steps, increments.steps])

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what no later question needs: all but the rest-seeking span before the stamp."""
        needed_ns = stamp_ns - round(REST_S * 1e9)
        first = max(int(np.searchsorted(self._stamps_ns, needed_ns, side="right")) - 1, 0)
        self._stamps_ns, self._steps = self._stamps_ns[first:], self._steps[first:]

    def covers(self, first_ns: int, last_ns: int) -> bool:
        """Whether both ends were reported on, or the stretch ends a moment after the last report.

        A stretch across a gap is covered, for the poses before and after it tell of all of it; one
        that begins or ends within a gap is not.
        """
        ahead_ns = round(AHEAD_S * 1e9)
        inside = first_ns >= self._stamps_ns[0] and last_ns <= self._stamps_ns[-1] + ahead_ns
        return bool(inside and not self._silent_at(first_ns) and not self._silent_at(last_ns))

    def _silent_at(self, stamp_ns: int) -> bool:
        """Whether an instant lies well within a gap of the reports."""
        after = int(np.searchsorted(self._stamps_ns, stamp_ns, side="right"))
        if not 0 < after < self._stamps_ns.size:
            return False
        before_ns, after_ns = int(self._stamps_ns[after - 1]), int(self._stamps_ns[after])
        return after_ns - before_ns > GAP_NS and before_ns + AHEAD_S * 1e9 < stamp_ns < after_ns

    def step(
        self, first_ns: int, last_ns: int, parameters: FloatArray, bias_sigma_rad_s: float = 0.0
    ) -> OdometryStep:
        """The motion over a stretch that is covered; none at all while the robot rests.

        parameters: (PARAMETERS,).
        """
        _, poses, jacobian, totals = self._walk(first_ns, last_ns, parameters)
        seconds = (last_ns - first_ns) * 1e-9
        raw_turn_rad, gyro_s = float(totals[3]), float(totals[4])
        still = self._rests(first_ns, last_ns, parameters[-1], bias_sigma_rad_s)
        if still:
            none = OdometryStep.none(parameters)
            return replace(
                none,
                seconds=seconds,
                gyro_s=gyro_s,
                rest_s=gyro_s,
                rest_turn_rad=raw_turn_rad,
                reading_m=self.reading.sigma_m,
                reading_rad=self.reading.sigma_rad,
            )
        return OdometryStep(
            T_first_last=np.append(poses[-1, :2], wrap_angle(poses[-1, 2])),
            wheel_turn_rad=float(totals[0]),
            parameters=parameters,
            jacobian=jacobian,
            seconds=seconds,
            path_m=float(totals[1]),
            turned_rad=float(totals[2]),
            gyro_s=gyro_s,
            rest_s=0.0,
            rest_turn_rad=0.0,
            reading_m=self.reading.sigma_m,
            reading_rad=self.reading.sigma_rad,
            doubt=np.zeros(3),
        )

    def path(self, first_ns: int, last_ns: int, parameters: FloatArray) -> PlanarTrajectory:
        """The motion over a stretch that is covered, from the origin, at all stamps within.

        parameters: (PARAMETERS,).
        """
        last_ns = max(last_ns, first_ns + 1)
        stamps_ns, poses, _, _ = self._walk(first_ns, last_ns, parameters)
        # A stretch that begins where a piece ends touches that piece, but has none of it.
        inner = (stamps_ns[1:-1] > first_ns) & (stamps_ns[1:-1] < last_ns)
        within = np.concatenate([[first_ns], stamps_ns[1:-1][inner], [last_ns]])
        return PlanarTrajectory(within, poses[np.concatenate([[True], inner, [True]])])

    def _walk(
        self, first_ns: int, last_ns: int, parameters: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Stamps and poses of the pieces that a stretch touches; see ``walk`` for the rest."""
        low, high = self._pieces(first_ns, last_ns)
        stamps_ns, steps = self._stamps_ns[low : high + 1], self._steps[low:high]
        if last_ns > self._stamps_ns[-1]:
            stamps_ns = np.append(stamps_ns, last_ns)
            steps = np.vstack([steps, self._ahead(last_ns)])
        poses, jacobian = np.zeros((len(stamps_ns), 3)), np.zeros((ROWS, PARAMETERS))
        totals = np.zeros(5)
        lever_m2 = self.reading.lever_m2
        walk(stamps_ns, steps, first_ns, last_ns, parameters, lever_m2, poses, jacobian, totals)
        return stamps_ns, poses, jacobian, totals

    def _ahead(self, last_ns: int) -> FloatArray:
        """(4,) the step from the last report to a moment later."""
        end_ns = int(self._stamps_ns[-1])
        low, high = self._pieces(end_ns - round(AHEAD_FROM_S * 1e9), end_ns)
        span_ns = end_ns - int(self._stamps_ns[low])
        ahead: FloatArray = self._steps[low:high].sum(axis=0) * ((last_ns - end_ns) / span_ns)
        return ahead

    def _pieces(self, first_ns: int, last_ns: int) -> tuple[int, int]:
        """The reported pieces, low up to and without high, that a stretch touches."""
        low = int(np.searchsorted(self._stamps_ns, first_ns, side="right")) - 1
        high = int(np.searchsorted(self._stamps_ns, last_ns, side="left"))
        low = min(max(low, 0), len(self._steps) - 1)
        return low, min(max(high, low + 1), len(self._steps))

    def _rests(self, first_ns: int, last_ns: int, bias_rad_s: float, sigma_rad_s: float) -> bool:
        """Whether wheels and gyroscope have been still for a while, and stay so for a moment."""
        begin_ns, end_ns = self._stamps_ns[[0, -1]].tolist()
        rest_ns = round(REST_S * 1e9)
        since_ns = max(min(first_ns, last_ns - rest_ns), begin_ns)
        until_ns = max(last_ns, min(last_ns + round(STAYS_S * 1e9), end_ns), since_ns + rest_ns)
        if last_ns <= first_ns or first_ns < begin_ns or until_ns > max(end_ns, last_ns):
            return False
        low, high = self._pieces(since_ns, until_ns)
        steps = self._steps[low:high]
        within = np.abs(np.cumsum(steps[:, :GYRO_TURN], axis=0)).max(axis=0)
        least_m = np.clip(REST_READINGS * self.reading.step_m, *REST_RANGE_M)
        least_rad = np.clip(REST_READINGS * self.reading.step_rad, *REST_RANGE_RAD)
        if max(within[FORWARD], within[SIDEWAYS]) > least_m or within[WHEEL_TURN] > least_rad:
            return False
        gyro = steps[:, GYRO_TURN]
        heard = np.isfinite(gyro)
        seconds = float((np.diff(self._stamps_ns[low : high + 1])[heard]).sum()) * 1e-9
        allowed_rad_s = REST_TURN_RAD_S + REST_BIAS_SIGMAS * sigma_rad_s
        excess_rad = abs(float(gyro[heard].sum()) - bias_rad_s * seconds)
        return excess_rad <= allowed_rad_s * seconds


def log_odometry(log: Log) -> Odometry:
    """Wheels and gyroscope of a log; encoders are preferred to an odometry derived from them.

    Raises NoMotion for a log with neither odometry nor encoders.
    """
    if log.encoders is not None:
        wheels, reading = wheel_odometry(log.encoders), encoder_reading(log.encoders)
    elif log.odometry is not None:
        wheels, reading = log.odometry, pose_reading(log.odometry)
    else:
        raise NoMotion(f"{log.name}: neither odometry nor wheel encoders in the log")
    if len(wheels) < 2:
        raise NoMotion(f"{log.name}: less than two readings of the wheels in the log")
    if log.imu is None or len(log.imu.stamps_ns) < 2:
        return Odometry(increments(wheels), reading)
    rotation = np.eye(3) if log.T_base_imu is None else log.T_base_imu[:3, :3]
    return Odometry(increments(wheels, log.imu, rotation), reading)


def predict_motion(
    log: Log, calibration: Mapping[str, Calibrated] = MappingProxyType({})
) -> PlanarTrajectory:
    """``T_odom_base`` by wheels as they are and a gyroscope less its known errors.

    Good for the moments between two scans. Raises NoMotion.
    """
    odometry = log_odometry(log)
    first_ns, last_ns = odometry.stamps_ns[[0, -1]].tolist()
    known = np.zeros(PARAMETERS)
    if "gyro_bias_rad_s" in calibration:
        known[GYRO_BIAS] = calibration["gyro_bias_rad_s"].value
        known[GYRO_SCALE] = calibration["gyro_scale"].value - 1.0
    return odometry.path(first_ns, last_ns, known)


def increments(
    wheels: PlanarTrajectory,
    imu: ImuStream | None = None,
    rotation_base_imu: FloatArray | None = None,
) -> Increments:
    """Wheels and gyroscope on common stamps: every one of either that the wheels cover.

    Within a wheel interval the body's velocity is constant (an arc). rotation_base_imu: (3, 3).
    """
    velocity = arcs_between(wheels.poses) / (np.diff(wheels.stamps_ns)[:, None] * 1e-9)
    if imu is None:
        seconds = np.diff(wheels.stamps_ns)[:, None] * 1e-9
        silent = np.full((len(velocity), 1), np.nan)
        return Increments(wheels.stamps_ns, np.hstack([velocity * seconds, silent]))
    stamps_ns = merged(wheels.stamps_ns, imu.stamps_ns)
    inside = (stamps_ns >= wheels.stamps_ns[0]) & (stamps_ns <= wheels.stamps_ns[-1])
    stamps_ns = stamps_ns[inside]
    interval = np.searchsorted(wheels.stamps_ns, stamps_ns[:-1], side="right") - 1
    driven = velocity[interval] * (np.diff(stamps_ns)[:, None] * 1e-9)

    axis = np.array([0.0, 0.0, 1.0]) if rotation_base_imu is None else rotation_base_imu[2]
    gyro_yaw = turn_at_samples(imu.stamps_ns, imu.angular_velocity_rad_s @ axis)
    origin_ns = imu.stamps_ns[0]
    yaw_at = np.interp((stamps_ns - origin_ns) * 1e-9, (imu.stamps_ns - origin_ns) * 1e-9, gyro_yaw)
    turned = np.where(_gyro_covers(imu.stamps_ns, stamps_ns), np.diff(yaw_at), np.nan)
    return Increments(stamps_ns, np.column_stack([driven, turned]))


def _gyro_covers(imu_ns: IntArray, stamps_ns: IntArray) -> BoolArray:
    """(m - 1,) whether the gyroscope reported all through each interval of the stamps."""
    after = np.searchsorted(imu_ns, stamps_ns[1:], side="left")
    inside = (stamps_ns[:-1] >= imu_ns[0]) & (stamps_ns[1:] <= imu_ns[-1])
    after = np.clip(after, 1, imu_ns.size - 1)
    gap_s = (imu_ns[after] - imu_ns[after - 1]) * 1e-9
    return np.asarray(inside & (gap_s <= GYRO_GAP_S))
