"""Which of laser, wheels and gyroscope turns the other way than the robot does.

A laser or an inertial unit hangs upside down, and the transform to it does not say so; the sides of
wheels are exchanged, or odometry has the axes of a body that looks down. A gyroscope that turns the
wrong way tears a map in the first turn; a lidar makes its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.types import FloatArray, Log

LEAST_TURNED_RAD, LEAST_STRETCHES = 1.5, 6
"""Less turning than that of a corner or two shows no sign for sure."""

LEAST_ALIKE, GAINS = 0.9, (0.5, 2.0)
"""Correlation of the turns of two sensors, and the slope of one over the other's, from which on
they are turns of one motion. In 40 recordings of six robots and simulators that turned enough,
wheels kept to 0.92 and more, with slopes of 0.97 to 1.17, and gyroscopes to 1.00; a robot that was
shoved round fell to 0.56 and shows no sign."""

UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
"""4 x 4, rolled by half a turn."""


@dataclass(frozen=True, slots=True)
class Reversed:
    """Which parts of a robot turn the other way; none if all turn alike, or nothing shows it."""

    laser: bool = False
    wheels: bool = False
    gyro: bool = False

    def applied(self, log: Log) -> Log:
        """The log with wheels and gyroscope that turn as its laser does."""
        odometry, encoders, T_base_imu = log.odometry, log.encoders, log.T_base_imu
        told = []
        if self.wheels:
            told.append(_WHEELS)
            if encoders is not None:  # then the odometry was not looked at
                encoders = replace(encoders, ticks=np.ascontiguousarray(encoders.ticks[:, ::-1]))
            elif odometry is not None:
                odometry = replace(odometry, poses=odometry.poses * [1.0, -1.0, -1.0])
        if self.gyro:
            told.append(_GYRO)
            T_base_imu = (np.eye(4) if T_base_imu is None else T_base_imu).copy()
            T_base_imu[:3, :3] = UPSIDE_DOWN[:3, :3] @ T_base_imu[:3, :3]
        return replace(
            log,
            odometry=odometry,
            encoders=encoders,
            T_base_imu=T_base_imu,
            warnings=(*told, *log.warnings),
        )


NONE_REVERSED = Reversed()


def reversed_parts(turns_rad: FloatArray) -> Reversed:
    """What the turns (n, 3) of laser, wheels and gyroscope in the same stretches say, those of the
    gyroscope nan where it is silent: two of three are believed. Of two none is, for the map of a
    robot with mirrored wheels would become a mirror image."""
    heard = np.isfinite(turns_rad[:, 2])
    by_wheels, by_gyro = _sign(turns_rad[:, [0, 1]]), _sign(turns_rad[heard][:, [0, 2]])
    return Reversed(
        laser=by_wheels < 0 and by_gyro < 0,
        wheels=by_wheels < 0 < by_gyro,
        gyro=by_gyro < 0 < by_wheels,
    )


def _sign(turns_rad: FloatArray) -> int:
    """1 or -1 if two sensors, (n, 2), plainly turn alike or against each other, else 0."""
    squares = turns_rad.T @ turns_rad
    if len(turns_rad) < LEAST_STRETCHES or np.abs(turns_rad[:, 0]).sum() < LEAST_TURNED_RAD:
        return 0
    (ones, both), (_, others) = squares.tolist()
    low, high = GAINS
    alike = abs(both) >= LEAST_ALIKE * np.sqrt(ones * others)
    return int(np.sign(both)) if alike and low <= abs(both) / ones <= high else 0


_WHEELS = (
    "the wheels turn against scans and gyroscope: their sides are exchanged, or y points to the "
    "right; corrected"
)
_GYRO = (
    "the gyroscope turns against scans and wheels: it is mounted upside down, and the transform to "
    "it does not say so; corrected"
)
