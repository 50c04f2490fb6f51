"""Recordings of a laser that is not as it is declared: any log, with small errors put into it.

    python tests/support/laser_errors.py LOG OUT.bag --angle-step 0.01 --laser-yaw 2

writes a log as a ROS 1 bag as others publish them (LaserScan, Odometry and tf, no return at the
maximum range), with these errors; ``slamsim map OUT.bag`` then maps it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamsim.core.geometry import matrix_from_rpy, se2_from_se3
from slamsim.core.types import FloatArray, Log, Scan, ScanGeometry, ScanSource
from slamsim.io.open import read_log


@dataclass(frozen=True)
class LaserErrors:
    """By how much a recording is wrong: angle_step, range_scale: as shares of what is true;
    sweep_s: what it declares from the first beam to the last, None as it is. late_s: of stamps."""

    angle_step: float = 0.0
    range_offset_m: float = 0.0
    range_scale: float = 0.0
    yaw_rad: float = 0.0
    x_m: float = 0.0
    sweep_s: float | None = None
    late_s: float = 0.0

    def of(self, log: Log) -> Log:
        """The log with these errors."""
        T_base_laser = log.T_base_laser.copy()
        T_base_laser[:3, :3] = matrix_from_rpy(0.0, 0.0, self.yaw_rad) @ T_base_laser[:3, :3]
        T_base_laser[0, 3] += self.x_m
        return replace(log, scans=_Wrong(log.scans, self), T_base_laser=T_base_laser)

    def scan(self, scan: Scan) -> Scan:
        """One scan with these errors; angles are wrong about the middle beam."""
        geometry = scan.geometry
        ranges_m = scan.ranges_m * (1.0 + self.range_scale) + self.range_offset_m
        ranges_m = np.where(ranges_m > 0.0, ranges_m, np.nan).astype(np.float32)
        stamp_ns = scan.stamp_ns + round(1e9 * self.late_s)
        geometry = self._geometry(geometry)
        return replace(scan, stamp_ns=stamp_ns, ranges_m=ranges_m, geometry=geometry)

    def _geometry(self, geometry: ScanGeometry) -> ScanGeometry:
        intervals = geometry.beam_count - 1
        step_rad = geometry.angle_step_rad * (1.0 + self.angle_step)
        wider_rad = intervals * (step_rad - geometry.angle_step_rad)
        beam_dt_ns = geometry.beam_dt_ns
        if self.sweep_s is not None:
            beam_dt_ns = round(1e9 * self.sweep_s / intervals)
        return replace(
            geometry,
            angle_min_rad=geometry.angle_min_rad - 0.5 * wider_rad,
            angle_step_rad=step_rad,
            beam_dt_ns=beam_dt_ns,
            range_max_m=geometry.range_max_m * (1.0 + self.range_scale) + self.range_offset_m,
        )


@dataclass(frozen=True)
class _Wrong:
    scans: ScanSource
    errors: LaserErrors

    def __len__(self) -> int:
        return len(self.scans)

    def __iter__(self) -> Iterator[Scan]:
        return map(self.errors.scan, self.scans)


class _Bag:
    """A ROS 1 bag being written."""

    def __init__(self, writer: Writer) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC)
        tf = "geometry_msgs/TransformStamped[] transforms"
        self.store.register(get_types_from_msg(tf, "tf2_msgs/msg/TFMessage"))
        self._writer, self._connections = writer, dict[str, Any]()

    def make(self, name: str, **fields: Any) -> Any:
        package, kind = name.split("/")
        return self.store.types[f"{package}/msg/{kind}"](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        stamp = self.store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self.make("std_msgs/Header", seq=0, stamp=stamp, frame_id=frame)

    def parts(self, pose: FloatArray) -> tuple[Any, Any]:
        """(x, y, yaw) as keywords of a place, and a quaternion."""
        x, y, yaw = map(float, pose)
        turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
        return {"x": x, "y": y, "z": 0.0}, self.make("geometry_msgs/Quaternion", **turn)

    def transform(self, stamp_ns: int, parent: str, child: str, pose: FloatArray) -> Any:
        place, turn = self.parts(pose)
        moved = self.make("geometry_msgs/Vector3", **place)
        both = self.make("geometry_msgs/Transform", translation=moved, rotation=turn)
        header = self.header(stamp_ns, parent)
        name = "geometry_msgs/TransformStamped"
        return self.make(name, header=header, child_frame_id=child, transform=both)

    def write(self, topic: str, stamp_ns: int, name: str, message: Any) -> None:
        full = name.replace("/", "/msg/")
        if topic not in self._connections:
            opened = self._writer.add_connection(topic, full, typestore=self.store)
            self._connections[topic] = opened
        data = self.store.serialize_ros1(message, full)
        self._writer.write(self._connections[topic], stamp_ns, data)


def write_bag1(log: Log, path: Path) -> None:
    """Scans and odometry at their stamps, tf; without a gyroscope."""
    assert log.odometry is not None
    mount, odometry = se2_from_se3(log.T_base_laser), log.odometry
    with Writer(path) as writer:
        bag = _Bag(writer)
        for stamp_ns, pose in zip(odometry.stamps_ns.tolist(), odometry.poses, strict=True):
            links = [
                bag.transform(stamp_ns, "odom", "base_link", pose),
                bag.transform(stamp_ns, "base_link", "laser", mount),
            ]
            name = "tf2_msgs/TFMessage"
            bag.write("/tf", stamp_ns, name, bag.make(name, transforms=links))
            bag.write("/odom", stamp_ns, "nav_msgs/Odometry", _odometry(bag, stamp_ns, pose))
        for scan in log.scans:
            bag.write("/scan", scan.stamp_ns, "sensor_msgs/LaserScan", _laser_scan(bag, scan))


def _odometry(bag: _Bag, stamp_ns: int, pose: FloatArray) -> Any:
    place, turn = bag.parts(pose)
    point, still = bag.make("geometry_msgs/Point", **place), np.zeros(36)
    there = bag.make("geometry_msgs/Pose", position=point, orientation=turn)
    zero = bag.make("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
    twist = bag.make("geometry_msgs/Twist", linear=zero, angular=zero)
    return bag.make(
        "nav_msgs/Odometry",
        header=bag.header(stamp_ns, "odom"),
        child_frame_id="base_link",
        pose=bag.make("geometry_msgs/PoseWithCovariance", pose=there, covariance=still),
        twist=bag.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=still),
    )


def _laser_scan(bag: _Bag, scan: Scan) -> Any:
    geometry, far_m = scan.geometry, scan.geometry.range_max_m
    span_rad = geometry.angle_step_rad * (geometry.beam_count - 1)
    readings = np.nan_to_num(np.where(np.isinf(scan.ranges_m), far_m, scan.ranges_m), nan=0.0)
    return bag.make(
        "sensor_msgs/LaserScan",
        header=bag.header(scan.stamp_ns, "laser"),
        angle_min=geometry.angle_min_rad,
        angle_max=geometry.angle_min_rad + span_rad,
        angle_increment=geometry.angle_step_rad,
        time_increment=geometry.beam_dt_ns * 1e-9,
        scan_time=0.0,
        range_min=0.0,
        range_max=far_m,
        ranges=readings.astype(np.float32),
        intensities=np.zeros(0, np.float32),
    )


def main() -> None:
    """As the head of this file says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--angle-step", type=float, default=0.0, help="share, 0.01 is 1 %% wide")
    parser.add_argument("--range-offset", type=float, default=0.0, help="metres too long")
    parser.add_argument("--range-scale", type=float, default=0.0, help="share")
    parser.add_argument("--laser-yaw", type=float, default=0.0, help="degrees")
    parser.add_argument("--laser-x", type=float, default=0.0, help="metres")
    parser.add_argument("--sweep", type=float, default=None, help="seconds, first beam to last")
    given = parser.parse_args()
    errors = LaserErrors(
        given.angle_step,
        given.range_offset,
        given.range_scale,
        float(np.deg2rad(given.laser_yaw)),
        given.laser_x,
        given.sweep,
    )
    write_bag1(errors.of(read_log(given.log)), given.bag)


if __name__ == "__main__":
    main()
