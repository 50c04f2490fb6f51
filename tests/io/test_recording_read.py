"""read_recording: what the file says, unchanged, the same from every format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from bag_data import ROS1, ROS2, START_NS, Message, Robot, as_mcap, as_ros1, as_rosbag2
from hypothesis import given
from hypothesis import strategies as st
from log_data import drive, header, readings
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import read_recording
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.ros.message_types import register
from slamsim.io.selection import Selection
from slamsim.recording import Origin, Recording, row_store
from slamsim.recording.row_store import RowStore
from slamsim.simulation.log_writer import LogWriter

ROBOT1, ROBOT2 = Robot(ROS1), Robot(ROS2)
RADISH = Path(__file__).parents[3] / "shared" / "data" / "radish"


def assert_same(one: Recording, other: Recording, but: tuple[str, ...] = ()) -> None:
    """Every field of every stream, nan where nan."""
    for kind in ("scans", "imus", "odometries", "ticks", "joints", "transforms"):
        mine, theirs = getattr(one, kind), getattr(other, kind)
        assert len(mine) == len(theirs), kind
        for a, b in zip(mine, theirs, strict=True):
            for field in fields(a):
                if field.name not in but:
                    _assert_equal(getattr(a, field.name), getattr(b, field.name), field.name)
    assert one.robot_description == other.robot_description
    assert one.epoch == other.epoch


def _assert_equal(one: Any, other: Any, name: str) -> None:
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=name)
    elif isinstance(one, Origin) and isinstance(other, Origin):
        assert one.topic == other.topic
        np.testing.assert_array_equal(one.places, other.places)
    elif name == "origin":
        assert one is None or other is None
    elif isinstance(one, list | row_store.Ragged):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    else:
        assert one == other, name


def _odd_drive(robot: Robot) -> list[Message]:
    """Everything that a reader may be tempted to repair."""
    messages = robot.drive()
    late = START_NS + 2_000_000_000
    messages += [
        ("/front/scan", late, robot.scan(late - 950_000_000, (0.0, np.nan, np.inf, 99.0))),
        ("/front/scan", late + 1, robot.scan(late - 950_000_000, (1, 2, 3), frame="other")),
        ("/front/scan", late + 2, robot.scan(late, (1, 2, 3), range_max=np.nan)),
        ("/tf", late, robot.tf(robot.transform(late, ("odom", "base_footprint"), 1.0))),
        (
            "/tf",
            late + 1,
            robot.tf(
                robot.transform(late + 1, ("map", "odom"), 2.0),
                robot.transform(late + 2, ("odom", "base_footprint"), 3.0),
            ),
        ),
        ("/tf", late + 2, robot.tf(robot.transform(late + 3, ("odom", "base_footprint"), 4.0))),
    ]
    return messages


@pytest.mark.parametrize(
    ("kind", "write"),
    [
        ("rosbag2", lambda path: as_rosbag2(path / "a", _odd_drive(ROBOT2))),
        (
            "rosbag2",
            lambda path: as_rosbag2(path / "b", _odd_drive(ROBOT2), StoragePlugin.MCAP),
        ),
        ("mcap", lambda path: as_mcap(path / "c.mcap", _odd_drive(ROBOT2), chunk_size=700)),
        ("rosbag1", lambda path: as_ros1(path / "d.bag", _odd_drive(ROBOT1))),
    ],
)
def test_nothing_is_repaired_in_any_format(
    kind: str, write: Callable[[Path], Path], tmp_path: Path
) -> None:
    found = read_recording(write(tmp_path))
    assert found.format == kind and found.epoch == "unix"
    (scans,) = found.scans
    assert scans.frame_ids == ("laser", "other")
    assert len(scans) == 15 and len(scans.ranges_m) == 15
    assert [row.size for row in scans.ranges_m] == [3] * 12 + [4, 3, 3]
    np.testing.assert_array_equal(scans.ranges_m[12], np.array([0.0, np.nan, np.inf, 99.0], "f4"))
    assert int(np.diff(scans.stamps_ns)[11]) < 0 and int(np.diff(scans.stamps_ns)[12]) == 0
    assert scans.received_ns is not None
    np.testing.assert_array_equal(scans.received_ns[:12] - scans.stamps_ns[:12], 5_000_000)
    assert np.isnan(scans.layout(14).range_max_m) and scans.layout(0).range_max_m == 20.0
    assert scans.layout(13).angle_step_rad == 0.5
    (imu,) = found.imus
    np.testing.assert_allclose(imu.angular_velocity_rad_s[:, 2], 0.1 * np.arange(60))
    assert imu.orientation_xyzw is not None
    (odometry,) = found.odometries
    assert odometry.child_frame_ids == ("base_footprint",)
    edges = {edge.name: edge for edge in found.transforms}
    assert edges["base_link -> laser"].is_static
    moving = edges["odom -> base_footprint"]
    np.testing.assert_array_equal(moving.positions_m[:, 0], [1.0, 3.0, 4.0])
    assert not moving.is_static and edges["map -> odom"].stamps_ns.size == 1
    assert found.anomalies == ()


def test_a_bag_from_before_2011_has_headers_of_another_package(tmp_path: Path) -> None:
    new = as_ros1(tmp_path / "new.bag", ROBOT1.drive())
    old = as_ros1(tmp_path / "old.bag", ROBOT1.drive(), header="roslib/Header")
    found = read_recording(old)
    assert_same(found, read_recording(new))
    assert found.unread == ()
    copy_recording(old, found, found, tmp_path / "fixed")
    (copied,) = (tmp_path / "fixed").glob("*.bag")
    assert_same(read_recording(copied), found)


def test_a_header_of_a_package_with_a_like_name_stays_its_own() -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    text = f"acme_roslib/Header header\n{'=' * 80}\nMSG: acme_roslib/Header\nfloat64 more\n"
    register(store, "acme_msgs/msg/Thing", "ros1msg", text)
    assert [name for name, _ in store.fielddefs["acme_roslib/msg/Header"][1]] == ["more"]


def test_our_own_file_comes_back_without_its_truth(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log", header()) as writer:
        writer.write(readings(0.0, 4.0, intensities=True), drive(0.0, 4.0))
    found = read_recording(tmp_path)
    made = readings(0.0, 4.0, intensities=True)
    (scans,), (imu,), (ticks,) = found.scans, found.imus, found.ticks
    np.testing.assert_array_equal(scans.ranges_m, made.scans.ranges_m)
    assert scans.intensities is not None and made.scans.intensities is not None
    np.testing.assert_array_equal(scans.intensities, made.scans.intensities)
    np.testing.assert_array_equal(scans.received_ns, made.scans.arrival_ns)
    np.testing.assert_array_equal(imu.stamps_ns, made.imu.stream.stamps_ns)
    assert imu.orientation_xyzw is None
    np.testing.assert_array_equal(ticks.ticks, made.encoders.stream.ticks)
    assert found.joints[0].names == ("wheel_left_joint", "wheel_right_joint")
    assert [stream.topic for stream in found.odometries] == ["/odom"]
    assert found.clock_ns is not None and found.clock_ns.shape[1] == 2
    assert found.epoch == "simulation" and found.robot_description == "<robot name='r'/>"
    everything = repr(found.unread) + repr([edge.name for edge in found.transforms])
    assert "truth" not in everything


def test_of_two_lidars_both_are_read_or_the_one_that_is_wanted(tmp_path: Path) -> None:
    messages = [*ROBOT2.scans(), ("/rear/scan", START_NS, ROBOT2.scan(START_NS))]
    path = as_mcap(tmp_path / "two.mcap", messages)
    assert [scans.topic for scans in read_recording(path).scans] == ["/front/scan", "/rear/scan"]
    chosen = read_recording(path, Selection(("rear/scan",)))
    assert [scans.topic for scans in chosen.scans] == ["/rear/scan"]
    with pytest.raises(OverrideRefused, match="/front/scan"):
        read_recording(path, Selection(("/none",)))


@given(st.lists(st.tuples(st.sampled_from("ab"), st.sampled_from("xyz")), max_size=12))
def test_joint_states_of_several_publishers_are_put_together(
    tmp_path_factory: pytest.TempPathFactory, named: list[tuple[str, str]]
) -> None:
    """Against a plain table: one row a message, nan where a message does not name the joint."""
    kind = ROS2.types["sensor_msgs/msg/JointState"]
    messages, table = [], []
    for i, names in enumerate(named):
        positions = np.array([10.0 * i, 10.0 * i + 1])
        state = kind(
            ROBOT2.header(START_NS + i, ""), list(names), positions, np.zeros(0), np.zeros(0)
        )
        messages.append(("/joint_states", START_NS + i, state))
        table.append(dict(zip(names, positions, strict=True)))
    messages.append(("/imu", START_NS, ROBOT2.imu(START_NS, 0.0)))
    path = tmp_path_factory.mktemp("joints") / "j.mcap"
    found = read_recording(as_mcap(path, messages))
    if not named:
        assert found.joints == ()
        return
    (joints,) = found.joints
    assert set(joints.names) == {name for names in named for name in names}
    for row, expected in zip(joints.positions_rad, table, strict=True):
        for name, value in zip(joints.names, row, strict=True):
            assert value == expected[name] if name in expected else np.isnan(value)
    assert np.isnan(joints.velocities_rad_s).all()


@given(
    lengths=st.lists(st.integers(0, 5), max_size=20),
    limit=st.integers(0, 200),
    cut=st.integers(1, 4),
)
def test_rows_on_the_disk_are_the_rows_in_memory(lengths: list[int], limit: int, cut: int) -> None:
    rng = np.random.default_rng(len(lengths))
    rows = [rng.normal(size=length).astype(np.float32) for length in lengths]
    store = RowStore(limit)
    for row in rows:
        store.add(row[None])
    found = store.rows()
    assert len(found) == len(rows)
    for i, row in enumerate(rows):
        np.testing.assert_array_equal(found[i], row)
    for a, b in zip(found[cut:], rows[cut:], strict=True):
        np.testing.assert_array_equal(a, b)


def test_long_recordings_keep_their_ranges_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = as_mcap(tmp_path / "d.mcap", ROBOT2.drive())
    in_memory = read_recording(path)
    monkeypatch.setattr(row_store.RowStore.__init__, "__defaults__", (16,))
    on_disk = read_recording(path)
    assert isinstance(on_disk.scans[0].ranges_m, np.memmap)
    assert_same(in_memory, on_disk)


def test_a_damaged_message_costs_a_line_and_no_more(tmp_path: Path) -> None:
    """Whole by every checksum, and yet no message: what a broken publisher writes."""

    source = as_mcap(tmp_path / "good.mcap", ROBOT2.drive())
    path = tmp_path / "bad.mcap"
    with source.open("rb") as stream, path.open("wb") as target:
        reader, writer = make_reader(stream), Writer(target)
        writer.start(profile="ros2")
        ids: dict[str, int] = {}
        count = 0
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.topic not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            data = message.data
            count += channel.topic == "/front/scan"
            if channel.topic == "/front/scan" and count in (3, 7):
                data = data[:30]
            if channel.topic == "/imu":
                data = b"\x00\x01\x00\x00nothing of the kind"
            writer.add_message(ids[channel.topic], message.log_time, data, message.log_time)
        writer.finish()  # type: ignore[no-untyped-call]
    found = read_recording(path)
    assert len(found.scans[0]) == 10 and found.imus == ()
    assert any("/front/scan: 2 of 12 messages" in words for words in found.anomalies)
    assert [(u.topic, u.messages) for u in found.unread] == [("/imu", 60)]


def test_a_type_without_the_fields_of_its_name_is_given_up(tmp_path: Path) -> None:

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("string data", "sensor_msgs/msg/Imu"))
    false_imu = store.types["sensor_msgs/msg/Imu"]("hello")

    path = tmp_path / "false.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for name, text, data in (
            (
                "sensor_msgs/msg/Imu",
                "string data",
                bytes(store.serialize_cdr(false_imu, "sensor_msgs/msg/Imu")),
            ),
            (
                "sensor_msgs/msg/LaserScan",
                ROS2.generate_msgdef("sensor_msgs/msg/LaserScan", ros_version=2)[0],
                bytes(ROS2.serialize_cdr(ROBOT2.scan(START_NS), "sensor_msgs/msg/LaserScan")),
            ),
        ):
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channel = writer.register_channel(f"/{name[-3:]}", "cdr", schema)
            writer.add_message(channel, START_NS, data, START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    found = read_recording(path)
    assert len(found.scans[0]) == 1 and found.imus == ()
    assert [unread.topic for unread in found.unread] == ["/Imu"]


def test_without_anything_to_check_it_is_refused(tmp_path: Path) -> None:
    kind = ROS2.types["std_msgs/msg/String"]
    path = as_mcap(tmp_path / "chat.mcap", [("/chat", START_NS, kind("hello"))])
    with pytest.raises(InputRefused, match="nothing that could be checked"):
        read_recording(path)
    with pytest.raises(NotFound):
        read_recording(tmp_path / "nowhere.mcap")


def test_tables_written_anew_without_what_describes_them_are_refused_in_words(
    tmp_path: Path,
) -> None:
    """As pandas and polars do; what pyarrow writes anew is read."""
    bag = as_mcap(tmp_path / "a.mcap", ROBOT2.drive())
    with ParquetLog(tmp_path / "tables") as tables:
        tables.write(read_recording(bag))
    for path in (tmp_path / "tables").iterdir():
        pq.write_table(pq.read_table(path), path)
    assert read_recording(tmp_path / "tables").scans
    for path in (tmp_path / "tables").iterdir():
        pq.write_table(pq.read_table(path).replace_schema_metadata(None), path)
    with pytest.raises(InputRefused, match="or as pyarrow does") as refusal:
        read_recording(tmp_path / "tables")
    assert "damaged" not in str(refusal.value)


def _flaser(stamp: str, logged: str, x_m: float) -> str:
    return f"FLASER 3 1.0 2.0 81.9 {x_m + 0.2} 0 0 {x_m} 0 0 {stamp} host {logged}"


def test_carmen_lines_keep_their_order_and_their_logger(tmp_path: Path) -> None:
    path = tmp_path / "made.log"
    lines = [
        _flaser("10.5", "0.51", 0.0),
        _flaser("10.3", "0.60", 0.1),
        "ODOM 0 0 0 0.3 0.1 0.0 10.4 host 0.55",
        _flaser("10.7", "0.75", 0.2),
    ]
    path.write_text("\n".join(lines) + "\n")
    found = read_recording(path)
    (scans,), (odometry,) = found.scans, found.odometries
    assert scans.stamps_ns.tolist() == [10_500_000_000, 10_300_000_000, 10_700_000_000]
    assert scans.received_ns is not None
    assert np.diff(scans.received_ns).tolist() == [90_000_000, 150_000_000]
    assert int((scans.received_ns - scans.stamps_ns).min()) == 0
    assert float(np.asarray(scans.ranges_m)[0, 2]) == pytest.approx(81.9)
    assert odometry.topic == "FLASER" and odometry.positions_m[:, 0].tolist() == [0.0, 0.1, 0.2]
    (mount,) = found.transforms
    assert mount.name == "base_link -> flaser" and mount.positions_m[0, 0] == pytest.approx(0.2)
    assert [unread.topic for unread in found.unread] == ["ODOM"]


@pytest.mark.long
@pytest.mark.skipif(not RADISH.is_dir(), reason="the Radish logs are not at ../shared/data/radish")
def test_intel_has_the_stamps_that_it_is_known_for() -> None:
    found = read_recording(RADISH / "intel" / "intel.clf.bz2")
    (scans,) = found.scans
    assert np.asarray(scans.ranges_m).shape == (13631, 180)
    assert int((np.diff(scans.stamps_ns) < 0).sum()) == 631
