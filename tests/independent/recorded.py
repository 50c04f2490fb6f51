"""What a recording holds, as arrays that are easily changed; ``writer.py`` makes messages of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from independent.rays import Floats

Stamps = NDArray[np.int64]
"""Nanoseconds."""


@dataclass
class Messages:
    """Any stream. stamps_ns: of the header. received_ns: when the recorder got the message."""

    topic: str
    frame: str
    stamps_ns: Stamps
    received_ns: Stamps

    def take(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> None:
        """Keep only these messages, in this order; what belongs to a message goes with it."""
        count = len(self.stamps_ns)
        for name, value in list(vars(self).items()):
            if isinstance(value, np.ndarray) and len(value) == count:
                setattr(self, name, value[which])


@dataclass
class Scans(Messages):
    """ranges_m: (n, beams). intensities: (n, any)."""

    ranges_m: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    intensities: NDArray[np.float32]
    angle_max: float = np.nan

    def __post_init__(self) -> None:
        if np.isnan(self.angle_max):
            self.angle_max = self.angle_min + self.angle_increment * (self.ranges_m.shape[1] - 1)


@dataclass
class Odometry(Messages):
    """xy_m (n, 2). quaternion (n, 4): x, y, z, w. linear, angular (n, 3): the twist."""

    child: str
    xy_m: Floats
    quaternion: Floats
    linear: Floats
    angular: Floats


@dataclass
class Imu(Messages):
    """quaternion: (n, 4), None where the sensor gives none."""

    gyro: Floats
    acceleration: Floats
    quaternion: Floats | None


@dataclass
class Edge(Messages):
    """One transform, from parent (``frame``) to child. translation (n, 3), quaternion (n, 4)."""

    child: str
    translation: Floats
    quaternion: Floats
    static: bool = False


@dataclass
class Bag:
    """Everything that was recorded."""

    scans: list[Scans] = field(default_factory=list)
    odometry: list[Odometry] = field(default_factory=list)
    imu: list[Imu] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)

    def streams(self) -> list[Messages]:
        return [*self.scans, *self.odometry, *self.imu, *self.edges]

    def edge(self, child: str) -> Edge:
        return next(each for each in self.edges if each.child == child)


def yaw_quaternion(yaw: Floats) -> Floats:
    """(n, 4) of rotations about z by yaw (n,)."""
    none = np.zeros_like(yaw)
    return np.column_stack([none, none, np.sin(yaw / 2), np.cos(yaw / 2)])


def yaw_of(quaternion: Floats) -> Floats:
    """Of rotations about z (n, 4), not wrapped."""
    return np.unwrap(2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3]))


def rpy_quaternion(roll: float, pitch: float, yaw: float) -> Floats:
    """x, y, z, w of Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a / 2), np.cos(a / 2)) for a in (roll, pitch, yaw))
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def after(quaternions: Floats, turn: Floats) -> Floats:
    """(n, 4) of rotations (n, 4), each after a turn (4,) in the turned frame; x, y, z, w."""
    (x, y, z, w), (a, b, c, d) = quaternions.T, turn
    return np.column_stack(
        [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ]
    )


def rpy_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)
