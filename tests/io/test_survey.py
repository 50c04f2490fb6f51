"""``slamsim info``: what is in a recording of any format, without reading all of it."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_data import ROS1, ROS2, START_NS, Message, Robot, as_mcap, as_ros1, as_rosbag2
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from recording_data import edge, recording
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.guard.errors import InputRefused
from slamsim.io.formats import survey_of
from slamsim.io.mcap.reader import index_mcap
from slamsim.io.mcap.summary import sampled_mcap
from slamsim.io.open import read_log, read_recording, survey_recording
from slamsim.process.exit_codes import run_command
from slamsim.recording import TransformEdge
from slamsim.recording.frame_graph import drawn, outline

ROBOT = Robot(ROS2)
LONG = 3000


def long_drive(robot: Robot = ROBOT, count: int = LONG) -> list[Message]:
    """Scans at the start and the end alone, odometry and transforms throughout."""
    messages = [robot.mounting(), *robot.scans()]
    for i in range(count):
        t = START_NS + 20_000_000 * i
        moved = robot.tf(robot.transform(t, ("odom", "base_footprint"), 0.02 * i))
        messages += [("/odom", t, robot.odometry(t, 0.02 * i)), ("/tf", t, moved)]
    last_ns = START_NS + 20_000_000 * count
    messages += [("/front/scan", last_ns + i, robot.scan(last_ns + i, (1, 2, 3))) for i in range(3)]
    return sorted(messages, key=lambda message: message[1])


MAKERS: dict[str, Callable[[Path], Path]] = {
    "mcap": lambda folder: as_mcap(folder / "a.mcap", long_drive()),
    "mcap unchunked": lambda folder: as_mcap(folder / "a.mcap", long_drive(), chunked=False),
    "mcap lz4": lambda folder: as_mcap(folder / "a.mcap", long_drive(), CompressionType.LZ4),
    "rosbag2 sqlite": lambda folder: as_rosbag2(folder / "a", long_drive()),
    "rosbag2 mcap": lambda folder: as_rosbag2(folder / "a", long_drive(), StoragePlugin.MCAP),
    "ros 1": lambda folder: as_ros1(folder / "a.bag", long_drive(Robot(ROS1)), chunk_size=8192),
}


@pytest.mark.long
@pytest.mark.parametrize("name", MAKERS)
def test_a_look_says_what_reading_all_of_it_says(name: str, tmp_path: Path) -> None:
    path = MAKERS[name](tmp_path)
    quick, whole = survey_recording(path), survey_of(read_recording(path))
    expected = {topic.topic: topic for topic in whole.topics}
    assert {topic.topic for topic in quick.topics} == expected.keys()
    for topic in quick.topics:
        full = expected[topic.topic]
        assert (topic.type_name, topic.messages) == (full.type_name, full.messages)
        if full.first_ns is not None:
            assert (topic.first_ns, topic.last_ns, topic.frames) == (
                full.first_ns, full.last_ns, full.frames,
            )  # fmt: skip
    assert [frame.name for frame in outline(quick.sample.transforms)] == [
        frame.name for frame in outline(whole.sample.transforms)
    ]
    if name in ("mcap", "mcap lz4", "rosbag2 sqlite", "ros 1"):
        assert len(quick.sample.odometries[0]) < LONG / 10


def test_few_chunks_of_a_large_file_are_read(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", long_drive())
    assert len(sampled_mcap(path).places) <= 6 < len(index_mcap(path).places) / 10
    assert sampled_mcap(path).counts == index_mcap(path).counts


@pytest.mark.long
@given(st.data())
@settings(max_examples=150, deadline=None)
def test_a_damaged_summary_is_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Bytes of the last part of the file changed, its checksum switched off."""
    folder = tmp_path_factory.mktemp("damaged")
    path = as_mcap(folder / "a.mcap", long_drive(count=30))
    content = bytearray(path.read_bytes())
    content[-12:-8] = bytes(4)
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(len(content) // 2, len(content) - 9))
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        survey_recording(path)
    except InputRefused as refusal:
        assert str(path) in str(refusal)


def told(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return str(done.output)


def test_the_command_names_topics_frames_what_is_missing_and_what_to_type(tmp_path: Path) -> None:
    messages = [m for m in long_drive(count=50) if m[0] != "/tf_static"]
    path = as_mcap(tmp_path / "a.mcap", messages)
    text = told("info", path, "--odom-topic", "odom")
    for words in (
        "/front/scan  sensor_msgs/msg/LaserScan", "└─ base_footprint  (moves, /tf)",
        "Missing: no IMU", "Missing: no transform from base_footprint to laser",
        f"Next: slamsim map {path} --odom-topic odom",
    ):  # fmt: skip
        assert words in text
    facts = json.loads(told("info", path, "--json"))
    assert facts["next"] == f"slamsim map {path}"
    assert [choice["topics"] for choice in facts["reads"]] == [["/front/scan"], ["/odom"]]
    assert facts["duration_s"] == pytest.approx(1.105)
    assert {topic["topic"]: topic["messages"] for topic in facts["topics"]}["/odom"] == 50


def test_without_scans_it_says_so_and_what_to_do(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", [("/odom", START_NS, ROBOT.odometry(START_NS, 0.0))])
    text = told("info", path)
    assert "Missing: no scans" in text and f"Next: slamsim check {path}" in text


def test_the_tree_is_drawn_as_a_picture(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", long_drive(count=5))
    for name in ("a.svg", "b.svg", "a.png"):
        told("info", path, "--out", tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    texts = [e.text or "" for e in ET.parse(tmp_path / "a.svg").iter() if e.tag.endswith("text")]
    for frame in ("odom", "base_footprint", "base_link", "laser", "imu_link"):
        assert any(text.startswith(frame) for text in texts)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert run_command(lambda: app(["info", str(path), "--out", "a.pdf"])) == 2


NAMES = st.sampled_from("abcdefg")


@given(st.lists(st.tuples(NAMES, NAMES), max_size=12))
def test_every_frame_stands_in_the_outline_once_below_a_parent(
    pairs: list[tuple[str, str]],
) -> None:
    """Whatever circles and double parents the transforms make."""
    edges: list[TransformEdge] = [
        edge(parent, child, np.zeros(1, dtype=np.int64)) for parent, child in pairs
    ]
    frames = outline(edges)
    named = {name for parent, child in pairs if parent != child for name in (parent, child)}
    assert sorted(frame.name for frame in frames) == sorted(named)
    place = {frame.name: row for row, frame in enumerate(frames)}
    for frame in frames:
        if frame.parent:
            assert (frame.parent, frame.name) in pairs
            assert place[frame.parent] < place[frame.name]
            assert frames[place[frame.parent]].depth == frame.depth - 1
    assert len(drawn(frames)) == len(frames)


def test_a_recording_in_memory_is_surveyed_by_its_streams() -> None:
    survey = survey_of(recording(10.0))
    rates = {topic.topic: topic.rate_hz for topic in survey.topics}
    scans = survey.sample.scans[0]
    assert rates[scans.topic] == pytest.approx(1e9 / float(np.diff(scans.stamps_ns).mean()))


def test_messages_that_are_not_of_ros_are_told_with_what_to_do(tmp_path: Path) -> None:
    """No command follows that would refuse the recording."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("nav2d.Scan", "jsonschema", b"{}")
        channel = writer.register_channel("/scan", "json", schema)
        writer.add_message(channel, START_NS, b"{}", START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    way_out = "only messages of ROS, and in Foxglove's schemas "
    text = told("info", path)
    assert way_out in text and "Next:" not in text
    assert json.loads(told("info", path, "--json"))["next"] == ""
    with pytest.raises(InputRefused, match=f"only nav2d.Scan; {way_out}"):
        read_recording(path)
    with pytest.raises(InputRefused, match=way_out):
        read_log(path)
