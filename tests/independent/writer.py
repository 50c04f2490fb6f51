"""Writes a recording as a rosbag2, by the rosbags library."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from independent.recorded import Bag, Edge, Imu, Messages, Odometry, Scans

Message = tuple[int, str, Any]
"""Time of receipt in ns, topic, message."""

STORE = get_typestore(Stores.ROS2_HUMBLE)
_T: dict[str, Any] = {name.split("/")[-1]: made for name, made in STORE.types.items()}


def write(bag: Bag, path: Path, storage: str = "mcap") -> Path:
    """The bag as a folder at path, which must not exist. storage: mcap or sqlite3."""
    return write_messages(messages_of(bag), path, storage)


def write_messages(messages: list[Message], path: Path, storage: str = "mcap") -> Path:
    """Messages in the order of their receipt."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        known: dict[str, Any] = {}
        for received_ns, topic, message in sorted(messages, key=lambda each: each[0]):
            name = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, name, typestore=STORE)
            writer.write(known[topic], received_ns, STORE.serialize_cdr(message, name))
    return path


def messages_of(bag: Bag) -> list[Message]:
    """All messages, stream by stream."""
    found: list[Message] = []
    for scans in bag.scans:
        found += _with_receipt(scans, _scans(scans))
    for odometry in bag.odometry:
        found += _with_receipt(odometry, _odometries(odometry))
    for imu in bag.imu:
        found += _with_receipt(imu, _imus(imu))
    fixed = [edge for edge in bag.edges if edge.static and len(edge.stamps_ns) == 1]
    for edge in bag.edges:
        if edge not in fixed:
            found += _with_receipt(edge, (_tf([each]) for each in _transforms(edge)))
    if fixed:
        every = [each for edge in fixed for each in _transforms(edge)]
        found.append((int(fixed[0].received_ns[0]), "/tf_static", _tf(every)))
    return found


def _with_receipt(stream: Messages, messages: Iterator[Any]) -> Iterator[Message]:
    for received_ns, message in zip(stream.received_ns.tolist(), messages, strict=True):
        yield received_ns, stream.topic, message


def _header(stamp_ns: int, frame: str) -> Any:
    return _T["Header"](_T["Time"](*divmod(stamp_ns, 1_000_000_000)), frame)


def _scans(scans: Scans) -> Iterator[Any]:
    declared = (
        scans.angle_min,
        scans.angle_max,
        scans.angle_increment,
        scans.time_increment,
        scans.scan_time,
        scans.range_min,
        scans.range_max,
    )
    rows = zip(scans.stamps_ns.tolist(), scans.ranges_m, scans.intensities, strict=True)
    for stamp_ns, ranges, intensities in rows:
        header = _header(stamp_ns, scans.frame)
        arrays = (np.ascontiguousarray(one) for one in (ranges, intensities))
        yield _T["LaserScan"](header, *map(float, declared), *arrays)


def _odometries(odometry: Odometry) -> Iterator[Any]:
    covariance = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 3e-2]).ravel()
    rows = zip(
        odometry.stamps_ns.tolist(),
        odometry.xy_m.tolist(),
        odometry.quaternion.tolist(),
        odometry.linear.tolist(),
        odometry.angular.tolist(),
        strict=True,
    )
    for stamp_ns, (x, y), turn, linear, angular in rows:
        pose = _T["Pose"](_T["Point"](x, y, 0.0), _T["Quaternion"](*turn))
        twist = _T["Twist"](_T["Vector3"](*linear), _T["Vector3"](*angular))
        yield _T["Odometry"](
            _header(stamp_ns, odometry.frame),
            odometry.child,
            _T["PoseWithCovariance"](pose, covariance),
            _T["TwistWithCovariance"](twist, covariance),
        )


def _imus(imu: Imu) -> Iterator[Any]:
    given = imu.quaternion is not None
    turns = imu.quaternion if imu.quaternion is not None else np.zeros((len(imu.gyro), 4))
    orientation = np.diag([1e-4, 1e-4, 1e-3]).ravel() if given else np.array([-1.0, *[0.0] * 8])
    gyro, acceleration = np.diag([1e-5] * 3).ravel(), np.diag([1e-2] * 3).ravel()
    rows = zip(
        imu.stamps_ns.tolist(),
        turns.tolist(),
        imu.gyro.tolist(),
        imu.acceleration.tolist(),
        strict=True,
    )
    for stamp_ns, turn, rates, felt in rows:
        yield _T["Imu"](
            _header(stamp_ns, imu.frame),
            _T["Quaternion"](*turn),
            orientation,
            _T["Vector3"](*rates),
            gyro,
            _T["Vector3"](*felt),
            acceleration,
        )


def _transforms(edge: Edge) -> Iterator[Any]:
    rows = zip(
        edge.stamps_ns.tolist(), edge.translation.tolist(), edge.quaternion.tolist(), strict=True
    )
    for stamp_ns, place, turn in rows:
        transform = _T["Transform"](_T["Vector3"](*place), _T["Quaternion"](*turn))
        yield _T["TransformStamped"](_header(stamp_ns, edge.frame), edge.child, transform)


def _tf(transforms: list[Any]) -> Any:
    return _T["TFMessage"](transforms)
