"""Recordings whose files are packed as a whole: read as if they were not, within limits."""

from __future__ import annotations

import bz2
import gzip
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from bag_data import ROS1, ROS2, SCANS, Message, Robot, as_mcap, as_ros1, as_rosbag2
from lowered_limits import lowered
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import Writer as Writer2

from slamsim.core.types import Log
from slamsim.guard import unpacking
from slamsim.guard.errors import DiskFull, InputRefused
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import checked_recording, read_log, read_recording, survey_recording
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording

ROBOT = Robot(ROS2)
PACKED: dict[str, Callable[[bytes], bytes]] = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".zst": zstandard.compress,
    ".zstd": zstandard.compress,
}


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are unpacked."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def as_sqlite(path: Path, messages: list[Message]) -> Path:
    made = next(as_rosbag2(path.with_suffix(""), messages).glob("*.db3"))
    return made.rename(path)


MAKERS: dict[str, Callable[[Path], Path]] = {
    "a.mcap": lambda path: as_mcap(path, ROBOT.drive()),
    "a.bag": lambda path: as_ros1(path, Robot(ROS1).drive()),
    "a.db3": lambda path: as_sqlite(path, ROBOT.drive()),
}


def packed_file(path: Path, suffix: str) -> Path:
    packed = path.with_name(f"{path.name}{suffix}")
    packed.write_bytes(PACKED[suffix](path.read_bytes()))
    path.unlink()
    return packed


def require_same(one: Log, other: Log) -> None:
    for a, b in zip(one.scans, other.scans, strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
    assert one.odometry is not None and other.odometry is not None
    np.testing.assert_array_equal(one.odometry.poses, other.odometry.poses)
    assert one.name == other.name and one.warnings == other.warnings


@pytest.mark.parametrize("suffix", PACKED)
@pytest.mark.parametrize("name", MAKERS)
def test_a_packed_file_is_read_as_the_plain_one(
    name: str, suffix: str, tmp_path: Path, scratch: Path
) -> None:
    plain = MAKERS[name](tmp_path / name)
    expected, checked = read_log(plain), checked_recording(plain)
    topics = survey_recording(plain).topics
    packed = packed_file(plain, suffix)
    require_same(read_log(packed), expected)
    assert checked_recording(packed) == checked
    assert survey_recording(packed).topics == topics
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("named", ["a.mcap.zst.gz", "a.mcap.gz"])
def test_a_file_that_is_packed_twice_is_refused_in_words(named: str, tmp_path: Path) -> None:
    """Whether its name says so or not; a bomb in an archive is one."""
    packed = tmp_path / named
    plain = as_mcap(tmp_path / "plain.mcap", ROBOT.drive()).read_bytes()
    packed.write_bytes(gzip.compress(zstandard.compress(plain)))
    for read in (read_log, survey_recording):
        with pytest.raises(InputRefused, match=r"is packed twice; unpack it once"):
            read(packed)


def test_a_packed_carmen_log_is_read_as_the_plain_one(tmp_path: Path) -> None:
    body = "FLASER 4 1.0 2.0 3.0 4.0 {0} 0 0 {0} 0 0 {1} host {1}"
    text = "\n".join(body.format(0.1 * i, 10.0 + i) for i in range(30))
    plain = tmp_path / "a.log"
    plain.write_text(text)
    expected = read_log(plain)
    require_same(read_log(packed_file(plain, ".zst")), expected)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_compressed_rosbag2_folders_of_another_writer(
    plugin: StoragePlugin, mode: str, tmp_path: Path, scratch: Path
) -> None:
    """By rosbags: ``compression_mode: file`` and ``message``."""
    expected = read_log(as_rosbag2(tmp_path / "x" / "bag", ROBOT.drive(), plugin))
    compressed_bag2(tmp_path / "bag", plugin, mode)
    require_same(read_log(tmp_path / "bag"), expected)
    assert list(scratch.iterdir()) == []


def compressed_bag2(folder: Path, plugin: StoragePlugin, mode: str) -> Path:
    """The file of a rosbag2 folder; that its messages are compressed only metadata.yaml says."""
    writer = Writer2(folder, version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, log_ns, message in ROBOT.drive():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], log_ns, ROS2.serialize_cdr(message, kind))
    return next(each for each in folder.iterdir() if each.name != "metadata.yaml")


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_compressed_messages_are_read_without_metadata(
    plugin: StoragePlugin, tmp_path: Path
) -> None:
    expected = read_log(as_rosbag2(tmp_path / "x" / "bag", ROBOT.drive()))
    file = compressed_bag2(tmp_path / "bag", plugin, "MESSAGE")
    require_same(read_log(file), expected)
    assert survey_recording(file).sample.scans


def test_compressed_messages_of_an_mcap_are_recovered_plain(tmp_path: Path) -> None:
    """For others to read: nothing in the copy tells that they were compressed."""
    file = compressed_bag2(tmp_path / "bag", StoragePlugin.MCAP, "MESSAGE")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-1000])
    found = recover(damaged_recording(cut), emptied(tmp_path / "found"))
    with Reader2(found.recording) as reader:
        for connection, _, data in reader.messages():
            ROS2.deserialize_cdr(data, connection.msgtype)
        assert reader.message_count == found.messages == len(ROBOT.drive())


