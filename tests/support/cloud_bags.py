"""Recordings whose only lidar publishes point clouds: the drive of ``scan_recording`` seen by a
3-D lidar with rings, or by one whose returns come in no order."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from bag_data import ROS2, START_NS, Message, Robot, as_mcap
from scan_recording import NOISE_M, recording, truth, world
from simulated import sense_scans

from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry
from slamsim.recording import RawImu, RawOdometry

ROBOT = Robot(ROS2)
TURNING = ScanGeometry(-np.pi, np.deg2rad(0.5), 720, 100_000_000 // 720, 0.1, 30.0)
"""All around in a tenth of a second, counter-clockwise."""
RINGS_DEG = (-12.0, -8.0, -4.0, 0.2, 4.0, 8.0)
LEVEL_RING = RINGS_DEG.index(0.2)
SENSOR_HEIGHT_M = 0.5
_TYPES = {"f4": 7, "f8": 8, "u2": 4, "u4": 6, "i2": 3}

Times = Literal["s", "ns", "absolute", ""]


def cloud(
    stamp_ns: int,
    fields: dict[str, FloatArray],
    kinds: dict[str, str] | None = None,
    frame: str = "velodyne",
    height: int = 1,
    padding: int = 0,
    big: bool = False,
) -> Any:
    """sensor_msgs/PointCloud2 of columns. kinds: of numbers, ``f4`` where not named. height: rows;
    padding: bytes after each."""
    names, size = list(fields), len(next(iter(fields.values())))
    given = kinds or {}
    order = ">" if big else "<"
    dtype = np.dtype([(name, order + given.get(name, "f4")) for name in names])
    points = np.zeros(size, dtype=dtype)
    for name, values in fields.items():
        points[name] = values
    width = size // height
    rows = points[: width * height].view(np.uint8).reshape(height, width * dtype.itemsize)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    t = ROS2.types
    fields_of: Any = dtype.fields
    offsets = {name: int(fields_of[name][1]) for name in names}
    described = [
        t["sensor_msgs/msg/PointField"](
            name,
            offsets[name],
            _TYPES[given.get(name, "f4")],
            1,
        )
        for name in names
    ]
    return t["sensor_msgs/msg/PointCloud2"](
        ROBOT.header(stamp_ns, frame), height, width, described, big, dtype.itemsize,
        rows.shape[1], rows.ravel(), False,
    )  # fmt: skip


def sensed(geometry: ScanGeometry = TURNING) -> list[Scan]:
    path: PlanarTrajectory = truth()
    return sense_scans(world()[0], path, geometry, NOISE_M, 0)


def rings_of(scan: Scan, times: Times = "s", R_sensor_base: FloatArray | None = None) -> Any:
    """The cloud of a lidar with rings; walls reach up to the sky, and there is a floor."""
    angles, after_s = scan.geometry.angles_rad(), scan.geometry.offsets_ns() * 1e-9
    columns: dict[str, list[FloatArray]] = {name: [] for name in ("x", "y", "z", "ring", "t")}
    for ring, up_deg in enumerate(RINGS_DEG):
        rise = np.tan(np.deg2rad(up_deg))
        reach_m = scan.ranges_m.astype(np.float64)
        if rise < 0.0:
            reach_m = np.minimum(reach_m, -SENSOR_HEIGHT_M / rise)
        xyz = np.column_stack([reach_m * np.cos(angles), reach_m * np.sin(angles), reach_m * rise])
        xyz = xyz if R_sensor_base is None else xyz @ R_sensor_base.T
        numbers = np.full(angles.size, float(ring))
        for name, values in zip(columns, (*xyz.T, numbers, after_s), strict=True):
            columns[name].append(values)
    fields = {name: np.concatenate(parts) for name, parts in columns.items()}
    order = np.argsort(fields["t"], kind="stable")
    fields = {name: values[order] for name, values in fields.items()}
    seconds, kinds = fields.pop("t"), {"ring": "u2"}
    stamp_ns = START_NS + scan.stamp_ns
    if times == "s":
        fields["time"] = seconds
    elif times == "ns":
        fields["t"], kinds["t"] = np.rint(seconds * 1e9), "u4"
    elif times == "absolute":
        fields["timestamp"], kinds["timestamp"] = seconds + 1e-9 * stamp_ns, "f8"
    return cloud(stamp_ns, fields, kinds)


def slab_of(scan: Scan, seed: int) -> Any:
    """A cloud without order: walls from the floor to 1 m above the sensor, and the floor itself."""
    random = np.random.default_rng(seed)
    angles, ranges_m = scan.geometry.angles_rad(), scan.ranges_m.astype(np.float64)
    walls = [
        np.column_stack([ranges_m * np.cos(angles), ranges_m * np.sin(angles),
                         random.uniform(-SENSOR_HEIGHT_M, 1.0, angles.size)])
        for _ in range(8)
    ]  # fmt: skip
    near_m = ranges_m * random.uniform(0.2, 0.9, angles.size)
    floor = np.column_stack(
        [near_m * np.cos(angles), near_m * np.sin(angles), np.full(angles.size, -SENSOR_HEIGHT_M)]
    )
    points = random.permutation(np.concatenate([*walls, floor]))
    return cloud(START_NS + scan.stamp_ns, dict(zip("xyz", points.T, strict=True)))


def bag_of(
    path: Path,
    clouds: list[Message],
    q_base_sensor_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
    *,
    by_transforms: bool = False,
) -> Path:
    """With odometry, as messages or as transforms, a gyroscope and the sensor's mounting: an
    MCAP."""
    from scan_recording import raw_scans

    whole = recording(raw_scans(sensed()), 0)
    mount = ROBOT.transform(START_NS, ("base_footprint", "velodyne"))
    mount.transform.translation.z = SENSOR_HEIGHT_M
    for axis, value in zip("xyzw", q_base_sensor_xyzw, strict=True):
        setattr(mount.transform.rotation, axis, value)
    imu = ROBOT.transform(START_NS, ("base_footprint", "imu_link"))
    messages: list[Message] = [("/tf_static", START_NS, ROBOT.tf(mount, imu)), *clouds]
    told = _transforms if by_transforms else _odometry
    messages += [*told(whole.of(RawOdometry)[0]), *_gyro(whole.of(RawImu)[0])]
    return as_mcap(path, sorted(messages, key=lambda message: message[1]), chunk_size=1 << 20)


def _odometry(odometry: RawOdometry) -> list[Message]:
    found: list[Message] = []
    for stamp, place, turn in zip(
        odometry.stamps_ns.tolist(), odometry.positions_m, odometry.quats_xyzw, strict=True
    ):
        message = ROBOT.odometry(START_NS + stamp, float(place[0]))
        message.pose.pose.position.y = float(place[1])
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = turn[2:].tolist()
        found.append(("/odom", START_NS + stamp, message))
    return found


def _transforms(odometry: RawOdometry) -> list[Message]:
    found: list[Message] = []
    for _, stamp_ns, message in _odometry(odometry):
        pose, moved = message.pose.pose, ROBOT.transform(stamp_ns, ("odom", "base_footprint"))
        for axis in "xyz":
            setattr(moved.transform.translation, axis, getattr(pose.position, axis))
        moved.transform.rotation = pose.orientation
        found.append(("/tf", stamp_ns, ROBOT.tf(moved)))
    return found


def _gyro(imu: RawImu) -> list[Message]:
    rates = imu.angular_velocity_rad_s[:, 2].tolist()
    stamps = (START_NS + imu.stamps_ns).tolist()
    return [("/imu", t, ROBOT.imu(t, rate)) for t, rate in zip(stamps, rates, strict=True)]


def as_messages(clouds: list[Any], topic: str = "/points") -> list[Message]:
    """Each received when its last point was measured."""
    found: list[Message] = []
    for each in clouds:
        stamp = each.header.stamp
        found.append((topic, int(stamp.sec) * 10**9 + int(stamp.nanosec) + 100_000_000, each))
    return found
