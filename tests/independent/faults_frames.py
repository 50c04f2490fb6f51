"""Faults of frames and transforms."""

from __future__ import annotations

from copy import deepcopy
from functools import partial

import numpy as np

from independent.fault import Fault, Made, fault
from independent.recorded import Edge, yaw_of, yaw_quaternion
from independent.sensors import BEGIN_NS, fixed_edge


def _moving(made: Made) -> Edge:
    return made.bag.edge(made.bag.odometry[0].child)


def _scan_frame(made: Made, frame: str) -> None:
    made.bag.scans[0].frame = frame


def _imu_frame(made: Made) -> None:
    made.bag.imu[0].frame = "imu"


def _odometry_child(made: Made, child: str) -> None:
    made.bag.odometry[0].child = child


def _odometry_of_base(made: Made) -> None:
    """Odometry and transform speak of a frame that carries no sensor."""
    edge = _moving(made)
    edge.child = made.bag.odometry[0].child = "base"


def _late(made: Made, by_s: float) -> None:
    edge = _moving(made)
    edge.stamps_ns = edge.stamps_ns + round(1e9 * by_s)


def _scaled(made: Made, places: float, turns: float) -> None:
    edge = _moving(made)
    yaw = yaw_of(edge.quaternion)
    edge.translation = edge.translation * places
    edge.quaternion = yaw_quaternion(yaw * turns)


def _inverted(made: Made) -> None:
    """The pose of odom in the base, published as that of the base in odom."""
    edge = _moving(made)
    yaw = yaw_of(edge.quaternion)
    cos, sin, (x, y) = np.cos(yaw), np.sin(yaw), edge.translation[:, :2].T
    edge.translation = np.column_stack([-cos * x - sin * y, sin * x - cos * y, np.zeros(len(x))])
    edge.quaternion = yaw_quaternion(-yaw)


