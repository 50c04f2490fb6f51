"""A simulated recording in the hands of other tools: MCAP's own reader, rosbags, ROS 1, tf2."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import ROS2, Robot, as_mcap
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap_rules import broken_rules
from rosbags.convert import convert
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamsim.config.loading import load_run_config
from slamsim.io.copy.recording import copy_recording
from slamsim.io.mcap.reader import index_mcap
from slamsim.io.open import read_log, read_recording
from slamsim.sim.drive.record import START_NS
from slamsim.simulation.simulate import simulate

pytestmark = pytest.mark.usefixtures("drives_here")

LATCHED = "/tf_static", "/robot_description"
SYSTEM_PYTHON = Path("/usr/bin/python3")
LOOKUPS = """
import json, sys
import genpy, tf2_ros
from geometry_msgs.msg import TransformStamped

told = json.load(sys.stdin)
buffer = tf2_ros.BufferCore(genpy.Duration(1000))
for topic, parent, child, stamp_ns, numbers in told["edges"]:
    message = TransformStamped()
    message.header.frame_id, message.child_frame_id = parent, child
    message.header.stamp = genpy.Time(stamp_ns // 10**9, stamp_ns % 10**9)
    to, turn = message.transform.translation, message.transform.rotation
    to.x, to.y, to.z, turn.x, turn.y, turn.z, turn.w = numbers
    set_ = buffer.set_transform_static if topic == "/tf_static" else buffer.set_transform
    set_(message, "bag")
found = []
for stamp_ns in told["stamps_ns"]:
    at = genpy.Time(stamp_ns // 10**9, stamp_ns % 10**9)
    to = buffer.lookup_transform_core("odom", "laser_link", at).transform.translation
    found.append([to.x, to.y, to.z])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    short = ["drive.route.max_duration_s=6", "sensors.lidar.rate_hz=5"]
    simulate(load_run_config("tiny", overrides=short, seed=3), folder)
    return folder


@pytest.fixture(scope="module")
def converted(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As ``rosbags-convert --dst-typestore ros1_noetic`` writes it."""
    path = tmp_path_factory.mktemp("converted") / "log.bag"
    noetic = get_typestore(Stores.ROS1_NOETIC)
    convert([recorded], path, "", 0, None, "none", None, noetic, (), (), (), ())
    return path


def mcap_of(recorded: Path) -> Path:
    (path,) = recorded.glob("*.mcap")
    return path


def test_the_library_of_mcap_finds_every_checksum_right_and_every_message(recorded: Path) -> None:
    with mcap_of(recorded).open("rb") as file:
        summary = SeekingReader(file, validate_crcs=True).get_summary()
        assert summary is not None and summary.statistics is not None
        count = summary.statistics.message_count
        indexed = [
            m.log_time for _, _, m in SeekingReader(file, validate_crcs=True).iter_messages()
        ]
        file.seek(0)
        walk = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
        assert sum(1 for _ in walk) == len(indexed) == count
        assert indexed == sorted(indexed)
        ends = [chunk.message_end_time for chunk in summary.chunk_indexes]
        starts = [chunk.message_start_time for chunk in summary.chunk_indexes]
        assert starts == sorted(starts) and ends == sorted(ends)
    assert not any(index_mcap(mcap_of(recorded)).unchecked.values())


def test_no_rule_of_mcap_is_broken_nor_is_one_by_a_copy(recorded: Path, tmp_path: Path) -> None:
    """As ``mcap doctor`` asks; a copy is written by other code of ours."""
    assert broken_rules(mcap_of(recorded)) == []
    read = read_recording(recorded)
    copy_recording(recorded, read, read, tmp_path / "copy")
    assert broken_rules(mcap_of(tmp_path / "copy")) == []


def test_what_breaks_a_rule_of_mcap_is_found(recorded: Path, tmp_path: Path) -> None:
    """The rules themselves, on files that a foreign writer made wrong."""
    late_first = sorted(Robot(ROS2).drive(), key=lambda message: -message[1])
    unsorted = broken_rules(as_mcap(tmp_path / "unsorted.mcap", late_first))
    assert set(unsorted) == {"messages in the order of log time"}
    loose = broken_rules(as_mcap(tmp_path / "loose.mcap", Robot(ROS2).drive(), chunked=False))
    assert "no message stands outside a chunk" in loose
    data = bytearray(mcap_of(recorded).read_bytes())
    statistics = data.rindex(bytes([Opcode.STATISTICS]) + struct.pack("<Q", 46 + 10 * 11))
    data[statistics + 9] ^= 1
    (tmp_path / "wrong.mcap").write_bytes(data)
    assert broken_rules(tmp_path / "wrong.mcap") == [
        "the Statistics count what is there",
        "checksum of the summary",
    ]


def test_rosbag_doctor_has_no_complaint(recorded: Path) -> None:
    """Gaps, rates, stamps, coverage, synchronisation, by somebody else's rules."""
    command = [sys.executable, "-m", "rosbag_doctor", str(recorded), "--strict", "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["issues"] == []


def test_no_time_is_one_that_ros_1_takes_for_none(recorded: Path) -> None:
    """Not even of a clock that is behind by seconds: ROS 1 has no time before 0."""
    assert START_NS > 100 * 10**9
    with Reader2(recorded) as reader:
        first_ns = Counter[str]()
        for connection, log_ns, _ in reader.messages():
            first_ns.setdefault(connection.topic, log_ns)
    assert min(first_ns.values()) == START_NS
    assert {first_ns[topic] for topic in LATCHED} == {START_NS}


def ros1_messages(path: Path) -> list[tuple[str, int, Any]]:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader1(path) as reader:
        for connection in reader.connections:
            if connection.msgtype not in store.fielddefs:
                store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return [
            (connection.topic, log_ns, store.deserialize_ros1(data, connection.msgtype))
            for connection, log_ns, data in reader.messages()
        ]


def test_every_message_is_there_in_ros_1_and_reads_the_same(
    recorded: Path, converted: Path
) -> None:
    with Reader2(recorded) as reader:
        there = Counter(connection.topic for connection, _, _ in reader.messages())
    messages = ros1_messages(converted)
    assert Counter(topic for topic, _, _ in messages) == there
    assert all(there[topic] == 1 for topic in LATCHED)
    assert min(log_ns for _, log_ns, _ in messages) >= START_NS
    one, other = read_log(recorded), read_log(converted)
    assert [s.stamp_ns for s in one.scans] == [s.stamp_ns for s in other.scans]
    assert one.odometry is not None and other.odometry is not None
    np.testing.assert_array_equal(one.odometry.poses, other.odometry.poses)
    np.testing.assert_array_equal(one.T_base_laser, other.T_base_laser)
    assert one.warnings == other.warnings


def has_tf2() -> bool:
    if not SYSTEM_PYTHON.is_file():
        return False
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", "import genpy, tf2_ros"], capture_output=True, check=False
    )
    return done.returncode == 0


@pytest.mark.skipif(not has_tf2(), reason="python3-tf2-ros is not installed")
def test_tf2_finds_the_laser_at_every_scan(recorded: Path, converted: Path) -> None:
    """Debian's tf2, given the converted transforms, against the odometry and the mount."""
    edges = []
    for topic, _, message in ros1_messages(converted):
        for edge in getattr(message, "transforms", ()):
            stamp = edge.header.stamp
            to, turn = edge.transform.translation, edge.transform.rotation
            numbers = [to.x, to.y, to.z, turn.x, turn.y, turn.z, turn.w]
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            edges.append([topic, edge.header.frame_id, edge.child_frame_id, stamp_ns, numbers])
    log = read_log(recorded)
    assert log.odometry is not None
    first_ns, last_ns = log.odometry.stamps_ns[[0, -1]].tolist()
    stamps_ns = [s.stamp_ns for s in log.scans if first_ns <= s.stamp_ns <= last_ns]
    assert len(stamps_ns) > 10
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", LOOKUPS],
        input=json.dumps({"edges": edges, "stamps_ns": stamps_ns}),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    poses = log.odometry.at(np.array(stamps_ns))
    x_m, y_m = log.T_base_laser[:2, 3]
    expected = poses[:, :2] + np.column_stack(
        [
            np.cos(poses[:, 2]) * x_m - np.sin(poses[:, 2]) * y_m,
            np.sin(poses[:, 2]) * x_m + np.cos(poses[:, 2]) * y_m,
        ]
    )
    np.testing.assert_allclose(np.array(json.loads(done.stdout))[:, :2], expected, atol=1e-5)
