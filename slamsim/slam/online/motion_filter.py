"""Wheels and gyroscope as they arrive: nothing is looked up that is not there yet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.core.types import EncoderStream, FloatArray, ImuStream, IntArray, PlanarTrajectory
from slamsim.models.differential_drive import Reading, encoder_reading, pose_reading, wheel_odometry
from slamsim.slam.frontend.motion import GYRO_GAP_S, Odometry, increments
from slamsim.slam.online.samples import MotionSamples

KEPT_NS = 3_000_000_000
_NEVER = int(np.iinfo(np.int64).min)


class MotionFilter:
    """A ``MotionSource`` that grows, and forgets what is older than some seconds.

    rotation_base_imu: (3, 3) of the gyroscope's mount, None for a robot without one. An interval of
    the wheels is taken in as soon as the gyroscope has covered it, or is late.
    """

    def __init__(self, rotation_base_imu: FloatArray | None) -> None:
        self._rotation = rotation_base_imu
        self._wheels = PlanarTrajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
        self._imu = ImuStream(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
        self._last_ticks: IntArray | None = None
        self._reading: Reading | None = None
        self._odometry: Odometry | None = None

    def add(self, samples: MotionSamples) -> None:
        """See ``MotionSource``. Samples that are not later than those before are left out."""
        if samples.imu is not None and self._rotation is not None:
            self._add_imu(samples.imu)
        if samples.encoders is not None and len(samples.encoders.stamps_ns):
            self._reading = encoder_reading(samples.encoders)
            self._add_wheels(self._rolled(samples.encoders))
        elif samples.odometry is not None and len(samples.odometry):
            self._add_wheels(samples.odometry)
            if self._last_ticks is None:
                self._reading = pose_reading(self._wheels)
        self._extend()

    def until(self, stamp_ns: int) -> Odometry | None:
        """See ``MotionSource``."""
        return self._odometry

    def _add_imu(self, imu: ImuStream) -> None:
        new = imu.stamps_ns > (self._imu.stamps_ns[-1] if len(self._imu.stamps_ns) else _NEVER)
        self._imu = ImuStream.joined([self._imu, imu.select(new)])

    def _rolled(self, encoders: EncoderStream) -> PlanarTrajectory:
        """Wheel odometry from the last reading before these on."""
        start = self._wheels.poses[-1] if len(self._wheels) else None
        stamps_ns, ticks = encoders.stamps_ns, encoders.ticks
        if self._last_ticks is not None:
            stamps_ns = np.append(self._wheels.stamps_ns[-1], stamps_ns)
            ticks = np.vstack([self._last_ticks, ticks])
        self._last_ticks = ticks[-1]
        return wheel_odometry(replace(encoders, stamps_ns=stamps_ns, ticks=ticks), start)

    def _add_wheels(self, wheels: PlanarTrajectory) -> None:
        new = wheels.stamps_ns > (self._wheels.stamps_ns[-1] if len(self._wheels) else _NEVER)
        self._wheels = PlanarTrajectory.joined([self._wheels, wheels.select(new)])

    def _extend(self) -> None:
        """Take in the intervals of the wheels that the gyroscope has covered, or will not cover."""
        stamps_ns = self._wheels.stamps_ns
        if not len(stamps_ns) or self._reading is None:
            return
        newest_ns = int(stamps_ns[-1])
        if self._rotation is not None and len(self._imu.stamps_ns):
            late_ns = newest_ns - round(GYRO_GAP_S * 1e9)
            newest_ns = max(int(self._imu.stamps_ns[-1]), late_ns)
        begun_ns = stamps_ns[0] if self._odometry is None else self._odometry.stamps_ns[-1]
        ready = (stamps_ns >= begun_ns) & (stamps_ns <= newest_ns)
        if np.count_nonzero(ready) < 2:
            return
        wheels = self._wheels.select(ready)
        heard = self._rotation is not None and len(self._imu.stamps_ns) >= 2
        more = increments(wheels, self._imu if heard else None, self._rotation)
        if self._odometry is None:
            self._odometry = Odometry(more, self._reading)
        else:
            self._odometry.extend(more)
        self._forget(newest_ns - KEPT_NS)

    def _forget(self, oldest_ns: int) -> None:
        if self._odometry is not None:
            self._odometry.forget_before(oldest_ns)
        self._wheels = self._wheels.select(self._wheels.stamps_ns >= oldest_ns)
        self._imu = self._imu.select(self._imu.stamps_ns >= oldest_ns)
