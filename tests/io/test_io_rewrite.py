"""Copies of foreign recordings: what an edit does not touch comes back byte for byte."""

from __future__ import annotations

import functools
import json
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import astuple, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_data import ROS1, Robot, as_ros1
from foreign_bags import (
    KINDS,
    START_NS,
    UNMODELLED,
    Author,
    Sent,
    drive,
    offered_in_numbers,
    sent,
    store_of,
    write,
)
from mcap.reader import make_reader
from recording_data import recording
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag1
from rosbags.rosbag2 import Reader as Reader2
from typed import typed

from slamsim.core.types import BoolArray
from slamsim.guard.errors import SlamsimError
from slamsim.io.copy.recording import Lossy, copy_recording, require_lossless
from slamsim.io.open import read_recording
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.recording.edits.messages import select
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import bundled_faults, injected

STORES = {kind: store_of(kind) for kind in KINDS}
_MODELLED = {
    "sensor_msgs/msg/LaserScan": (
        *("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"),
        *("range_min", "range_max", "ranges", "intensities"),
    ),
    "sensor_msgs/msg/Imu": (
        *("orientation.", "angular_velocity.", "linear_acceleration.", "orientation_covariance"),
    ),
    "nav_msgs/msg/Odometry": ("child_frame_id", "pose.pose.", "twist.twist."),
    "sensor_msgs/msg/JointState": ("position", "velocity"),
    "slamsim_msgs/msg/EncoderTicks": (
        *("left", "right", "ticks_per_revolution", "wheel_radius_m", "track_m"),
    ),
    "geometry_msgs/msg/TransformStamped": ("child_frame_id", "transform."),
    "std_msgs/msg/String": ("data",),
}
"""What a ``Recording`` holds of each type; everything else must never change."""
_ALWAYS = ("header.stamp.", "header.frame_id")


def _path_of(folder: Path) -> Path:
    return next(folder.glob("*.bag"), folder)


def _content(path: Path) -> dict[str, list[Sent]]:
    """By topic, as the readers of others give them."""
    found = defaultdict[str, list[Sent]](list)
    if path.suffix == ".mcap":
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                name = "" if schema is None else schema.name
                each = Sent(channel.topic, 0, message.log_time, name, message.data)
                found[channel.topic].append(each)
        return dict(found)
    if path.is_dir() and (path / "log_0.mcap").is_file():
        return _content(path / "log_0.mcap")
    with AnyReader([path]) as reader:
        for connection, log_ns, data in reader.messages():
            each = Sent(connection.topic, 0, log_ns, connection.msgtype, bytes(data))
            found[connection.topic].append(each)
    return dict(found)


def _foreign(kind: str, folder: Path, seed: int, seconds: float = 1.5) -> Path:
    store = STORES[kind]
    messages = list(sent(kind, store, drive(store, seed, seconds)))
    return write(kind, folder / "foreign", messages, store)


@pytest.mark.parametrize("kind", KINDS)
def test_a_plain_copy_has_every_message_of_every_topic(kind: str, tmp_path: Path) -> None:
    path = _foreign(kind, tmp_path, 1)
    read = read_recording(path)

    copied = copy_recording(path, read, read, tmp_path / "copy")

    before, after = _content(path), _content(_path_of(tmp_path / "copy"))
    assert before.keys() == after.keys() >= UNMODELLED.keys()
    assert before == after
    assert copied.changed == ()
    assert {topic for topic, _, _ in copied.unchanged} == before.keys()


@pytest.mark.slow
def test_two_hundred_plain_copies(tmp_path: Path) -> None:
    for seed in range(200):
        kind, folder = KINDS[seed % len(KINDS)], tmp_path / str(seed)
        folder.mkdir()
        path = _foreign(kind, folder, 1000 + seed, seconds=1.0)
        read = read_recording(path)
        copy_recording(path, read, read, folder / "copy")
        assert _content(path) == _content(_path_of(folder / "copy")), seed


