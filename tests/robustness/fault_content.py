"""One short drive as serialised messages, in ROS 1 and ROS 2, and how each format holds them."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from bag_data import ROS1, START_NS, Robot
from fault_changes import PLAIN, overwrite
from fault_seeds import Change, Unfit
from fault_strings import change_string
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamsim.io.ros.message_types import ENCODER_TICKS, ros2_types

SECONDS, SPEED_M_S, BEAMS = 2.0, 0.4, 61
_ROS2 = ros2_types()
_TABLES = """
    CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,
        offered_qos_profiles TEXT, type_description_hash TEXT);
    CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
    CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,
        encoded_message_definition TEXT, type_description_hash TEXT);
    CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
_URDF = "<robot name='r'><link name='base_link'/></robot>"


@dataclass(frozen=True, slots=True)
class Raw:
    """One message as it is stored."""

    topic: str
    kind: str
    log_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Content:
    """messages: by log time. definitions: the text of each type."""

    messages: tuple[Raw, ...]
    definitions: dict[str, str]


@cache
def content(ros: int) -> Content:
    """A drive straight through a room: scans, odometry, IMU, transforms; in ROS 2 wheels too."""
    store: Any = ROS1 if ros == 1 else _ROS2
    robot = Robot(store)
    found = sorted([*_sensed(robot), *(_wheels() if ros == 2 else ())], key=lambda each: each[1])

    def packed(message: Any) -> bytes:
        pack = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        return bytes(pack(message, message.__msgtype__))

    raw = tuple(Raw(t, m.__msgtype__, log_ns, packed(m)) for t, log_ns, m in found)
    texts = {each.kind: str(store.generate_msgdef(each.kind, ros_version=ros)[0]) for each in raw}
    return Content(raw, texts)


def _sensed(robot: Robot) -> list[tuple[str, int, Any]]:
    found: list[tuple[str, int, Any]] = [robot.mounting()]
    for i in range(round(SECONDS * 10)):
        stamp_ns = START_NS + 100_000_000 * i
        declared = {"angle_min": -2.0, "angle_max": 2.0, "angle_increment": 4.0 / (BEAMS - 1)}
        ranges = _ranges(0.2 + SPEED_M_S * 0.1 * i)
        scan = robot.scan(stamp_ns, ranges, **declared, time_increment=5e-4, range_min=0.1)
        found.append(("/scan", stamp_ns + 40_000_000, scan))
    for i in range(round(SECONDS * 20) + 3):
        stamp_ns, x_m = START_NS - 50_000_000 + 50_000_000 * i, SPEED_M_S * 0.05 * i
        found.append(("/odom", stamp_ns, robot.odometry(stamp_ns, x_m)))
        found.append(("/imu", stamp_ns, robot.imu(stamp_ns, 0.0)))
        moving = robot.transform(stamp_ns, ("odom", "base_footprint"), x_m)
        found.append(("/tf", stamp_ns, robot.tf(moving)))
    return found


