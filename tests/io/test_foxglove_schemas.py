"""Recordings in Foxglove's own schemas, as its SDK writes them, read as the ROS messages that say
the same."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove import Channel, Context, Schema, open_mcap
from foxglove import messages as sent
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from slamsim.guard.errors import Excessive, InputRefused
from slamsim.io.bag2.metadata import quality_of_service
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import read_recording
from slamsim.io.ros.bag import open_bag
from slamsim.io.ros.foxglove_schemas import translation
from slamsim.io.ros.message_types import ros2_types
from slamsim.recording import Recording

NOW_NS = 1_700_000_000_000_000_000
STAMP = sent.Timestamp(sec=1_700_000_000, nsec=5)
HERE = sent.Pose(position=sent.Vector3(), orientation=sent.Quaternion(w=1.0))
RANGES_M = [1.0, 2.0, math.nan, math.inf]


def mcap_of(path: Path, messages: Iterable[tuple[str, Any]]) -> Path:
    """One message every 100 ms, each (topic, message)."""
    context = Context()
    channels: dict[str, Channel] = {}
    with open_mcap(str(path), context=context):
        for number, (topic, message) in enumerate(messages):
            if topic not in channels:
                schema = type(message).get_schema()
                channels[topic] = Channel(
                    topic, schema=schema, message_encoding="protobuf", context=context
                )
            channels[topic].log(message.encode(), log_time=NOW_NS + 100_000_000 * number)
    return path


def scan(pose: sent.Pose = HERE) -> sent.LaserScan:
    return sent.LaserScan(
        timestamp=STAMP,
        frame_id="laser",
        pose=pose,
        start_angle=-0.3,
        end_angle=0.3,
        ranges=RANGES_M,
        intensities=[5.0, 6.0, 7.0, 8.0],
    )


def transform(child: str, x: float, stamp: sent.Timestamp = STAMP) -> sent.FrameTransform:
    parent = {"base": "odom", "laser": "base"}[child]
    return sent.FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=sent.Vector3(x=x),
        rotation=sent.Quaternion(z=1.0),
    )


def drive() -> list[tuple[str, Any]]:
    odometry = sent.Odometry(
        timestamp=STAMP,
        frame_id="odom",
        body_frame_id="base",
        pose=sent.Pose(
            position=sent.Vector3(x=3.0, y=4.0),
            orientation=sent.Quaternion(z=math.sin(0.2), w=math.cos(0.2)),
        ),
        linear_velocity=sent.Vector3(x=0.5),
        angular_velocity=sent.Vector3(z=0.25),
    )
    mounts = sent.FrameTransforms(transforms=[transform("laser", 0.1)])
    later = sent.Timestamp(sec=1_700_000_001, nsec=0)
    moving = [transform("base", 0.0), transform("base", 1.0, later)]
    return [
        ("/scan", scan()),
        ("/odom", odometry),
        ("/tf", mounts),
        *(("/moving", each) for each in moving),
    ]


def read(path: Path) -> Recording:
    return read_recording(path)


def test_a_drive_is_read_as_the_messages_of_ros_that_say_the_same(tmp_path: Path) -> None:
    recording = read(mcap_of(tmp_path / "a.mcap", drive()))
    (scans,), (odometry,) = recording.scans, recording.odometries
    layout = scans.layouts[0]
    assert scans.stamps_ns.tolist() == [NOW_NS + 5] and scans.received_ns is not None
    assert scans.received_ns.tolist() == [NOW_NS] and scans.frame_ids == ("laser",)
    assert (layout.angle_min_rad, layout.angle_max_rad) == pytest.approx((-0.3, 0.3))
    assert layout.angle_step_rad == pytest.approx(0.2)
    assert layout.range_max_m == math.inf and layout.beam_dt_s == 0.0
    np.testing.assert_array_equal(scans.ranges_m[0], np.array(RANGES_M, np.float32))
    assert scans.intensities is not None and scans.intensities[0].tolist() == [5, 6, 7, 8]
    assert odometry.frame_ids == ("odom",) and odometry.child_frame_ids == ("base",)
    assert odometry.positions_m[0, :2].tolist() == [3.0, 4.0]
    assert odometry.quats_xyzw is not None
    assert odometry.quats_xyzw[0] == pytest.approx([0.0, 0.0, math.sin(0.2), math.cos(0.2)])
    edges = {edge.name: edge for edge in recording.transforms}
    assert edges["base -> laser"].positions_m[0].tolist() == [0.1, 0.0, 0.0]
    assert edges["base -> laser"].quats_xyzw[0].tolist() == [0.0, 0.0, 1.0, 0.0]
    # Foxglove takes the latest transform however old: what never differs is as if latched.
    assert edges["base -> laser"].is_static and not edges["odom -> base"].is_static
    assert edges["odom -> base"].positions_m[:, 0].tolist() == [0.0, 1.0]


def test_a_copy_is_one_of_ros_with_latched_mounts(tmp_path: Path) -> None:
    path = mcap_of(tmp_path / "a.mcap", drive())
    recording = read(path)
    (tmp_path / "copy").mkdir()
    told = copy_recording(path, recording, recording, tmp_path / "copy")
    assert told.translated == ("/moving", "/odom", "/scan", "/tf") and not told.unchanged
    copied = read(tmp_path / "copy")
    np.testing.assert_array_equal(copied.scans[0].ranges_m[0], recording.scans[0].ranges_m[0])
    edges = {edge.name: (edge.topic, edge.is_static) for edge in copied.transforms}
    assert edges == {"base -> laser": ("/tf_static", True), "odom -> base": ("/moving", False)}
    with AnyReader([tmp_path / "copy"]) as others:
        sent_by = {one.topic: one.msgtype for one in others.connections}
        assert all(others.deserialize(data, one.msgtype) for one, _, data in others.messages())
    assert sent_by["/scan"] == "sensor_msgs/msg/LaserScan"
    with open_bag(tmp_path / "copy") as bag:
        assert all(each.encoding == "cdr" for each in bag.source.declarations.values())
        latched = [d for d in bag.source.declarations.values() if d.topic == "/tf_static"]
        assert latched[0].metadata["offered_qos_profiles"] == quality_of_service(latched=True)


def test_a_scan_that_is_turned_in_its_frame_has_turned_angles(tmp_path: Path) -> None:
    turned = sent.Pose(
        position=sent.Vector3(),
        orientation=sent.Quaternion(z=math.sin(0.25), w=math.cos(0.25)),
    )
    recording = read(mcap_of(tmp_path / "a.mcap", [("/scan", scan(turned))]))
    layout = recording.scans[0].layouts[0]
    assert (layout.angle_min_rad, layout.angle_max_rad) == pytest.approx((0.2, 0.8))


def test_what_has_no_place_in_ros_is_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    moved = sent.Pose(position=sent.Vector3(x=0.1), orientation=sent.Quaternion(w=1.0))
    path = mcap_of(tmp_path / "a.mcap", [("/scan", scan()), ("/scan", scan(moved))])
    recording = read(path)
    assert len(recording.scans[0]) == 1
    (anomaly,) = recording.anomalies
    assert "1 of 2 messages" in anomaly and "put that into a transform" in anomaly


def test_what_has_no_place_in_ros_is_left_out_of_a_copy(tmp_path: Path) -> None:
    moved = sent.Pose(position=sent.Vector3(x=0.1), orientation=sent.Quaternion(w=1.0))
    path = mcap_of(tmp_path / "a.mcap", [("/scan", scan()), ("/scan", scan(moved))])
    (tmp_path / "copy").mkdir()
    told = copy_recording(path, read(path), read(path), tmp_path / "copy")
    assert told.lost == ("1 messages of /scan",)
    copied = read(tmp_path / "copy")
    assert len(copied.scans[0]) == 1 and not copied.anomalies


@pytest.mark.parametrize("quaternion", [(0.0, -1.0), (1e-8, 1.0), (0.0, 0.0)])
def test_what_is_not_turned_but_for_rounding_stays(quaternion: tuple[float, float]) -> None:
    x, w = quaternion
    pose = sent.Pose(position=sent.Vector3(x=1e-9), orientation=sent.Quaternion(x=x, w=w))
    fields = [sent.PackedElementField(name="x", offset=0)]
    cloud = sent.PointCloud(
        timestamp=STAMP, frame_id="a", pose=pose, point_stride=4, fields=fields, data=bytes(8)
    )
    laser: Any = translated(scan(pose))
    assert (laser.angle_min, laser.angle_max) == pytest.approx((-0.3, 0.3))
    assert translated(cloud).width == 2


def translated(message: Any) -> Any:
    schema = message.get_schema()
    turn = translation(schema.name, "protobuf", schema.data)
    assert turn is not None
    return ros2_types().deserialize_cdr(turn.cdr(message.encode()), turn.type_name)


def test_files_of_a_schema_may_come_in_any_order() -> None:
    """Writers in C++ put the message first and what it is made of behind."""
    files = FileDescriptorSet.FromString(sent.LaserScan.get_schema().data)
    schema = FileDescriptorSet(file=list(files.file)[::-1]).SerializeToString()
    turn = translation("foxglove.LaserScan", "protobuf", schema)
    assert turn is not None and turn.cdr(scan().encode())


def test_what_joints_and_odometry_leave_out_is_not_made_up() -> None:
    joints = [sent.JointState(name="a", position=2.5), sent.JointState(name="b", velocity=1.0)]
    found = translated(sent.JointStates(timestamp=STAMP, joints=joints))
    np.testing.assert_array_equal(found.position, [2.5, np.nan])
    np.testing.assert_array_equal(found.velocity, [np.nan, 1.0])
    assert found.effort.size == 0
    bare = {
        "timestamp": {"sec": 1, "nsec": 0},
        "frame_id": "odom",
        "body_frame_id": "base",
        "pose": JSON_SCAN["pose"],
    }
    turn = translation("foxglove.Odometry", "json", b"")
    assert turn is not None
    odometry: Any = ros2_types().deserialize_cdr(
        turn.cdr(json.dumps(bare).encode()), turn.type_name
    )
    assert odometry.child_frame_id == "base" and odometry.twist.twist.linear.x == 0.0


@pytest.mark.parametrize(
    ("name", "encoding", "data"),
    [
        ("FrameTransforms", "protobuf", b"\x0a\x00" * 20_000),
        ("JointStates", "protobuf", b"\x12\x00" * 20_000),
        ("PointCloud", "protobuf", b"\x2a\x00" * 20_000),
        ("FrameTransforms", "json", b'{"transforms": [' + b"{}," * 20_000 + b"{}]}"),
    ],
)
def test_many_empty_parts_are_refused_before_they_are_read(
    name: str, encoding: str, data: bytes
) -> None:
    turn = translation(f"foxglove.{name}", encoding, getattr(sent, name).get_schema().data)
    assert turn is not None
    with pytest.raises(Excessive, match="more than 10,000 parts"):
        turn.cdr(data)


def test_a_number_without_end_is_none() -> None:
    turn = translation("foxglove.LaserScan", "protobuf", sent.LaserScan.get_schema().data)
    assert turn is not None
    with pytest.raises(ValueError, match="no message of Protocol Buffers"):
        turn.cdr(b"\xff" * 2_000_000)


def test_cameras_joints_and_clouds_become_messages_of_ros(tmp_path: Path) -> None:
    kind = sent.PackedElementFieldNumericType
    fields = [
        sent.PackedElementField(name="x", offset=0, type=kind.Float32),
        sent.PackedElementField(name="ring", offset=4, type=kind.Uint16),
    ]
    K = [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
    about: dict[str, Any] = {"timestamp": STAMP, "frame_id": "camera"}
    path = mcap_of(
        tmp_path / "a.mcap",
        [
            ("/jpeg", sent.CompressedImage(**about, data=b"xyz", format="jpeg")),
            (
                "/raw",
                sent.RawImage(
                    **about, width=2, height=1, encoding="rgb8", step=6, data=bytes(range(6))
                ),
            ),
            (
                "/info",
                sent.CameraCalibration(
                    **about,
                    width=640,
                    height=480,
                    distortion_model="plumb_bob",
                    D=[0.1, 0.0, 0.0, 0.0, 0.0],
                    K=K,
                    R=[],
                    P=[],
                ),
            ),
            (
                "/cloud",
                sent.PointCloud(**about, pose=HERE, point_stride=6, fields=fields, data=bytes(12)),
            ),
            (
                "/joints",
                sent.JointStates(
                    timestamp=STAMP, joints=[sent.JointState(name="left", position=2.5)]
                ),
            ),
        ],
    )
    with open_bag(path) as bag:
        found = {
            topic: bag.deserialize(topic, data)
            for topic, _, data in bag.received({channel.topic for channel in bag.channels})
        }
        kinds = {channel.topic: channel.type_name for channel in bag.channels}
    assert found["/jpeg"].data.tobytes() == b"xyz" and found["/jpeg"].format == "jpeg"
    raw, info, cloud = found["/raw"], found["/info"], found["/cloud"]
    assert (raw.width, raw.height, raw.step, raw.encoding) == (2, 1, 6, "rgb8")
    assert raw.data.tobytes() == bytes(range(6)) and raw.header.frame_id == "camera"
    assert info.k.tolist() == K and info.d[0] == 0.1 and not info.p.any()
    assert [(f.name, f.offset, f.datatype) for f in cloud.fields] == [("x", 0, 7), ("ring", 4, 4)]
    assert (cloud.width, cloud.height, cloud.point_step, cloud.row_step) == (2, 1, 6, 12)
    assert found["/joints"].name == ["left"] and found["/joints"].position.tolist() == [2.5]
    assert kinds["/info"] == "sensor_msgs/msg/CameraInfo"


JSON_SCAN = {
    "timestamp": {"sec": 1_700_000_000, "nsec": 5},
    "frame_id": "laser",
    "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
    "start_angle": 0,
    "end_angle": 1,
    "ranges": [1, None, 2.5],
    "intensities": [],
}


def json_mcap(path: Path, *texts: str, name: str = "foxglove.LaserScan") -> Path:
    context = Context()
    with open_mcap(str(path), context=context):
        schema = Schema(name=name, encoding="jsonschema", data=b"{}")
        channel = Channel("/scan", schema=schema, message_encoding="json", context=context)
        for text in texts:
            channel.log(text.encode(), log_time=NOW_NS)
    return path


def test_a_slash_before_a_frame_means_nothing(tmp_path: Path) -> None:
    """No tf2 reads it: that is of ROS 2."""
    text = json.dumps(JSON_SCAN | {"frame_id": "/laser"})
    scans = read(json_mcap(tmp_path / "a.mcap", text)).scans[0]
    assert (scans.frame_ids, scans.slashed) == (("laser",), ())


def test_json_is_read_as_well(tmp_path: Path) -> None:
    scans = read(json_mcap(tmp_path / "a.mcap", json.dumps(JSON_SCAN))).scans[0]
    assert scans.stamps_ns.tolist() == [NOW_NS + 5]
    assert scans.layouts[0].angle_step_rad == pytest.approx(0.5)
    np.testing.assert_array_equal(scans.ranges_m[0], np.array([1.0, np.nan, 2.5], np.float32))


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"pose": None}, "'orientation'"),
        ({"ranges": "many"}, "ValueError"),
        ({"timestamp": {"sec": -(2**40), "nsec": 0}}, "LaserScan"),
        ({"frame_id": 7}, "frame_id"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, wrong: dict[str, Any], told: str) -> None:
    good, bad = json.dumps(JSON_SCAN), json.dumps(JSON_SCAN | wrong)
    recording = read(json_mcap(tmp_path / "a.mcap", good, bad))
    assert len(recording.scans[0]) == 1
    assert "1 of 2 messages" in recording.anomalies[0] and told in recording.anomalies[0]


def test_what_is_left_out_of_all_messages_is_named(tmp_path: Path) -> None:
    without = {name: value for name, value in JSON_SCAN.items() if name != "pose"}
    path = json_mcap(tmp_path / "a.mcap", json.dumps(without))
    with pytest.raises(InputRefused, match=r"/scan: .*a foxglove.LaserScan without 'pose'"):
        read(path)


def test_a_damaged_schema_costs_its_topic_alone(tmp_path: Path) -> None:
    path, context = tmp_path / "a.mcap", Context()
    with open_mcap(str(path), context=context):
        for topic, data in (("/a", b"\xff\xfe"), ("/b", scan().get_schema().data)):
            schema = Schema(name="foxglove.LaserScan", encoding="protobuf", data=data)
            channel = Channel(topic, schema=schema, message_encoding="protobuf", context=context)
            channel.log(scan().encode(), log_time=NOW_NS)
    recording = read(path)
    assert [scans.topic for scans in recording.scans] == ["/b"]
    (unread,) = recording.unread
    assert unread.topic == "/a" and "schema of foxglove.LaserScan is damaged" in unread.reason


@given(st.binary(max_size=200), st.sampled_from(["json", "protobuf"]))
@settings(max_examples=200, deadline=None)
def test_damaged_messages_raise_nothing_unforeseen(data: bytes, encoding: str) -> None:
    turn = translation("foxglove.LaserScan", encoding, sent.LaserScan.get_schema().data)
    assert turn is not None
    try:
        turn.cdr(data)
    except Exception as error:
        assert isinstance(error, (ValueError, TypeError, KeyError, IndexError, RecursionError)) or (
            type(error).__name__ == "DecodeError"
        )