def test_an_mcap_copy_keeps_what_stands_beside_the_messages(tmp_path: Path) -> None:
    path = _foreign("mcap", tmp_path, 2)
    read = read_recording(path)
    copy_recording(path, read, read, tmp_path / "copy")

    def told(file: Path) -> Any:
        with file.open("rb") as stream:
            reader = make_reader(stream)
            publishers = Counter(
                (c.topic, c.message_encoding, tuple(c.metadata.items()), s and (s.name, s.data))
                for s, c, _ in reader.iter_messages()
            )
            numbers = [
                (m.log_time, m.publish_time, m.sequence) for _, _, m in reader.iter_messages()
            ]
            attached = list(reader.iter_attachments())
            metadata = [(m.name, m.metadata) for m in reader.iter_metadata()]
            return publishers, numbers, attached, metadata, reader.get_header().profile

    before, after = told(path), told(tmp_path / "copy" / "log_0.mcap")
    assert before == after
    assert before[2][0].data == b"\x00 bytes \xff" and len(before[3]) == 2


def test_a_rosbag2_copy_keeps_quality_of_service_and_custom_data(tmp_path: Path) -> None:
    for kind in ("rosbag2_mcap", "rosbag2_sqlite"):
        (tmp_path / kind).mkdir()
        path = _foreign(kind, tmp_path / kind, 3)
        read = read_recording(path)
        copy_recording(path, read, read, tmp_path / kind / "copy")

        with Reader2(path) as one, Reader2(tmp_path / kind / "copy") as other:
            offered = [
                [(c.topic, c.msgtype, c.digest, str(c.ext)) for c in r.connections]
                for r in (one, other)
            ]
            assert sorted(offered[0]) == sorted(offered[1]) and "depth=7" in offered[0][0][3]
        text = (tmp_path / kind / "copy" / "metadata.yaml").read_text()
        information = yaml.safe_load(text)["rosbag2_bagfile_information"]
        assert information["custom_data"] == {"operator": "somebody else"}
        assert information["ros_distro"] == "rosbags"
        assert offered_in_numbers(tmp_path / kind / "copy")  # although it was written as Jazzy does


def test_a_ros1_copy_keeps_callers_latching_and_sequence_numbers(tmp_path: Path) -> None:
    path = _foreign("rosbag1", tmp_path, 4, seconds=2.5)
    read = read_recording(path)
    fixed = apply_repairs(read, [Repair("shift_stamps", "/scan", {"offset_s": -0.02})])
    copy_recording(path, read, fixed, tmp_path / "copy")

    with AnyReader([path]) as one, AnyReader([tmp_path / "copy" / path.name]) as other:
        said = [
            {(c.topic, c.digest, c.msgdef.data, c.ext) for c in r.connections} for r in (one, other)
        ]
        assert said[0] == said[1] and {c.ext for c in one.connections if c.topic == "/odom"} == {
            ConnectionExtRosbag1("/node_0", None),
            ConnectionExtRosbag1("/node_1", None),
        }
        scans: list[Any] = [
            [r.deserialize(d, c.msgtype) for c, _, d in r.messages() if c.topic == "/scan"]
            for r in (one, other)
        ]
        numbers = [[scan.header.seq for scan in each] for each in scans]
        assert numbers[0] == numbers[1] and len(set(numbers[0])) > 20
    assert len(read_recording(tmp_path / "copy").scans[0]) == len(read.scans[0])


def _leaves(value: Any, place: str = "") -> list[tuple[str, bytes]]:
    """(path, bytes) of everything that a message says."""
    if is_dataclass(value):
        found = []
        for field in fields(value):
            if field.name != "__msgtype__":
                found += _leaves(getattr(value, field.name), f"{place}{field.name}.")
        return found
    if isinstance(value, list):
        return [leaf for i, each in enumerate(value) for leaf in _leaves(each, f"{place}{i}.")]
    data = value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
    return [(place[:-1], data)]


def _unmodelled(message: Any) -> tuple[tuple[str, bytes], ...]:
    """What a ``Recording`` does not hold of a message."""
    known = (*_ALWAYS, *_MODELLED[message.__msgtype__])
    found = []
    for place, data in _leaves(message):
        if place == "orientation_covariance":  # its first number alone is modelled
            data = data[8:]  # noqa: PLW2901
        elif place.startswith(known):
            continue
        found.append((place, data))
    return tuple(found)


def _but_stamp(topic: str, each: Sent) -> Sent:
    """The copy of the scans has their stamps, and is restamped with them."""
    if topic != "/scan_copy/points":
        return each
    return replace(each, data=each.data[:4] + each.data[12:])


