"""The odometry of a recording, taken apart into steps and put together again."""

from __future__ import annotations

import numpy as np

from independent.fault import Made
from independent.recorded import Edge, Odometry, yaw_of, yaw_quaternion
from independent.sensors import BEGIN_NS


def odometry_in(made: Made) -> Odometry:
    return made.bag.odometry[0]


def edge_in(made: Made) -> Edge:
    return made.bag.edge(odometry_in(made).child)


def publish(made: Made, xy_m: np.ndarray, yaw: np.ndarray) -> None:
    """These poses as odometry and transform; the twist stays."""
    odometry = odometry_in(made)
    odometry.xy_m, odometry.quaternion = xy_m, yaw_quaternion(yaw)
    edge = edge_in(made)
    edge.translation = np.column_stack([xy_m, np.zeros(len(xy_m))])
    edge.quaternion = odometry.quaternion.copy()


def instants(made: Made) -> np.ndarray:
    return (odometry_in(made).stamps_ns - BEGIN_NS) * 1e-9


def integrated_anew(made: Made, forward: np.ndarray, turned: np.ndarray) -> None:
    """Poses from steps (n,) each, in m and rad; the twist follows."""
    odometry = odometry_in(made)
    yaw = np.cumsum(turned)
    middle = yaw - 0.5 * turned
    along = np.column_stack([np.cos(middle), np.sin(middle)]) * forward[:, None]
    publish(made, np.cumsum(along, axis=0), yaw)
    odometry.linear[:, 0] = forward * made.robot.odometry_hz
    odometry.angular[:, 2] = turned * made.robot.odometry_hz


def steps_in(made: Made) -> tuple[np.ndarray, np.ndarray]:
    """Forward and turned since the message before."""
    odometry = odometry_in(made)
    yaw = yaw_of(odometry.quaternion)
    turned = np.diff(yaw, prepend=yaw[0])
    moved = np.diff(odometry.xy_m, axis=0, prepend=odometry.xy_m[:1])
    middle = yaw - 0.5 * turned
    return moved[:, 0] * np.cos(middle) + moved[:, 1] * np.sin(middle), turned
