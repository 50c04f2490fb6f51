"""Recordings by other people's writers, with topics and fields that slamsim does not model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TICKS = "slamsim_msgs/msg/EncoderTicks"
WEIRD = "odd_msgs/msg/Weird"
_DEFINITIONS = {
    TICKS: "std_msgs/Header header\nint64 left\nint64 right\nuint32 ticks_per_revolution\n"
    "float64 wheel_radius_m\nfloat64 track_m\n",
    WEIRD: "int8 a\nfloat64 b\nstring[] c\nbool d\nuint16[3] e\nfloat32[] f\n"
    "geometry_msgs/Point[] g\nchar h\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
KINDS = ("mcap", "rosbag2_mcap", "rosbag2_sqlite", "rosbag1")
START_NS = 1_700_000_000_123_456_789


def store_of(kind: str) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "rosbag1" else Stores.ROS2_JAZZY)
    for name, text in _DEFINITIONS.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
    return store


@dataclass(frozen=True)
class Sent:
    """One message: publisher (several may share a topic), log time, type, bytes."""

    topic: str
    publisher: int
    log_ns: int
    type_name: str
    data: bytes


class Author:
    """Messages full of random numbers, of any type."""

    def __init__(self, store: Any, seed: int) -> None:
        self.store, self.rng = store, np.random.default_rng(seed)

    def any(self, name: str) -> Any:
        """A message of this type whose every field is random."""
        _, fields = self.store.fielddefs[name]
        return self.store.types[name](*(self._value(kind) for _, kind in fields))

    def _value(self, kind: Any) -> Any:
        what, of = kind
        if what == Nodetype.BASE:
            return self._number(of[0])
        if what == Nodetype.NAME:
            return self.any(of)
        inner, length = of
        count = length if what == Nodetype.ARRAY else int(self.rng.integers(0, 4))
        values = [self._value(inner) for _ in range(count)]
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            names = {"octet": "u1", "byte": "u1", "char": "u1", "bool": "?"}
            return np.array(values, dtype=names.get(inner[1][0], inner[1][0]))
        return values

    def _number(self, name: str) -> Any:
        if name == "string":
            return "".join(self.rng.choice(list("abc /_\u00e9"), int(self.rng.integers(0, 7))))
        if name == "bool":
            return bool(self.rng.integers(0, 2))
        if name.startswith("float"):
            value = float(self.rng.choice([self.rng.normal(), -0.0, np.inf, 1e-30]))
            return float(np.float32(value)) if name == "float32" else value
        bits = {"octet": 8, "byte": 8, "char": 8}.get(name) or int(
            "".join(filter(str.isdigit, name))
        )
        signed = name.startswith("int")
        return int(self.rng.integers(-(2 ** (bits - 1)) if signed else 0, 2 ** min(bits - 1, 62)))

    def stamped(self, name: str, stamp_ns: int, frame: str) -> Any:
        message = self.any(name)
        self.set_header(message.header, stamp_ns, frame)
        return message

    @staticmethod
    def set_header(header: Any, stamp_ns: int, frame: str) -> None:
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = frame

    def scan(self, stamp_ns: int, beams: int, frame: str = "laser") -> Any:
        message = self.stamped("sensor_msgs/msg/LaserScan", stamp_ns, frame)
        step = 4.0 / beams
        declared = (-2.0, -2.0 + step * (beams - 1), step, 1e-4, 0.1, 0.05, 25.0)
        names = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
        for name, value in zip((*names, "range_min", "range_max"), declared, strict=True):
            setattr(message, name, float(np.float32(value)))
        message.ranges = self.rng.uniform(0.5, 8.0, beams).astype(np.float32)
        message.ranges[self.rng.random(beams) < 0.1] = np.inf
        message.intensities = self.rng.uniform(0, 100, beams).astype(np.float32)
        return message

    def imu(self, stamp_ns: int, yaw_rate: float) -> Any:
        message = self.stamped("sensor_msgs/msg/Imu", stamp_ns, "imu_link")
        self._vector(message.angular_velocity, 0.001, 0.002, yaw_rate)
        self._vector(message.linear_acceleration, 0.01, 0.02, 9.81)
        self._vector(message.orientation, 0.0, 0.0, 0.0, 1.0)
        return message

    def odometry(self, stamp_ns: int, x_m: float, yaw: float) -> Any:
        message = self.stamped("nav_msgs/msg/Odometry", stamp_ns, "odom")
        message.child_frame_id = "base_footprint"
        self._vector(message.pose.pose.position, x_m, 0.1 * x_m, 0.0)
        self._vector(message.pose.pose.orientation, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        self._vector(message.twist.twist.linear, 0.5, 0.0, 0.0)
        self._vector(message.twist.twist.angular, 0.0, 0.0, 0.3)
        return message

    def joints(self, stamp_ns: int, angle: float) -> Any:
        message = self.stamped("sensor_msgs/msg/JointState", stamp_ns, "")
        message.name = ["left", "right"]
        message.position, message.velocity = np.array([angle, 1.1 * angle]), np.array([1.0, 1.1])
        message.effort = self.rng.normal(size=2)
        return message

    def ticks(self, stamp_ns: int, turns: float) -> Any:
        message = self.stamped(TICKS, stamp_ns, "base_footprint")
        message.left, message.right = int(2000 * turns), int(2100 * turns)
        message.ticks_per_revolution, message.wheel_radius_m, message.track_m = 2000, 0.05, 0.3
        return message

    def tf(self, stamp_ns: int, *edges: tuple[str, str, float, float]) -> Any:
        message = self.any("tf2_msgs/msg/TFMessage")
        message.transforms = []
        for parent, child, x_m, yaw in edges:
            edge = self.stamped("geometry_msgs/msg/TransformStamped", stamp_ns, parent)
            edge.child_frame_id = child
            self._vector(edge.transform.translation, x_m, 0.0, 0.0)
            self._vector(edge.transform.rotation, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
            message.transforms.append(edge)
        return message

    @staticmethod
    def _vector(part: Any, *values: float) -> None:
        for axis, value in zip("xyzw", values, strict=False):
            setattr(part, axis, float(value))


UNMODELLED = {
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/camera/image": "sensor_msgs/msg/Image",
    "/odd": WEIRD,
    "/scan_copy/points": "sensor_msgs/msg/PointCloud2",
}


def drive(store: Any, seed: int, seconds: float = 3.0) -> list[tuple[str, int, int, Any]]:
    """(topic, publisher, log time, message) of a robot with everything, in the order of the file.

    Stamps scatter as real drivers' do; some messages are logged before the one above them.
    """
    author = Author(store, seed)
    rng, found = author.rng, list[tuple[str, int, int, Any]]()
    mounts = (
        ("base_footprint", "base_link", 0.0, 0.0),
        ("base_link", "laser", 0.2, 0.1),
        ("base_link", "imu_link", -0.1, 0.0),
    )
    found.append(("/tf_static", 0, START_NS, author.tf(START_NS, *mounts)))
    found.append(("/robot_description", 0, START_NS, _text(store, "<robot name='r'/>")))
    for i in range(int(10 * seconds)):
        t = START_NS + 100_000_000 * i + int(rng.integers(0, 900_000))
        found.append(("/scan", 0, t + 110_000_000, author.scan(t, 40)))
        points = author.stamped("sensor_msgs/msg/PointCloud2", t, "laser")
        found.append(("/scan_copy/points", 0, t + 120_000_000, points))
    for i in range(int(25 * seconds)):
        t = START_NS + 40_000_000 * i + int(rng.integers(0, 90_000))
        x_m, yaw = 0.02 * i, 0.012 * i
        found.append(("/imu", 0, t + 2_000_000, author.imu(t, 0.3)))
        wheels_ns = t + 1_000
        found.append(("/odom", i % 2, t + 3_000_000, author.odometry(wheels_ns, x_m, yaw)))
        found.append(("/joint_states", 0, t + 3_000_000, author.joints(wheels_ns, 0.2 * i)))
        found.append(("/ticks", 0, t + 3_000_000, author.ticks(wheels_ns, 0.1 * i)))
        moving = ("odom", "base_footprint", x_m, yaw), ("base_link", "arm", 0.3, 0.01 * i)
        found.append(("/tf", 0, t + 3_000_000, author.tf(wheels_ns, *moving)))
    for topic, name in UNMODELLED.items():
        if topic != "/scan_copy/points":
            for i in range(7):
                found.append((topic, i % 2, START_NS + 400_000_000 * i, author.any(name)))
    found.sort(key=lambda message: message[2] + int(rng.integers(0, 2_000_000)))
    return found


def _text(store: Any, text: str) -> Any:
    return store.types["std_msgs/msg/String"](text)


def sent(kind: str, store: Any, messages: Sequence[tuple[str, int, int, Any]]) -> Iterator[Sent]:
    for topic, publisher, log_ns, message in messages:
        name = message.__msgtype__
        serialize = store.serialize_ros1 if kind == "rosbag1" else store.serialize_cdr
        yield Sent(topic, publisher, log_ns, name, bytes(serialize(message, name)))


def write(kind: str, path: Path, messages: Sequence[Sent], store: Any) -> Path:
    """By the libraries of others; a path to be read."""
    if kind == "mcap":
        return _write_mcap(path.with_suffix(".mcap"), messages, store)
    if kind == "rosbag1":
        return _write_ros1(path.with_suffix(".bag"), messages, store)
    plugin = StoragePlugin.MCAP if kind == "rosbag2_mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        writer.set_custom_data("operator", "somebody else")
        known: dict[str, Any] = {}
        for each in messages:
            if each.topic not in known:
                known[each.topic] = writer.add_connection(
                    each.topic, each.type_name, typestore=store, offered_qos_profiles=(_qos(),)
                )
            writer.write(known[each.topic], each.log_ns, each.data)
    return path


def offered_in_numbers(folder: Path) -> dict[str, str]:
    """What a rosbag2 folder offers as quality of service on each topic: MCAP and metadata.yaml
    agree, and ROS 2 Humble reads it: policies as numbers, in a text of metadata version 8."""
    information = yaml.safe_load((folder / "metadata.yaml").read_text())
    information = information["rosbag2_bagfile_information"]
    (mcap,) = folder.glob("*.mcap")
    with mcap.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        channels = [channel for _, channel, _ in reader.iter_messages()]
    found = {each.topic: each.metadata["offered_qos_profiles"] for each in channels}
    for entry in information["topics_with_message_count"]:
        announced = entry["topic_metadata"]
        assert announced["offered_qos_profiles"] == found[announced["name"]]
    profiles = [each for offered in found.values() for each in yaml.safe_load(offered)]
    policies = [each[name] for each in profiles for name in ("history", "durability", "liveliness")]
    assert information["version"] == 8 and all(type(each) is int for each in policies)
    return found


def _qos() -> Qos:
    forever = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.BEST_EFFORT,
        QosDurability.VOLATILE,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )


def _write_mcap(path: Path, messages: Sequence[Sent], store: Any) -> Path:
    with path.open("wb") as stream:
        writer = McapWriter(stream, 20_000, CompressionType.LZ4, enable_data_crcs=True)
        writer.start(profile="ros2", library="somebody else")
        writer.add_attachment(5, 6, "calibration.txt", "text/plain", b"\x00 bytes \xff")
        writer.add_metadata("site", {"floor": "3", "weather": "dry"})
        writer.add_metadata("site", {"floor": "4"})
        schemas: dict[str, int] = {}
        known: dict[tuple[str, int], int] = {}
        for number, each in enumerate(messages):
            if each.type_name not in schemas:
                text = store.generate_msgdef(each.type_name, ros_version=2)[0]
                schemas[each.type_name] = writer.register_schema(
                    each.type_name, "ros2msg", text.encode()
                )
            key = each.topic, each.publisher
            if key not in known:
                metadata = {"offered_qos_profiles": "", "publisher": str(each.publisher)}
                known[key] = writer.register_channel(
                    each.topic, "cdr", schemas[each.type_name], metadata
                )
            published_ns = each.log_ns - 1000
            writer.add_message(known[key], each.log_ns, each.data, published_ns, 7 * number)
        other = writer.register_schema("Other", "protobuf", b"\n\x80\xff\x00")
        foreign = writer.register_channel("/protobuf", "protobuf", other)
        writer.add_message(foreign, START_NS, b"\x08\x96\x01", START_NS, 3)
        bare = writer.register_channel("/bare", "json", 0)
        writer.add_message(bare, START_NS + 1, b'{"a": 1}', START_NS, 4)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _write_ros1(path: Path, messages: Sequence[Sent], store: Any) -> Path:
    with Writer1(path) as writer:
        known: dict[tuple[str, int], Any] = {}
        for each in messages:
            key = each.topic, each.publisher
            if key not in known:
                known[key] = writer.add_connection(
                    each.topic,
                    each.type_name,
                    typestore=store,
                    callerid=f"/node_{each.publisher}",
                    latching=1 if each.topic == "/tf_static" else None,
                )
            writer.write(known[key], each.log_ns, each.data)
    return path
