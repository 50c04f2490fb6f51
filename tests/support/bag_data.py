"""Foreign recordings for the tests: the same made-up robot in every ROS format."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
SCANS, IMUS = 12, 60
START_NS = 1_700_000_000_000_000_000

Message = tuple[str, int, Any]
"""(topic, log time, message)"""
Maker = Callable[[Path, Iterable[Message]], Path]


class Robot:
    """Messages of a robot that drives straight on at 1 m/s, in the types of one ROS."""

    def __init__(self, store: Any) -> None:
        self.store, self._t = store, store.types

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self._t["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
        kind = self._t["std_msgs/msg/Header"]
        return kind(0, time, frame) if self.store is ROS1 else kind(time, frame)

    def scan(self, stamp_ns: int, ranges: Sequence[float] = (1, 2, 3, 4, 5), **changes: Any) -> Any:
        fields = {
            "angle_min": -1.0,
            "angle_max": -1.0 + 0.5 * (len(ranges) - 1),
            "angle_increment": 0.5,
            "time_increment": 1e-3,
            "scan_time": 0.1,
            "range_min": 0.5,
            "range_max": 20.0,
        } | changes
        values = np.array(ranges, dtype=np.float32)
        kind = self._t["sensor_msgs/msg/LaserScan"]
        frame = fields.pop("frame", "laser")
        empty = np.zeros(0, dtype=np.float32)
        return kind(self.header(stamp_ns, frame), *fields.values(), values, empty)

    def echoes(self, stamp_ns: int) -> Any:
        """sensor_msgs/MultiEchoLaserScan: beams with one echo, none, and two."""
        scan, echo = self.scan(stamp_ns), self._t["sensor_msgs/msg/LaserEcho"]
        beams = [echo(np.array(each, dtype=np.float32)) for each in ([1], [], [3, 5])]
        declared = [getattr(scan, name) for name in list(scan.__dataclass_fields__)[:8]]
        return self._t["sensor_msgs/msg/MultiEchoLaserScan"](*declared, beams, [])

    def transform(
        self, stamp_ns: int, frames: tuple[str, str], x_m: float = 0.0, yaw: float = 0.0
    ) -> Any:
        t = self._t
        return t["geometry_msgs/msg/TransformStamped"](
            self.header(stamp_ns, frames[0]),
            frames[1],
            t["geometry_msgs/msg/Transform"](
                t["geometry_msgs/msg/Vector3"](x_m, 0.0, 0.0),
                t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)),
            ),
        )

    def tf(self, *transforms: Any) -> Any:
        return self._t["tf2_msgs/msg/TFMessage"](list(transforms))

    def odometry(self, stamp_ns: int, x_m: float, child: str = "base_footprint") -> Any:
        t, zero = self._t, np.zeros(36)
        vector = t["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        pose = t["geometry_msgs/msg/Pose"](
            t["geometry_msgs/msg/Point"](x_m, 0.0, 0.0),
            t["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        )
        return t["nav_msgs/msg/Odometry"](
            self.header(stamp_ns, "odom"),
            child,
            t["geometry_msgs/msg/PoseWithCovariance"](pose, zero),
            t["geometry_msgs/msg/TwistWithCovariance"](
                t["geometry_msgs/msg/Twist"](vector, vector), zero
            ),
        )

    def imu(self, stamp_ns: int, yaw_rate: float) -> Any:
        t, zero = self._t, np.zeros(9)
        vector = t["geometry_msgs/msg/Vector3"]
        return t["sensor_msgs/msg/Imu"](
            self.header(stamp_ns, "imu_link"),
            t["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            zero,
            vector(0.0, 0.0, yaw_rate),
            zero,
            vector(0.0, 0.0, 9.8),
            zero,
        )

    def mounting(self) -> Message:
        edges = (
            self.transform(START_NS, ("base_footprint", "base_link")),
            self.transform(START_NS, ("base_link", "laser"), 0.2, 0.5),
            self.transform(START_NS, ("base_link", "imu_link"), -0.1),
        )
        return "/tf_static", START_NS, self.tf(*edges)

    def scans(self) -> list[Message]:
        stamps = [START_NS + 100_000_000 * i for i in range(SCANS)]
        return [
            ("/front/scan", t + 5_000_000, self.scan(t, (1 + i, 2, 3)))
            for i, t in enumerate(stamps)
        ]

    def drive(self) -> list[Message]:
        """Scans, odometry, IMU and the mounting, in the order of log time."""
        messages = [self.mounting(), *self.scans()]
        for i in range(IMUS):
            stamp_ns = START_NS + 20_000_000 * i
            messages.append(("/wheel_odom", stamp_ns, self.odometry(stamp_ns, 0.02 * i)))
            messages.append(("/imu", stamp_ns, self.imu(stamp_ns, 0.1 * i)))
        return sorted(messages, key=lambda message: message[1])


def as_ros1(
    path: Path,
    messages: Iterable[Message],
    compression: str = "",
    chunk_size: int = 1 << 20,
    header: str = "std_msgs/Header",
) -> Path:
    """header: how the definitions name the type of headers."""
    writer = Writer1(path)
    writer.chunk_threshold = chunk_size
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for topic, log_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                text, digest = ROS1.generate_msgdef(kind)
                text = text.replace("std_msgs/Header header", "Header header")  # as ROS writes
                text = text.replace("std_msgs/Header", header)
                connection = writer.add_connection(topic, kind, msgdef=text, md5sum=digest)
                connections[topic] = connection
            data = bytes(ROS1.serialize_ros1(message, kind))
            writer.write(connections[topic], log_ns, data)
    return path


def as_rosbag2(
    path: Path, messages: Iterable[Message], plugin: StoragePlugin = StoragePlugin.SQLITE3
) -> Path:
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, log_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], log_ns, ROS2.serialize_cdr(message, kind))
    return path


def as_mcap(
    path: Path,
    messages: Iterable[Message],
    compression: CompressionType = CompressionType.ZSTD,
    chunked: bool = True,
    chunk_size: int = 4096,
    definitions: dict[str, str] | None = None,
    profile: str = "ros2",
) -> Path:
    """By the mcap library's own writer. definitions replace those of the types."""
    with path.open("wb") as stream:
        writer = McapWriter(
            stream,
            chunk_size,
            compression,
            use_chunking=chunked,
            enable_data_crcs=True,
        )
        writer.start(profile=profile)
        channels: dict[str, int] = {}
        for topic, log_ns, message in messages:
            kind = message.__msgtype__
            if topic not in channels:
                text = (definitions or {}).get(kind)
                text = ROS2.generate_msgdef(kind, ros_version=2)[0] if text is None else text
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(ROS2.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