def _wheels() -> list[tuple[str, int, Any]]:
    """Counters, joints, clock and description."""
    robot, t = Robot(_ROS2), _ROS2.types
    text = t["std_msgs/msg/String"](_URDF)
    found: list[tuple[str, int, Any]] = [("/robot_description", START_NS - 60_000_000, text)]
    for i in range(round(SECONDS * 20) + 3):
        stamp_ns = START_NS - 50_000_000 + 50_000_000 * i
        header, turned = robot.header(stamp_ns, "base_link"), SPEED_M_S * 0.05 * i / 0.05
        ticks = round(turned * 2000 / (2.0 * np.pi))
        both, none = np.array([turned, turned]), np.zeros(0)
        names = ["left_wheel", "right_wheel"]
        counted = t[ENCODER_TICKS](header, ticks, ticks, 2000, 0.05, 0.3)
        joints = t["sensor_msgs/msg/JointState"](header, names, both, both * 0.0 + 8.0, none)
        found += [("/wheel_ticks", stamp_ns, counted), ("/joint_states", stamp_ns, joints)]
        shown = t["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
        found.append(("/clock", stamp_ns, t["rosgraph_msgs/msg/Clock"](shown)))
    return found


def _ranges(x_m: float) -> list[float]:
    """What a lidar sees in a room of 7 x 5 m with a niche, 2 m in front of the wall behind."""
    angles = -2.0 + 4.0 / (BEAMS - 1) * np.arange(BEAMS)
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.where(cos > 0.0, (5.0 - x_m) / cos, (-2.0 - x_m) / cos)
        across = np.where(sin > 0.0, 2.0 / sin, -3.0 / sin)
    niche = (angles > 0.3) & (angles < 0.5)
    ranges = np.minimum(np.abs(along), np.abs(across)) + 0.7 * niche
    return [float(range_m) for range_m in ranges]


@lru_cache(maxsize=1000)
def _hash(ros: int, kind: str, text: str) -> str:
    """Of a definition, as readers compare it; any for one that is none."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(text, kind))
        return store.hash_rihs01(kind) if ros == 2 else str(store.generate_msgdef(kind)[1])
    except Exception:
        return "RIHS01_0" if ros == 2 else "0" * 32


def as_ros1_bag(path: Path, held: Content, compression: str) -> Path:
    """compression: '', 'BZ2' or 'LZ4'."""
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    return _filled(path, writer, held, 1)


def as_rosbag2(path: Path, held: Content, *, mcap: bool = False, packed: bool = False) -> Path:
    """By rosbags: SQLite or an MCAP without checksums. packed: each message compressed."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    return _filled(path, writer, held, 2)


def _filled(path: Path, writer: Any, held: Content, ros: int) -> Path:
    """With all messages; ROS 1 has no stamps before 1970."""
    digest = {1: "md5sum", 2: "rihs01"}[ros]
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for raw in held.messages:
            key = raw.topic, raw.kind
            if key not in connections:
                text = held.definitions[raw.kind]
                known = {"msgdef": text, digest: _hash(ros, raw.kind, text)}
                connections[key] = writer.add_connection(*key, **known)
            stamp_ns = max(raw.log_ns, 0) if ros == 1 else raw.log_ns
            writer.write(connections[key], stamp_ns, raw.data)
    return path


def as_db3(path: Path, held: Content) -> Path:
    """A single SQLite file, written with SQL."""
    keys = list(dict.fromkeys((raw.topic, raw.kind) for raw in held.messages))
    texts = {kind: held.definitions[kind] for _, kind in keys}
    with closing(sqlite3.connect(path)) as db:
        db.executescript(_TABLES)
        hashes = {kind: _hash(2, kind, text) for kind, text in texts.items()}
        topics = [(i, *key, "cdr", "", hashes[key[1]]) for i, key in enumerate(keys)]
        db.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", topics)
        rows = [(keys.index((raw.topic, raw.kind)), raw.log_ns, raw.data) for raw in held.messages]
        db.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
        defined = [(kind, "ros2msg", text, "") for kind, text in texts.items()]
        db.executemany("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", defined)
        db.commit()
    return path


def as_mcap(path: Path, held: Content, packing: CompressionType, chunked: bool = True) -> Path:
    """With all checksums, in chunks of 4 kB."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, 4096, packing, use_chunking=chunked, enable_data_crcs=True)
        writer.start(profile="ros2")
        channels: dict[tuple[str, str], int] = {}
        for raw in held.messages:
            key = raw.topic, raw.kind
            if key not in channels:
                text = held.definitions[raw.kind].encode("utf-8", "surrogateescape")
                schema = writer.register_schema(raw.kind, "ros2msg", text)
                channels[key] = writer.register_channel(raw.topic, "cdr", schema)
            log_ns = raw.log_ns % 2**64
            writer.add_message(channels[key], log_ns, raw.data, log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def written_anew(ros: int, write: Callable[[Path, Content], Path]) -> Change:
    """A sound file of the format with other messages, types or topics in it."""

    def other_content(data: bytes, rng: np.random.Generator) -> bytes:
        try:
            with tempfile.TemporaryDirectory() as folder:
                return write(Path(folder) / "a", _changed(content(ros), rng)).read_bytes()
        except Exception as error:  # what the writer itself does not take is no case
            raise Unfit from error

    return other_content


def _changed(held: Content, rng: np.random.Generator) -> Content:
    kinds = (_one_message, _one_message, _one_topic, _one_topic, _order, _definition, _names)
    for _ in range(int(rng.integers(1, 3))):
        held = kinds[int(rng.integers(len(kinds)))](held, rng)
    return held


def _body(data: bytes, rng: np.random.Generator) -> bytes:
    """A message with a string, a number or some bytes changed."""
    choice = int(rng.integers(3))
    if choice == 0:
        return change_string(data, rng)
    if choice == 1:
        return overwrite(data, rng)
    return PLAIN[int(rng.integers(len(PLAIN)))](data, rng)


def _one_message(held: Content, rng: np.random.Generator) -> Content:
    raws = list(held.messages)
    topic = _topic(held, rng)
    mine = [i for i, raw in enumerate(raws) if raw.topic == topic]
    place = mine[int(rng.integers(len(mine)))]
    raws[place] = replace(raws[place], data=_body(raws[place].data, rng))
    return replace(held, messages=tuple(raws))


def _one_topic(held: Content, rng: np.random.Generator) -> Content:
    """The same place of all messages of a topic, or of many of them, holds another number."""
    topic, share = _topic(held, rng), float(rng.choice([1.0, 1.0, 0.5, 0.1]))
    number = _number(rng)
    longest = min(len(raw.data) for raw in held.messages if raw.topic == topic)
    place = int(rng.integers(0, max(longest, 1)))
    place -= place % int(rng.choice([1, 4, 4, 8]))

    def other(raw: Raw) -> Raw:
        if raw.topic != topic or rng.random() > share:
            return raw
        return replace(raw, data=raw.data[:place] + number + raw.data[place + len(number) :])

    return replace(held, messages=tuple(map(other, held.messages)))


def _number(rng: np.random.Generator) -> bytes:
    """A number of 1, 4 or 8 bytes that programs stumble over."""
    size = int(rng.choice([1, 4, 8]))
    while True:
        changed = overwrite(bytes(8), rng)[:size]
        if len(changed) == size:
            return changed


def _order(held: Content, rng: np.random.Generator) -> Content:
    """Messages of a topic lost, doubled, exchanged or received at other times."""
    topic, raws = _topic(held, rng), list(held.messages)
    kind = int(rng.integers(5))
    mine = [i for i, raw in enumerate(raws) if raw.topic == topic]
    if kind == 0:
        kept = int(rng.integers(0, len(mine) + 1))
        gone = set(rng.permutation(mine)[kept:].tolist())
        raws = [raw for i, raw in enumerate(raws) if i not in gone]
    elif kind == 1:
        raws += [raws[i] for i in mine for _ in range(int(rng.integers(1, 4)))]
    elif kind == 2:
        order = rng.permutation(mine).tolist()
        data = [raws[i].data for i in order]
        for i, other in zip(mine, data, strict=True):
            raws[i] = replace(raws[i], data=other)
    else:
        far = int(rng.choice([0, 1, 2**31, 2**62, 2**63 - 1, START_NS * 2]))
        for i in mine if kind == 3 else mine[:1]:
            raws[i] = replace(raws[i], log_ns=far if kind == 3 else raws[i].log_ns + far)
    return replace(held, messages=tuple(raws))


def _definition(held: Content, rng: np.random.Generator) -> Content:
    """The text of a type changed."""
    kind = sorted(held.definitions)[int(rng.integers(len(held.definitions)))]
    text = held.definitions[kind].encode()
    for _ in range(int(rng.integers(1, 4))):
        text = PLAIN[int(rng.integers(len(PLAIN)))](text, rng)
    changed = text.decode("utf-8", "surrogateescape")
    return replace(held, definitions={**held.definitions, kind: changed})


def _names(held: Content, rng: np.random.Generator) -> Content:
    """A topic under another name or of another type, or two topics made one."""
    topic, other = _topic(held, rng), _topic(held, rng)
    kinds = sorted(held.definitions)
    names = (other, "", "/", "/a\nb", "/\x1b[2J", "../../x", "x" * 3000, "/tf_static", "/ü\u202e")
    name = names[int(rng.integers(len(names)))]
    kind = kinds[int(rng.integers(len(kinds)))] if rng.random() < 0.5 else None

    def renamed(raw: Raw) -> Raw:
        if raw.topic != topic:
            return raw
        return replace(raw, kind=kind) if kind is not None else replace(raw, topic=name)

    return replace(held, messages=tuple(map(renamed, held.messages)))


def _topic(held: Content, rng: np.random.Generator) -> str:
    topics = sorted({raw.topic for raw in held.messages})
    if not topics:
        raise Unfit
    return topics[int(rng.integers(len(topics)))]
