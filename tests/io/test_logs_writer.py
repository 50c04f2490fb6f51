"""The recording: bytes against rosbags' own serialiser, and readable by rosbags and mcap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from log_data import drive, header, readings
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v8, dump_qos_v9, parse_qos

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.io.bag2.metadata import profiles_text
from slamsim.io.bag2.writer import MCAP_NAME
from slamsim.io.ros.encoding import encoded_transforms, outgoing, stream_messages, text
from slamsim.io.ros.layouts import Rows
from slamsim.io.ros.message_types import ENCODER_TICKS, ros2_types
from slamsim.models.differential_drive import wheel_odometry
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawTicks,
    RawTwists,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.recorder import DriveRecorder

STORE = ros2_types()
TYPES = STORE.types
POLICIES = (QosHistory, QosReliability, QosDurability, QosLiveliness)


def _time(stamp_ns: int) -> Any:
    return TYPES["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))


def _header(stamp_ns: int, frame_id: str) -> Any:
    return TYPES["std_msgs/msg/Header"](_time(stamp_ns), frame_id)


def _quat(xyzw: Any) -> Any:
    return TYPES["geometry_msgs/msg/Quaternion"](*map(float, xyzw))


def _vector(xyz: Any, kind: str = "Vector3") -> Any:
    return TYPES[f"geometry_msgs/msg/{kind}"](*map(float, xyz))


def _assert_same_bytes(rows: Rows, expected: list[Any]) -> None:
    assert rows.size == len(expected)
    for row, message in zip(rows, expected, strict=True):
        assert row.tobytes() == bytes(STORE.serialize_cdr(message, message.__msgtype__))


@pytest.mark.parametrize("frame_id", ["", "l", "laser", "base_footprint"])
@pytest.mark.parametrize("intensities", [False, True])
@pytest.mark.parametrize("beams", [1, 90, 91])
def test_laser_scan_bytes(frame_id: str, intensities: bool, beams: int) -> None:
    rng = np.random.default_rng(beams)
    stamps = np.array([0, 1, 2_000_000_001])
    numbers = rng.uniform(0.1, 1.0, (2, 7))
    ranges, strengths = rng.uniform(0.1, 9.0, (2, 3, beams)).astype(np.float32)
    layouts = tuple(ScanLayout(*row) for row in numbers.tolist())
    which = np.array([1, 0, 1], dtype=np.int32)
    scans = RawScans("/scan", (frame_id,), stamps, None, layouts, which, ranges)
    scans = replace(scans, intensities=strengths if intensities else None)
    empty = np.zeros(0, dtype=np.float32)
    expected = [
        TYPES["sensor_msgs/msg/LaserScan"](
            _header(int(stamps[i]), frame_id),
            *numbers[which[i]],
            ranges[i],
            strengths[i] if intensities else empty,
        )
        for i in range(3)
    ]

    (stream,) = outgoing(Recording("r", "memory", streams=(scans,)))

    _assert_same_bytes(stream.rows(np.arange(3)), expected)


@pytest.mark.parametrize("oriented", [False, True])
def test_imu_bytes(oriented: bool) -> None:
    rng = np.random.default_rng(3)
    stamps, quats = np.arange(4) * 700_000_000, xyzw_from_yaw(rng.normal(size=4))
    rates, forces = rng.normal(size=(2, 4, 3))
    imu = RawImu("/imu", ("imu_link",), stamps, None, rates, forces, quats if oriented else None)
    none = np.array([0.0 if oriented else -1.0, *[0.0] * 8])
    expected = [
        TYPES["sensor_msgs/msg/Imu"](
            _header(int(stamps[i]), "imu_link"),
            _quat(quats[i] if oriented else (0, 0, 0, 1)),
            none,
            _vector(rates[i]),
            np.diag([0.3] * 3).ravel(),
            _vector(forces[i]),
            np.diag([0.4] * 3).ravel(),
        )
        for i in range(4)
    ]
    covariances = DriveRecorder("r", header(imu_gyro_variance=0.3, imu_accel_variance=0.4))

    stream = stream_messages(imu, covariances.constants["/imu/data"])

    _assert_same_bytes(stream.rows(np.arange(4)), expected)


def test_wheel_message_bytes() -> None:
    rng = np.random.default_rng(1)
    stamps = np.arange(5) * 20_000_000
    ticks = rng.integers(-(2**62), 2**62, (5, 2))
    wheels = RawTicks("/ticks", ("base",), stamps, None, ticks, 2578, 0.035, 0.23)
    expected = [
        TYPES[ENCODER_TICKS](
            _header(int(stamps[i]), "base"), *map(int, ticks[i]), 2578, 0.035, 0.23
        )
        for i in range(5)
    ]
    _assert_same_bytes(stream_messages(wheels).rows(np.arange(5)), expected)
    angles, speeds = rng.normal(size=(2, 5, 2))
    names = "left", "right_wheel"
    joints = RawJoints("/joints", ("",), stamps, None, names, angles, speeds)
    moved = [
        TYPES["sensor_msgs/msg/JointState"](
            _header(int(stamps[i]), ""), list(names), angles[i], speeds[i], np.zeros(0)
        )
        for i in range(5)
    ]
    _assert_same_bytes(stream_messages(joints).rows(np.arange(5)), moved)


def test_pose_message_bytes() -> None:
    rng = np.random.default_rng(2)
    stamps = np.array([-1_500_000_000, 0, 1, 1_234_567_890_123_456_789])
    xyz, linear, angular = rng.normal(size=(3, 4, 3))
    quats = xyzw_from_yaw(rng.normal(size=4))
    frames = ("odom", "base_footprint")
    covariance = np.zeros(36)
    expected = [
        TYPES["nav_msgs/msg/Odometry"](
            _header(int(stamps[i]), frames[0]),
            frames[1],
            TYPES["geometry_msgs/msg/PoseWithCovariance"](
                TYPES["geometry_msgs/msg/Pose"](_vector(xyz[i], "Point"), _quat(quats[i])),
                covariance,
            ),
            TYPES["geometry_msgs/msg/TwistWithCovariance"](
                TYPES["geometry_msgs/msg/Twist"](_vector(linear[i]), _vector(angular[i])),
                covariance,
            ),
        )
        for i in range(4)
    ]
    names = frames[:1], stamps, None, frames[1:]
    odometry = RawOdometry("/odom", *names, xyz, quats, linear, angular)
    _assert_same_bytes(stream_messages(odometry).rows(np.arange(4)), expected)


def test_transform_bytes() -> None:
    rng = np.random.default_rng(4)
    stamps, xyz = np.array([0, 1, 1_234_567_890_123_456_789]), rng.normal(size=(3, 3))
    quats = xyzw_from_yaw(rng.normal(size=3))

    def edge(parent: str, child: str) -> TransformEdge:
        return TransformEdge("/tf", parent, child, False, stamps, None, xyz, quats)

    def transform(i: int, parent: str, child: str) -> Any:
        return TYPES["geometry_msgs/msg/TransformStamped"](
            _header(int(stamps[i]), parent),
            child,
            TYPES["geometry_msgs/msg/Transform"](_vector(xyz[i]), _quat(quats[i])),
        )

    tf = TYPES["tf2_msgs/msg/TFMessage"]
    pairs = [("odom", "a"), ("a", "bcd")]
    for some in (pairs[:1], pairs, []):
        rows = encoded_transforms([edge(*pair) for pair in some], np.arange(3))
        count = 3 if some else 1
        expected = [tf([transform(i, *pair) for pair in some]) for i in range(count)]
        _assert_same_bytes(rows, expected)


def test_small_message_bytes() -> None:
    stamps = np.array([0, 2_000_000_001])
    clock = TYPES["rosgraph_msgs/msg/Clock"]
    shown = outgoing(Recording("r", "memory", clock_ns=np.column_stack([stamps, stamps])))[0]
    _assert_same_bytes(shown.rows(np.arange(2)), [clock(_time(int(t))) for t in stamps])
    twist = TYPES["geometry_msgs/msg/TwistStamped"]
    commands = np.array([[0.5, -0.1], [0.2, 0.7]])
    expected = [
        twist(
            _header(int(t), "base"),
            TYPES["geometry_msgs/msg/Twist"](_vector((v, 0, 0)), _vector((0, 0, w))),
        )
        for t, (v, w) in zip(stamps, commands, strict=True)
    ]
    commanded = stream_messages(RawTwists("/cmd_vel", ("base",), stamps, stamps, commands))
    _assert_same_bytes(commanded.rows(np.arange(2)), expected)
    _assert_same_bytes(text("äöü <robot/>"), [TYPES["std_msgs/msg/String"]("äöü <robot/>")])


def _record(folder: Path, end_s: float = 6.0, window_s: float = 2.0) -> Path:
    with LogWriter(folder, header()) as writer:
        for start_s in np.arange(0.0, end_s, window_s):
            writer.write(readings(start_s, start_s + window_s), drive(start_s, start_s + window_s))
    return folder


def test_log_time_order_sequence_and_counts(tmp_path: Path) -> None:
    folder = _record(tmp_path / "log")
    with (folder / MCAP_NAME).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        everything = list(reader.iter_messages(log_time_order=False))
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(everything)
    log_ns = [message.log_time for _, _, message in everything]
    assert log_ns == sorted(log_ns)
    for channel_id, channel in summary.channels.items():
        mine = [m for _, c, m in everything if c.id == channel_id]
        assert [m.sequence for m in mine] == list(range(len(mine))), channel.topic
        assert summary.statistics.channel_message_counts[channel_id] == len(mine)


def test_rosbags_reads_it_and_the_values_are_the_same(tmp_path: Path) -> None:
    folder = _record(tmp_path / "log")
    whole = readings(0.0, 6.0)
    odometry = wheel_odometry(whole.encoders.stream)
    seen: dict[str, list[Any]] = {}
    with AnyReader([folder]) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            seen.setdefault(connection.topic, []).append((log_ns, message))
    scans = seen["/scan"]
    assert len(scans) == len(whole.scans)
    for (log_ns, message), scan, arrival_ns in zip(
        scans, whole.scans, whole.scans.arrival_ns, strict=True
    ):
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        assert (log_ns, stamp_ns) == (arrival_ns, scan.stamp_ns)
        np.testing.assert_array_equal(message.ranges, scan.ranges_m)
        assert message.time_increment == pytest.approx(15e-6, rel=1e-6)
        assert message.scan_time == pytest.approx(0.1)
    ticks = [(m.left, m.right) for _, m in seen["/encoder_ticks"]]
    np.testing.assert_array_equal(ticks, whole.encoders.stream.ticks)
    poses = [(m.pose.pose.position.x, m.pose.pose.position.y) for _, m in seen["/odom"]]
    np.testing.assert_allclose(poses, odometry.poses[:, :2], atol=1e-9)
    twist = seen["/odom"][-1][1].twist.twist
    assert twist.linear.x == pytest.approx(0.455, abs=0.01)
    assert twist.angular.z == pytest.approx(2.0 * 0.035 / 0.23, abs=0.02)
    assert len(seen["/imu/data"]) == len(whole.imu)
    assert len(seen["/robot_description"]) == len(seen["/tf_static"]) == 1
    truth = seen["/ground_truth/odom"]
    assert truth[0][0] == 0
    assert truth[-1][0] == 6_000_000_000
    assert len(truth) == 721
    assert truth[100][1].twist.twist.linear.x == pytest.approx(0.5)


def test_latched_topics_say_so(tmp_path: Path) -> None:
    folder = _record(tmp_path / "log", end_s=2.0)
    for path in (folder, folder / MCAP_NAME):
        with Reader(path) as reader:
            latched = {
                connection.topic
                for connection in reader.connections
                for qos in connection.ext.offered_qos_profiles  # type: ignore[union-attr]
                if qos.durability == QosDurability.TRANSIENT_LOCAL
            }
        assert latched == {"/tf_static", "/robot_description"}


@given(
    policies=st.tuples(*(st.sampled_from(list(kind)) for kind in POLICIES)),
    depth=st.integers(0, 99),
    named=st.booleans(),
)
def test_quality_of_service_becomes_numbers(
    policies: tuple[Any, ...], depth: int, named: bool
) -> None:
    """As rosbags writes for ROS 2 before Jazzy, from what it writes for any."""
    history, reliability, durability, liveliness = policies
    time = QosTime(9223372036, 854775807)
    quality = [Qos(history, depth, reliability, durability, time, time, liveliness, time, False)]
    text = profiles_text(dump_qos_v9(quality) if named else dump_qos_v8(quality))
    assert parse_qos(text) == quality
    assert all(type(yaml.safe_load(text)[0][key]) is int for key in ("history", "durability"))
    nothing: tuple[Any, ...] = ("", "a: [", "text", [], None, 7)
    assert [profiles_text(each) for each in nothing] == [""] * len(nothing)


def test_same_data_same_bytes_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = _record(tmp_path / "a" / "log")
    monkeypatch.chdir(tmp_path)
    second = _record(Path("elsewhere"))
    for name in (MCAP_NAME, "metadata.yaml"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_the_length_of_windows_only_rounds_odometry(tmp_path: Path) -> None:
    def contents(folder: Path) -> list[tuple[str, int, bytes]]:
        with AnyReader([folder]) as reader:
            everything = [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()]
        return [item for item in everything if item[0] not in ("/odom", "/tf")]

    short = contents(_record(tmp_path / "short", window_s=0.5))
    assert short == contents(_record(tmp_path / "long", window_s=6.0))


def test_messages_that_arrive_late_are_held_back_but_never_lost(tmp_path: Path) -> None:
    first = readings(0.0, 1.0)
    late = replace(first.scans, arrival_ns=first.scans.arrival_ns + 1_500_000_000)
    with LogWriter(tmp_path / "log", header()) as writer:
        writer.write(replace(first, scans=late), drive(0.0, 1.0))
        writer.write(readings(1.0, 2.0), drive(1.0, 2.0))
    with (tmp_path / "log" / MCAP_NAME).open("rb") as stream:
        log_ns = [m.log_time for _, _, m in make_reader(stream).iter_messages(log_time_order=False)]
    assert log_ns == sorted(log_ns)


def test_an_exception_leaves_no_index(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), LogWriter(tmp_path / "log", header()) as writer:
        writer.write(readings(0.0, 1.0), drive(0.0, 1.0))
        raise KeyboardInterrupt
    assert not (tmp_path / "log" / "metadata.yaml").exists()