@functools.cache
def _unmodelled_parts(kind: str, type_name: str, data: bytes) -> tuple[object, ...]:
    """Of each part of a message. Most messages of a copy are those of its source, byte for byte."""
    return tuple(_unmodelled(part) for part in _parts(kind, type_name, data))


def _parts(kind: str, type_name: str, data: bytes) -> list[Any]:
    store = STORES[kind]
    decode = store.deserialize_ros1 if kind == "rosbag1" else store.deserialize_cdr
    message = decode(data, type_name)
    return list(getattr(message, "transforms", [message]))


def _assert_only_modelled_fields_changed(
    kind: str, before: dict[str, list[Sent]], after: dict[str, list[Sent]], made: bool
) -> None:
    """Topics that are not modelled are byte-equal; of the others only what is modelled differs.

    made: whether transforms that no message held were added.
    """
    for topic, messages in after.items():
        source = before.get(topic) or before.get(topic.removesuffix("_2"))
        if source is None:
            assert made and topic in ("/tf", "/tf_static"), topic
            continue
        if topic in UNMODELLED or topic in ("/protobuf", "/bare"):
            assert [_but_stamp(topic, m) for m in messages] == [
                _but_stamp(topic, m) for m in source
            ]
            continue
        there = {
            part for each in source for part in _unmodelled_parts(kind, each.type_name, each.data)
        }
        for each in messages:
            for same in _unmodelled_parts(kind, each.type_name, each.data):
                if not (made and topic in ("/tf", "/tf_static")):
                    assert same in there, (topic, same)
    assert before.keys() - after.keys() <= {"/tf", "/tf_static"}


def _assert_says(found: Recording, wanted: Recording) -> None:
    """Every modelled number, to the last bit that a message holds."""
    for name in ("scans", "imus", "odometries", "ticks", "joints"):
        by_topic = {stream.topic: stream for stream in getattr(found, name)}
        streams = [stream for stream in getattr(wanted, name) if len(stream)]
        assert by_topic.keys() == {stream.topic for stream in streams}
        for stream in streams:
            _assert_rows(by_topic[stream.topic], _as_read(stream))
    edges = defaultdict[tuple[str, str, str], list[Any]](list)
    for edge in wanted.transforms:
        if edge.stamps_ns.size:
            edges[edge.topic, edge.parent, edge.child].append(edge)
    assert {(e.topic, e.parent, e.child) for e in found.transforms} == edges.keys()
    for edge in found.transforms:
        twins = edges[edge.topic, edge.parent, edge.child]
        if len(twins) == 1:
            _assert_rows(edge, twins[0])
    assert found.robot_description == wanted.robot_description


def _as_read(stream: Any) -> Any:
    """Intensities of another number than the ranges are counted and left out."""
    if getattr(stream, "intensities", None) is None:
        return stream
    fits = len(stream.intensities[0]) == len(stream.ranges_m[0])
    return stream if fits else replace(stream, intensities=None, other_intensities=len(stream))


def _assert_rows(found: Any, wanted: Any) -> None:
    for field in fields(wanted):
        one, other = getattr(found, field.name), getattr(wanted, field.name)
        if field.name in ("origin", "samples", "received_ns", "layouts", "layout_of"):
            continue
        if isinstance(other, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=f"{wanted.topic} {field.name}")
        elif field.name not in ("frame_ids", "child_frame_ids") or len(other) == 1:
            assert one == other, field.name
    if hasattr(wanted, "layouts"):
        for i in range(len(wanted)):
            one, other = (np.array(astuple(s.layout(i)), dtype=np.float32) for s in (found, wanted))
            np.testing.assert_array_equal(one, other)


Foreign = tuple[str, Path, Recording, dict[str, list[Sent]]]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Foreign]:
    """Of each kind one recording, what is read of it, and its messages."""
    made: dict[str, Foreign] = {}

    def one(kind: str) -> Foreign:
        if kind not in made:
            path = _foreign(kind, tmp_path_factory.mktemp(kind), 11, seconds=1.5)
            made[kind] = kind, path, read_recording(path), _content(path)
        return made[kind]

    return one


