"""Wheels and gyroscope fused as they arrive: nothing is looked up that is not there yet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.geometry import between, compose, wrap_angle
from slamsim.slam.motion import (
    GYRO_GAP_S,
    STANDSTILL_MARGIN_S,
    STANDSTILL_MIN_S,
    STANDSTILL_SPEED_M_S,
    STANDSTILL_TURN_RAD_S,
    STRAIGHT_TURN_RAD_S,
)
from slamsim.slam.online.samples import MotionSamples
from slamsim.types import EncoderStream, FloatArray, ImuStream, IntArray, PlanarTrajectory
from slamsim.wheels import wheel_odometry

KEPT_NS = 3_000_000_000
AHEAD_NS = 200_000_000
"""So far beyond the last sample the speed is taken as constant."""

LEAST_GAIN = 0.002


class MotionFilter:
    """A ``MotionSource``: the path of the wheels with the heading of the gyroscope.

    The gyroscope's bias is its mean at the last standstill; before the first one, its mean
    difference to the wheels while driving straight. rotation_base_imu: (3, 3) of the gyroscope's
    mount, None for a robot without one. Memory is that of the last seconds.
    """

    def __init__(self, rotation_base_imu: FloatArray | None) -> None:
        self._axis = None if rotation_base_imu is None else rotation_base_imu[2]
        self._wheels = PlanarTrajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
        self._last_ticks: IntArray | None = None
        self._imu_ns: IntArray = np.zeros(0, np.int64)
        self._rate: FloatArray = np.zeros(0)
        self._path = PlanarTrajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
        self._bias = 0.0
        self._straight = 0
        self._still_since_ns: int | None = None
        self._rested = False

    def add(self, samples: MotionSamples) -> None:
        """See ``MotionSource``. Samples that are not later than those before are left out."""
        if samples.imu is not None and self._axis is not None:
            self._add_imu(samples.imu, self._axis)
        if samples.encoders is not None:
            self._add_wheels(self._rolled(samples.encoders))
        elif samples.odometry is not None:
            self._add_wheels(samples.odometry)
        self._extend()
        self._forget()

    def until(self, stamp_ns: int) -> PlanarTrajectory | None:
        """See ``MotionSource``; constant speed for a short while beyond the last sample."""
        if len(self._path) < 2 or stamp_ns > self._path.stamps_ns[-1] + AHEAD_NS:
            return None
        if stamp_ns <= self._path.stamps_ns[-1]:
            return self._path
        span_ns = self._path.stamps_ns[-1] - self._path.stamps_ns[-2]
        share = float(stamp_ns - self._path.stamps_ns[-1]) / float(span_ns)
        step = between(self._path.poses[-2], self._path.poses[-1]) * share
        ahead = compose(self._path.poses[-1], step)
        return PlanarTrajectory(
            np.append(self._path.stamps_ns, stamp_ns), np.vstack([self._path.poses, ahead])
        )

    def _add_imu(self, imu: ImuStream, axis: FloatArray) -> None:
        newest = int(self._imu_ns[-1]) if len(self._imu_ns) else np.iinfo(np.int64).min
        new = imu.stamps_ns > newest
        self._imu_ns = np.concatenate([self._imu_ns, imu.stamps_ns[new]])
        self._rate = np.concatenate([self._rate, imu.angular_velocity_rad_s[new] @ axis])

    def _rolled(self, encoders: EncoderStream) -> PlanarTrajectory:
        """Wheel odometry from the last reading before these on."""
        start = self._wheels.poses[-1] if len(self._wheels) else None
        stamps_ns, ticks = encoders.stamps_ns, encoders.ticks
        if self._last_ticks is not None:
            stamps_ns = np.append(self._wheels.stamps_ns[-1], stamps_ns)
            ticks = np.vstack([self._last_ticks, ticks])
        if len(ticks):
            self._last_ticks = ticks[-1]
        return wheel_odometry(replace(encoders, stamps_ns=stamps_ns, ticks=ticks), start)

    def _add_wheels(self, wheels: PlanarTrajectory) -> None:
        newest = int(self._wheels.stamps_ns[-1]) if len(self._wheels) else np.iinfo(np.int64).min
        new = wheels.stamps_ns > newest
        self._wheels = _joined(self._wheels, wheels.stamps_ns[new], wheels.poses[new])

    def _extend(self) -> None:
        """Fuse each interval of the wheels that the gyroscope has covered, or will not cover."""
        stamps_ns = self._wheels.stamps_ns
        if not len(stamps_ns):
            return
        first = int(np.searchsorted(stamps_ns, self._path.stamps_ns[-1])) if len(self._path) else 0
        seen_ns = int(self._imu_ns[-1]) if len(self._imu_ns) else int(stamps_ns[-1])
        late_ns = int(stamps_ns[-1]) - round(GYRO_GAP_S * 1e9)
        for k in range(first, len(stamps_ns) - 1):
            if stamps_ns[k + 1] > max(seen_ns, late_ns):
                return
            self._advance(k)

    def _advance(self, k: int) -> None:
        """One interval of the wheels: an arc at constant speed, turned as the gyroscope turned."""
        first_ns, last_ns = self._wheels.stamps_ns[k : k + 2].tolist()
        step = between(self._wheels.poses[k], self._wheels.poses[k + 1])
        seconds = (last_ns - first_ns) * 1e-9
        gyro = self._gyro_over(first_ns, last_ns)
        if gyro is not None:
            self._learn_bias(step, gyro, first_ns, last_ns)
        stamps_ns = np.array([first_ns, last_ns])
        turned = np.array([0.0, step[2]])
        if gyro is not None:
            inside = (self._imu_ns > first_ns) & (self._imu_ns < last_ns)
            stamps_ns = np.concatenate([[first_ns], self._imu_ns[inside], [last_ns]])
            rate = np.interp(stamps_ns - first_ns, self._imu_ns - first_ns, self._rate) - self._bias
            steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(stamps_ns) * 1e-9
            turned = np.append(0.0, np.cumsum(steps))
        if not len(self._path):
            self._path = PlanarTrajectory(stamps_ns[:1], self._wheels.poses[k : k + 1])
        poses = _arc(self._path.poses[-1], step, (stamps_ns - first_ns) * 1e-9 / seconds, turned)
        self._path = _joined(self._path, stamps_ns[1:], poses)

    def _gyro_over(self, first_ns: int, last_ns: int) -> FloatArray | None:
        """Turn rates in an interval, its neighbours included; None where it has a gap."""
        low = int(np.searchsorted(self._imu_ns, first_ns, side="right")) - 1
        high = int(np.searchsorted(self._imu_ns, last_ns, side="left"))
        if low < 0 or high >= len(self._imu_ns):
            return None
        gaps_s = np.diff(self._imu_ns[low : high + 1]) * 1e-9
        return self._rate[low : high + 1] if (gaps_s <= GYRO_GAP_S).all() else None

    def _learn_bias(self, step: FloatArray, gyro: FloatArray, first_ns: int, last_ns: int) -> None:
        seconds = (last_ns - first_ns) * 1e-9
        speed, turn = float(np.hypot(step[0], step[1])) / seconds, float(step[2]) / seconds
        if speed >= STANDSTILL_SPEED_M_S or abs(turn) >= STANDSTILL_TURN_RAD_S:
            self._still_since_ns = None
            if not self._rested and abs(turn) < STRAIGHT_TURN_RAD_S:
                self._straight += 1
                gain = max(1.0 / self._straight, LEAST_GAIN)
                self._bias += gain * (float(gyro.mean()) - turn - self._bias)
            return
        if self._still_since_ns is None:
            self._still_since_ns = first_ns
        margin_ns = round(STANDSTILL_MARGIN_S * 1e9)
        begun, ended = self._still_since_ns + margin_ns, last_ns - margin_ns
        if ended - begun >= STANDSTILL_MIN_S * 1e9:
            resting = self._rate[(self._imu_ns >= begun) & (self._imu_ns <= ended)]
            if len(resting) >= 5:
                self._bias, self._rested = float(resting.mean()), True

    def _forget(self) -> None:
        """Drop what is older than the last seconds of the wheels."""
        if not len(self._wheels):
            return
        oldest = int(self._wheels.stamps_ns[-1]) - KEPT_NS
        first = int(np.searchsorted(self._imu_ns, oldest))
        self._imu_ns, self._rate = self._imu_ns[first:], self._rate[first:]
        self._wheels, self._path = _since(self._wheels, oldest), _since(self._path, oldest)


def _arc(start: FloatArray, step: FloatArray, share: FloatArray, turned: FloatArray) -> FloatArray:
    """(n - 1, 3) poses along a step at constant body velocity, with headings of its own.

    share: (n,) of the step's time, from 0 to 1. turned: (n,) heading since its start.
    """
    half = 0.5 * float(step[2])
    stretch = 1.0 / np.sinc(half / np.pi)
    cos, sin = np.cos(half), np.sin(half)
    along = (cos * step[0] + sin * step[1]) * stretch * np.diff(share)
    across = (-sin * step[0] + cos * step[1]) * stretch * np.diff(share)
    middle = start[2] + 0.5 * (turned[1:] + turned[:-1])
    x = start[0] + np.cumsum(along * np.cos(middle) - across * np.sin(middle))
    y = start[1] + np.cumsum(along * np.sin(middle) + across * np.cos(middle))
    return np.column_stack([x, y, wrap_angle(start[2] + turned[1:])])


def _joined(path: PlanarTrajectory, stamps_ns: IntArray, poses: FloatArray) -> PlanarTrajectory:
    return PlanarTrajectory(
        np.concatenate([path.stamps_ns, stamps_ns]), np.vstack([path.poses, poses])
    )


def _since(path: PlanarTrajectory, oldest_ns: int) -> PlanarTrajectory:
    first = int(np.searchsorted(path.stamps_ns, oldest_ns))
    return PlanarTrajectory(path.stamps_ns[first:], path.poses[first:])
