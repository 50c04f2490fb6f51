"""Loaders of recordings, as functions of the bytes of their files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from bag_data import ROS1, ROS2, Message, Robot, as_ros1, as_rosbag2
from fault_fuzz import Target, as_file, made, texts
from fault_log_reads import whole_log
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.message_types import check_definitions, register


def _definitions() -> Iterable[bytes]:
    scan = ROS2.generate_msgdef("sensor_msgs/msg/LaserScan", ros_version=2)[0]
    yield f"ros2msg\n{scan}".encode()
    yield b"ros1msg\nfloat64[3] x\nstring<=4 name\nuint8 A=3\n"
    yield b"ros2idl\nmodule a { module msg { struct A { double x; sequence<long, 3> y; }; }; };"


def _definition(data: bytes) -> None:
    """Judged and registered as a recording's would be."""
    encoding, _, text = data.decode("utf-8", "replace").partition("\n")
    with as_input_errors(Path("a.mcap"), "a definition"):
        check_definitions([("a/msg/A", text)])
        register(get_typestore(Stores.EMPTY), "a/msg/A", encoding, text)


def _cdr(data: bytes) -> None:
    kinds = ("sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage")
    with as_input_errors(Path("a.mcap"), "a message"):
        ROS2.deserialize_cdr(data[1:], kinds[data[0] % len(kinds)])


def _messages() -> Iterable[bytes]:
    robot = Robot(ROS2)
    stamp_ns = 1_700_000_000_000_000_000
    scan, odometry = robot.scan(stamp_ns), robot.odometry(stamp_ns, 1.0)
    for number, message in enumerate((scan, odometry, robot.mounting()[2])):
        yield bytes([number]) + bytes(ROS2.serialize_cdr(message, message.__msgtype__))


def _small_messages(robot: Robot) -> list[Message]:
    """As many as show every topic twice: what is small is searched faster."""
    seen = Counter[str]()
    kept = []
    for message in robot.drive():
        seen[message[0]] += 1
        if seen[message[0]] <= 2:
            kept.append(message)
    return kept


def _plain_mcap(path: Path) -> Path:
    """Without compression and checksums, so that every change reaches what it changes."""
    bag = as_rosbag2(path.with_suffix(""), _small_messages(Robot(ROS2)), StoragePlugin.MCAP)
    return next(bag.glob("*.mcap"))


def _small_carmen() -> Iterable[bytes]:
    yield from texts(
        "PARAM robot_frontlaser_offset 0.2\n"
        "ODOM 0.0 0.0 0.0 0.1 0.0 0 1.0 host 1.0\n"
        "FLASER 3 1.0 2.0 81.9 0.2 0 0 0 0 0 1.1 host 1.1\n"
        "ODOM 0.1 0.0 0.0 0.1 0.0 0 1.2 host 1.2\n"
        "FLASER 3 1.0 2.0 81.9 0.3 0 0 0.1 0 0 1.3 host 1.3\n",
        "ROBOTLASER1 0 -1.57 3.14 1.57 20.0 0.01 0 3 1.0 2.0 3.0 0 0 0 0 0 0 0 0.1 0.1 0.5 0.3 "
        "0.3 1.0 host 1.0\n",
    )()


_LOG_WORDS = ("FLASER", "ODOM", "ROBOTLASER1", "PARAM", "nan", "inf", "1e308", "-1", "#")
_DEFINITION_WORDS = ("float64", "string", "MSG: ", "=" * 80, "[3]", "[<=2]", "geometry_msgs/Point")

LOG_TARGETS = (
    Target("carmen", as_file("a.clf", whole_log), _small_carmen, _LOG_WORDS),
    Target("mcap", as_file("a.mcap", whole_log), made("a.mcap", _plain_mcap)),
    Target(
        "ros 1 bag",
        as_file("a.bag", whole_log),
        made("a.bag", lambda path: as_ros1(path, _small_messages(Robot(ROS1)))),
    ),
    Target(
        "sqlite",
        as_file("a.db3", whole_log),
        made("bag", lambda path: as_rosbag2(path, _small_messages(Robot(ROS2)))),
    ),
    Target("definition", _definition, _definitions, _DEFINITION_WORDS),
    Target("message", _cdr, _messages),
)