def _assert_copy_is(foreign: Foreign, edited: Recording, folder: Path) -> None:
    kind, path, read, before = foreign
    copy_recording(path, read, edited, folder)
    made = any(edge.origin is None for edge in edited.transforms)
    after = _content(_path_of(folder))
    _assert_only_modelled_fields_changed(kind, before, after, made)
    _assert_says(read_recording(folder), edited)


def _with_fault(read: Recording, fault: Fault) -> Recording | None:
    try:
        return injected(read, [fault], seed=1)
    except CannotEdit:
        return None


FAULTS = bundled_faults()


@pytest.mark.parametrize("number", range(len(FAULTS)), ids=[fault.name for fault in FAULTS])
def test_a_fault_changes_what_it_says_and_nothing_else(
    number: int, foreign: Callable[[str], Foreign], tmp_path: Path
) -> None:
    one = foreign(KINDS[number % len(KINDS)])
    edited = _with_fault(one[2], FAULTS[number])
    if edited is None:
        pytest.skip("nothing to corrupt so")
    if edited.scans[0].stamps_ns.max() > 2**31 * 10**9:
        with pytest.raises(SlamsimError, match=r"cannot be written: .* counts from"):
            copy_recording(one[1], one[2], edited, tmp_path / "copy")
        return
    _assert_copy_is(one, edited, tmp_path / "copy")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_fault_in_every_format(
    kind: str, foreign: Callable[[str], Foreign], tmp_path: Path
) -> None:
    one = foreign(kind)
    copied = 0
    for fault in FAULTS:
        edited = _with_fault(one[2], fault)
        if edited is not None and edited.scans[0].stamps_ns.max() < 2**31 * 10**9:
            _assert_copy_is(one, edited, tmp_path / fault.name)
            copied += 1
    assert copied > len(FAULTS) // 2


REPAIRS = (
    Repair("reorder", "/scan"),
    Repair("shift_stamps", "/scan", {"offset_s": 0.25}),
    Repair("shift_stamps", "/odom", {"offset_s": -1.5}),
    Repair("rescale_stamps", "/imu", {"drift_ppm": 500.0, "origin_ns": float(START_NS)}),
    Repair("restamp_evenly", "/imu"),
    Repair("stamp_by_receipt", "/scan"),
    Repair("shift_receipt", "/scan", {"offset_s": 0.31}),
    Repair("shift_receipt", "/odom", {"offset_s": -0.31}),
    Repair("value_to_inf", "/scan", {"value_m": 3.0}),
    Repair("scale_ranges", "/scan", {"factor": 0.001}),
    Repair("add_to_ranges", "/scan", {"offset_m": 0.03}),
    Repair("drop_beams", "/scan", {"first": 3, "last": 5}),
    Repair("set_angle_max", "/scan"),
    Repair("set_range_limits", "/scan", {"range_min_m": 0.01, "range_max_m": 40.0}),
    Repair("scale_angles", "/scan", {"factor": 1.01}),
    Repair("negate_angles", "/scan"),
    Repair("scale_beam_times", "/scan", {"factor": -0.5}),
    Repair("set_sweep", "/scan", {"sweep_s": 0.05}),
    Repair("turn_with_robot", "/scan", {"heading_from": "/odom"}),
    Repair("scale_acceleration", "/imu", {"factor": 9.81}),
    Repair("rotate_imu", "/imu", {"up_x": 0.1, "up_y": 0.0, "up_z": 0.99}),
    Repair("scale_gyro", "/imu", {"factor": -1.0}),
    Repair("subtract_gyro_bias", "/imu", {"bias_rad_s": 0.01}),
    Repair("normalise_rotations", "/odom"),
    Repair("drop_broken_poses", "/odom"),
    Repair("drop_broken_readings", "/imu"),
    Repair("drop_orientation", "/imu"),
    Repair("scale_wheels", "/ticks", {"radius_factor": 1.1, "track_factor": 0.9}),
    Repair("swap_wheels", "/ticks"),
    Repair("reverse_wheel", "/ticks", {"wheel": "left"}),
    Repair("odometry_from_ticks", "/odom"),
    Repair("scale_odometry", "/odom", {"path_factor": 1.1, "turn_factor": 0.9}),
    Repair("add_odometry_transform", "/odom"),
    Repair("drop_transform", "base_link -> arm"),
    Repair("freeze_static_transform", "base_link -> laser"),
    Repair("rename_frame", "/scan", {"frame": "lidar_link"}),
    Repair("turn_frame", "laser", {"roll_rad": 3.14, "pitch_rad": 0.0, "yaw_rad": 0.1}),
    Repair("set_mounting", "laser", {"x_m": 0.3, "y_m": 0.1, "yaw_rad": 1.0}),
    Repair("set_mounting", "arm", {"x_m": 0.3, "y_m": 0.1, "yaw_rad": 1.0}),
)