def _map(made: Made, parent: str, child: str) -> None:
    """A localisation's transform, which is corrected now and then."""
    edge = deepcopy(_moving(made))
    edge.frame, edge.child = parent, child
    steps = np.cumsum(made.rng.normal(0.0, 0.01, (len(edge.stamps_ns) // 50 + 1, 2)), axis=0)
    places = steps[np.arange(len(edge.stamps_ns)) // 50]
    edge.translation = np.column_stack([places, np.zeros(len(places))])
    edge.quaternion = yaw_quaternion(0.02 * places[:, 0])
    made.bag.edges.append(edge)


def _without(made: Made, child: str) -> None:
    made.bag.edges = [edge for edge in made.bag.edges if edge.child != child]


def _without_odometry(made: Made) -> None:
    _without(made, made.bag.odometry[0].child)


def _loop(made: Made) -> None:
    made.bag.edges.append(fixed_edge("laser", "odom", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


def _second_parent(made: Made) -> None:
    made.bag.edges.append(fixed_edge("odom", "laser", (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)))


def _quaternion(made: Made, of_laser: bool, factor: float) -> None:
    edge = made.bag.edge("laser") if of_laser else _moving(made)
    edge.quaternion = edge.quaternion * factor


def _not_numbers(made: Made) -> None:
    edge = _moving(made)
    edge.translation = edge.translation.copy()
    edge.translation[10:14] = np.nan


def _ends_early(made: Made, share: float) -> None:
    edge = _moving(made)
    edge.take(np.arange(int(share * len(edge.stamps_ns))))


def _gaps(made: Made) -> None:
    """Every ten seconds the transform is missing for two."""
    edge = _moving(made)
    at_s = (edge.stamps_ns - BEGIN_NS) * 1e-9
    edge.take(at_s % 10.0 < 8.0)


def _static_changes(made: Made) -> None:
    """The laser's mount is published once more, in the middle of the drive, otherwise."""
    again = deepcopy(made.bag.edge("laser"))
    again.stamps_ns = again.stamps_ns + 30_000_000_000
    again.received_ns = again.received_ns + 30_000_000_000
    again.translation = again.translation + np.array([0.08, 0.0, 0.0])
    made.bag.edges.append(again)
    again.topic = "/tf_static"


FRAME_FAULTS: list[Fault] = [
    fault(
        "scan_in_odom",
        "scan_frame",
        "scan_frame",
        change=partial(_scan_frame, frame="odom"),
    ),
    fault(
        "scan_in_base",
        "scan_frame",
        "laser_frame",
        change=partial(_scan_frame, frame="base_link"),
        fits=lambda robot: bool(np.hypot(*robot.laser[:2]) > 0.05),
    ),
    fault(
        "scan_in_imu_link",
        "scan_frame",
        "laser_frame",
        change=partial(_scan_frame, frame="imu_link"),
        fits=lambda robot: bool(np.hypot(*np.subtract(robot.laser[:2], robot.imu_xy)) > 0.05),
    ),
    fault(
        "scan_frame_unknown",
        "scan_frame",
        "tf_unknown_frame tf_missing_link",
        change=partial(_scan_frame, frame="lidar"),
    ),
    fault(
        "scan_frame_slash",
        "scan_frame",
        "frame_slash",
        change=partial(_scan_frame, frame="/laser"),
    ),
    fault(
        "imu_frame_unknown",
        "imu_frame",
        "tf_unknown_frame tf_missing_link",
        change=_imu_frame,
        pairs=True,
    ),
    fault(
        "odometry_child_unknown",
        "child",
        "tf_unknown_frame tf_missing_link",
        change=partial(_odometry_child, child="base"),
    ),
    fault("odometry_child_laser", "child", None, change=partial(_odometry_child, child="laser")),
    fault(
        "odometry_of_another_base",
        "child",
        "tf_missing_link tf_unknown_frame",
        change=_odometry_of_base,
    ),
    fault(
        "tf_late_20ms", "tf_differs", "tf_contradicts_odometry", change=partial(_late, by_s=0.02)
    ),
    fault(
        "tf_late_25ms", "tf_differs", "tf_contradicts_odometry", change=partial(_late, by_s=0.025)
    ),
    fault(
        "tf_late_100ms", "tf_differs", "tf_contradicts_odometry", change=partial(_late, by_s=0.1)
    ),
    fault(
        "tf_longer_2%",
        "tf_differs",
        "tf_contradicts_odometry",
        change=partial(_scaled, places=1.02, turns=1.0),
    ),
    fault(
        "tf_turns_2%",
        "tf_differs",
        "tf_contradicts_odometry",
        change=partial(_scaled, places=1.0, turns=1.02),
    ),
    fault(
        "tf_longer_10%",
        "tf_differs",
        "tf_contradicts_odometry",
        change=partial(_scaled, places=1.1, turns=1.0),
    ),
    fault("tf_inverted", "tf_differs", "tf_contradicts_odometry tf_inverted", change=_inverted),
    fault(
        "map_recorded",
        "map",
        "tf_map_recorded",
        change=partial(_map, parent="map", child="odom"),
        pairs=True,
    ),
    fault(
        "map_inverted",
        "map",
        "tf_inverted tf_map_recorded",
        change=partial(_map, parent="odom", child="map"),
    ),
    fault(
        "tf_without_laser",
        "missing",
        "tf_missing_link tf_unknown_frame",
        change=partial(_without, child="laser"),
    ),
    fault(
        "tf_without_odometry",
        "missing",
        "tf_missing_link tf_unknown_frame tf_coverage",
        change=_without_odometry,
    ),
    fault("tf_loop", "tree", "tf_loop tf_two_parents", "tf_loop tf_two_parents", change=_loop),
    fault("tf_two_parents", "tree", "tf_two_parents", change=_second_parent),
    fault(
        "tf_quaternion_0",
        "rigid",
        "tf_not_rigid",
        change=partial(_quaternion, of_laser=True, factor=0.0),
    ),
    fault(
        "tf_quaternion_x2",
        "rigid",
        "tf_not_rigid",
        change=partial(_quaternion, of_laser=False, factor=2.0),
    ),
    fault("tf_nan", "rigid", "tf_not_rigid", change=_not_numbers),
    fault("tf_ends_early", "coverage", "tf_coverage", change=partial(_ends_early, share=0.5)),
    fault(
        "tf_gaps", "coverage", "tf_coverage stream_gaps", "stream_gaps tf_coverage", change=_gaps
    ),
    fault("tf_static_changes", "static", "tf_static_changes", change=_static_changes),
]