def split(folder: Path, parts: int, suffix: str = "") -> Path:
    """A drive in several MCAP files, as rosbag2 splits it, packed one by one if so wished."""
    folder.mkdir()
    messages = ROBOT.drive()
    names, per = [], -(-len(messages) // parts)
    for number in range(parts):
        name = f"bag_{number}.mcap"
        as_mcap(folder / name, messages[number * per : (number + 1) * per])
        if suffix:
            packed_file(folder / name, suffix)
        names.append(f"{name}{suffix}")
    information = {
        "version": 9, "storage_identifier": "mcap", "message_count": len(messages),
        "compression_format": "zstd" if suffix else "", "relative_file_paths": names,
        "compression_mode": "FILE" if suffix else "", "topics_with_message_count": [],
    }  # fmt: skip
    text = yaml.safe_dump({"rosbag2_bagfile_information": information})
    (folder / "metadata.yaml").write_text(text)
    return folder


@pytest.mark.parametrize("suffix", ["", ".zstd"])
def test_split_recordings_are_read_in_order(suffix: str, tmp_path: Path, scratch: Path) -> None:
    """Twelve parts: by their names, the tenth would come after the first."""
    (tmp_path / "whole").mkdir()
    expected = read_log(as_mcap(tmp_path / "whole" / "bag.mcap", ROBOT.drive()))
    folder = split(tmp_path / "bag", 12, suffix)
    require_same(read_log(folder), expected)
    assert len(expected.scans) == SCANS
    received = read_recording(folder).odometries[0].received_ns
    assert received is not None and (np.diff(received) > 0).all()
    assert list(scratch.iterdir()) == []


def test_metadata_that_names_the_files_before_they_were_packed(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag", 2, ".zstd")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(".zstd", ""))
    assert len(read_log(folder).scans) == SCANS


def test_a_packed_recording_is_copied_message_by_message(tmp_path: Path, scratch: Path) -> None:
    packed = packed_file(as_ros1(tmp_path / "a.bag", Robot(ROS1).drive()), ".bz2")
    recording = read_recording(packed)
    copied = copy_recording(packed, recording, recording, tmp_path / "copy")
    assert copied.changed == ()
    require_same(replace(read_log(tmp_path / "copy"), name="a"), read_log(packed))
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("suffix", PACKED)
@pytest.mark.parametrize("name", MAKERS)
def test_a_bomb_is_refused_in_one_sentence(
    name: str, suffix: str, tmp_path: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bomb = tmp_path / f"{name}{suffix}"
    bomb.write_bytes(PACKED[suffix](bytes(8 << 20)))
    with (
        pytest.raises(InputRefused, match="unpacks to more than 100 times its size") as refusal,
        lowered(bag_ratio=100, bag_ratio_floor_bytes=1 << 20),
    ):
        read_log(bomb)
    assert refusal.value.path == bomb and "\n" not in str(refusal.value)
    assert list(scratch.iterdir()) == []
    with (
        pytest.raises(InputRefused, match="more than 1,048,576 bytes"),
        lowered(unpacked_file_bytes=1 << 20),
    ):
        unpacking.unpack(bomb, tmp_path / "out")


@pytest.mark.parametrize("suffix", PACKED)
def test_a_cut_or_damaged_archive_is_named_and_leaves_nothing(
    suffix: str, tmp_path: Path, scratch: Path
) -> None:
    packed = packed_file(as_mcap(tmp_path / "a.mcap", ROBOT.drive()), suffix)
    content = packed.read_bytes()
    for damage in (content[: len(content) // 2], content[:40] + b"\xff" * 40 + content[80:]):
        packed.write_bytes(damage)
        with pytest.raises(InputRefused) as refusal:
            read_log(packed)
        assert refusal.value.path == packed
        assert "recover" not in str(refusal.value) and str(scratch) not in str(refusal.value)
        assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("suffix", PACKED)
@pytest.mark.parametrize("name", ["a.mcap", "a.bag"])
def test_of_a_packed_recording_all_before_a_cut_is_recovered(
    name: str, suffix: str, tmp_path: Path, scratch: Path
) -> None:
    packed = packed_file(MAKERS[name](tmp_path / name), suffix)
    whole = recover(damaged_recording(packed), emptied(tmp_path / "whole"))
    assert len(read_log(whole.recording).scans) == SCANS and not whole.losses
    content = packed.read_bytes()
    packed.write_bytes(content[: len(content) // 2])
    if suffix == ".gz":
        found = recover(damaged_recording(packed), emptied(tmp_path / "cut"))
        assert 0 < found.messages < whole.messages
        assert packed.name in found.notes[0] and "cut off here" in found.notes[0]
    else:  # nothing is sound of a block that is cut, and there is but one
        with pytest.raises(InputRefused, match=r"not one whole message.*cut off here") as refusal:
            recover(damaged_recording(packed), emptied(tmp_path / "cut"))
        assert refusal.value.path == packed
    assert list(scratch.iterdir()) == []


def test_packed_files_of_a_folder_are_recovered(tmp_path: Path, scratch: Path) -> None:
    folder = split(tmp_path / "bag", 2, ".zstd")
    (folder / "metadata.yaml").unlink()
    found = recover(damaged_recording(folder), emptied(tmp_path / "found"))
    assert len(read_log(found.recording).scans) == SCANS and not found.losses
    assert list(scratch.iterdir()) == []


def emptied(folder: Path) -> Path:
    folder.mkdir()
    return folder


def test_what_is_packed_but_no_recording_is_named_by_its_own_name(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap.gz"
    path.write_bytes(gzip.compress(b"not a recording"))
    with pytest.raises(InputRefused, match="no MCAP file") as refusal:
        read_log(path)
    assert refusal.value.path == path


@pytest.mark.long
def test_a_disk_without_room_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_folder: Path, _bytes: int) -> None:
        raise DiskFull("full")

    monkeypatch.setattr(unpacking, "require_free_space", full)
    packed = tmp_path / "a.gz"
    packed.write_bytes(gzip.compress(np.random.default_rng(0).bytes(70 << 20), 1))
    with pytest.raises(DiskFull):
        unpacking.unpack(packed, tmp_path / "out")