@pytest.mark.parametrize("number", range(len(REPAIRS)))
def test_a_repair_changes_what_it_says_and_nothing_else(
    number: int, foreign: Callable[[str], Foreign], tmp_path: Path
) -> None:
    one = foreign(KINDS[number % len(KINDS)])
    _assert_copy_is(one, apply_repairs(one[2], [REPAIRS[number]]), tmp_path / "copy")


def test_dropped_messages_leave_the_others_of_their_topic_as_they_were(
    foreign: Callable[[str], Foreign], tmp_path: Path
) -> None:
    _, path, read, before = foreign("mcap")
    left: BoolArray = np.arange(len(read.odometries[0])) % 3 > 0
    fewer = read.with_streams(RawOdometry, (select(read.odometries[0], left),))
    copy_recording(path, read, fewer, tmp_path / "copy")
    after = _content(tmp_path / "copy")
    assert after["/odom"] == [
        each for each, stays in zip(before["/odom"], left, strict=True) if stays
    ]
    assert {t: m for t, m in after.items() if t != "/odom"} == {
        t: m for t, m in before.items() if t != "/odom"
    }


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def test_a_topic_made_from_a_stream_is_restamped_with_it(tmp_path: Path) -> None:
    """/scan_copy/points carries the stamps of /scan; the camera's stamps are its own."""
    for kind in ("mcap", "rosbag1"):
        (tmp_path / f"of {kind}").mkdir()
        path = _foreign(kind, tmp_path / f"of {kind}", 11, seconds=2.5)
        read, before = read_recording(path), _content(path)
        late = apply_repairs(read, [Repair("shift_stamps", "/scan", {"offset_s": 0.5})])
        copied = copy_recording(path, read, late, tmp_path / kind)
        assert copied.restamped == (("/scan_copy/points", "/scan"),)
        assert set(copied.not_restamped) == {"/camera/image", "/diagnostics"}
        after = _content(_path_of(tmp_path / kind))
        for one, other in zip(before["/scan_copy/points"], after["/scan_copy/points"], strict=True):
            (part,), (moved,) = (_parts(kind, each.type_name, each.data) for each in (one, other))
            assert _stamp_ns(moved) - _stamp_ns(part) == 500_000_000
            assert one.data[12:] == other.data[12:] and one.log_ns == other.log_ns
        assert after["/camera/image"] == before["/camera/image"]


def test_streams_on_one_even_tick_do_not_prove_that_one_was_made_from_the_other(
    tmp_path: Path,
) -> None:
    """A simulator stamps all its sensors on the ticks of its physics."""
    store = STORES["mcap"]
    author, messages = Author(store, 5), list[tuple[str, int, int, Any]]()
    for i in range(60):
        t = START_NS + round(i * 48e9 / 240)
        messages.append(("/scan", 0, t, author.scan(t, 20)))
        messages.append(("/odom", 0, t, author.odometry(t, 0.1 * i, 0.0)))
        if i % 2 == 0:
            points = author.stamped("sensor_msgs/msg/PointCloud2", t, "camera")
            messages.append(("/points", 0, t, points))
    path = write("mcap", tmp_path / "ticking", list(sent("mcap", store, messages)), store)
    read = read_recording(path)
    late = apply_repairs(read, [Repair("shift_stamps", "/scan", {"offset_s": 0.5})])
    copied = copy_recording(path, read, late, tmp_path / "copy")
    assert copied.restamped == () and copied.not_restamped == ("/points",)


def test_messages_that_cannot_be_decoded_are_copied_as_they_are(tmp_path: Path) -> None:
    store = STORES["mcap"]
    messages = list(sent("mcap", store, drive(store, 6, 1.0)))
    broken = [i for i, each in enumerate(messages) if each.topic == "/imu"][5:9]
    for i in broken:
        messages[i] = replace(messages[i], data=messages[i].data[:17])
    path = write("mcap", tmp_path / "broken", messages, store)
    read = read_recording(path)
    assert len(read.imus[0]) == 21
    fixed = apply_repairs(read, [Repair("scale_gyro", "/imu", {"factor": 2.0})])
    copy_recording(path, read, fixed, tmp_path / "copy")
    before, after = (_content(each)["/imu"] for each in (path, tmp_path / "copy"))
    same = [one == other for one, other in zip(before, after, strict=True)]
    assert same.count(True) == 4
    np.testing.assert_array_equal(
        read_recording(tmp_path / "copy").imus[0].angular_velocity_rad_s,
        2.0 * read.imus[0].angular_velocity_rad_s,
    )


def test_a_stamp_that_the_format_cannot_hold_is_refused(
    foreign: Callable[[str], Foreign], tmp_path: Path
) -> None:
    for kind, format_name in (("rosbag1", "ROS 1"), ("mcap", "ROS 2")):
        _, path, read, _ = foreign(kind)
        early = apply_repairs(read, [Repair("shift_stamps", "/scan", {"offset_s": -4e9})])
        with pytest.raises(SlamsimError, match=f"cannot be written: {format_name}"):
            copy_recording(path, read, early, tmp_path / kind)


def test_a_carmen_log_travels_along_whole(tmp_path: Path) -> None:
    line = "FLASER 4 1.0 2.0 3.0 2.5 {0} 0 0 {0} 0 0 {1} host {1}"
    text = "PARAM robot_width 0.5 0 host 0\n# by hand\n" + "\n".join(
        line.format(0.01 * i, 10 + i / 5) for i in range(50)
    )
    path = tmp_path / "made.log"
    path.write_text(text)
    read = read_recording(path)
    copied = copy_recording(path, read, read, tmp_path / "copy")
    assert copied.attached == ("made.log",) and copied.lost == ()
    with (tmp_path / "copy" / "log_0.mcap").open("rb") as stream:
        (attached,) = make_reader(stream).iter_attachments()
    assert (attached.name, attached.data) == ("made.log", text.encode())


def test_what_a_copy_cannot_hold_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "tables"
    with ParquetLog(folder, 0) as tables:
        tables.write(recording(3.0))
    require_lossless(folder)
    (folder / "camera.parquet").write_bytes(b"anything")
    with pytest.raises(Lossy, match=r"camera\.parquet.*--lossy"):
        require_lossless(folder)
    refused = typed("fix", str(folder), "out", "--apply", "none", cwd=tmp_path)
    assert refused.returncode == 1 and not (tmp_path / "out").exists()
    done = typed("fix", str(folder), "out", "--apply", "none", "--lossy", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["copied"]["lost"] == ["camera.parquet"]


def test_fix_with_no_repair_is_a_copy(foreign: Callable[[str], Foreign], tmp_path: Path) -> None:
    _, path, _, before = foreign("rosbag1")
    done = typed("fix", str(path), "out", "--apply", "none", "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert done.returncode == (1 if found["bad"] else 0)
    assert found["applied"] == [] and found["copied"]["changed"] == []
    assert _content(tmp_path / "out" / path.name) == before
    assert read_recording(tmp_path / "out").scans[0].topic == "/scan"


@pytest.mark.parametrize("writer", ["copy", "recover"])
def test_rosbag_can_write_the_header_of_a_bag_anew(writer: str, tmp_path: Path) -> None:
    """As it does when it appends or reindexes: fields and padding of 4096 bytes."""
    bag = as_ros1(tmp_path / "a.bag", Robot(ROS1).drive())
    before = read_recording(bag)
    (tmp_path / "out").mkdir()
    if writer == "copy":
        copy_recording(bag, before, before, tmp_path / "out")
    else:
        recover(damaged_recording(bag), tmp_path / "out")
    written = tmp_path / "out" / "a.bag"
    data = written.read_bytes()
    fields_end = 17 + int.from_bytes(data[13:17], "little")
    padding = 4096 - (fields_end - 17)
    anew = data[:fields_end] + padding.to_bytes(4, "little") + b" " * padding
    assert data.startswith(anew)
    assert len(read_recording(written).scans[0]) == len(before.scans[0])
    with AnyReader([written]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages())
