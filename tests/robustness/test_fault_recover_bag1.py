"""Cut and damaged ROS 1 bags come back: whole chunks, and whole messages of open ones."""

from __future__ import annotations

import bz2
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
from bag_data import ROS1, Robot, as_ros1
from fault_recovery import MANY, cuts, damaged, recovered_from
from rosbags.rosbag1 import Reader

from slamsim.guard.errors import InputRefused
from slamsim.io.open import read_log

pytestmark = pytest.mark.fault

Messages = Counter[tuple[bytes, bytes]]
"""(header, data)"""
Unit = tuple[int, int, Messages]
"""(first byte, end, messages) of what comes back whole or not at all."""

UNPACK = {"none": bytes, "bz2": bz2.decompress, "lz4": lz4.frame.decompress}


def records(data: bytes, position: int) -> Iterator[tuple[int, bytes, bytes, int]]:
    """(first byte, header, data, end) of each record from there on."""
    while position < len(data):
        begin, parts = position, []
        for _ in range(2):
            length = int.from_bytes(data[position : position + 4], "little")
            parts.append(data[position + 4 : position + 4 + length])
            position += 4 + length
        yield begin, parts[0], parts[1], position


def units_in(data: bytes, compression: str) -> list[Unit]:
    found = []
    for begin, header, packed, end in records(data, 13):
        if b"op=\x05" in header:
            inside = list(records(UNPACK[compression](packed), 0))
            messages = [(b, Messages([(h, d)]), e) for b, h, d, e in inside if b"op=\x02" in h]
            if compression == "none":
                start = end - len(packed)
                found += [(start + b, start + e, message) for b, message, e in messages]
            else:
                found.append((begin, end, sum((m for _, m, _ in messages), Messages())))
    return found


def messages_in(data: bytes) -> Messages:
    """Of the chunks of a whole file that ``rosbags`` reads as well."""
    found = Messages()
    for _, header, packed, _ in records(data, 13):
        if b"op=\x05" in header:
            compression = next(name for name in UNPACK if name.encode() in header)
            inside = records(UNPACK[compression](packed), 0)
            found.update((h, d) for _, h, d, _ in inside if b"op=\x02" in h)
    return found


def read_back(folder: Path) -> Messages:
    (path,) = folder.iterdir()
    found = messages_in(path.read_bytes())
    with Reader(path) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == found.total()
    return found


@pytest.fixture(scope="module", params=["", "BZ2", "LZ4"])
def whole(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[bytes, list[Unit]]:
    path = tmp_path_factory.mktemp("whole") / "a.bag"
    data = as_ros1(path, Robot(ROS1).drive(), request.param, chunk_size=2000).read_bytes()
    return data, units_in(data, request.param.lower() or "none")


@MANY
def test_of_a_bag_cut_anywhere_all_that_is_complete_comes_back(
    whole: tuple[bytes, list[Unit]], count: int, tmp_path: Path
) -> None:
    data, units = whole
    assert len(units) > 10
    for cut in cuts(data, 1, [end for _, end, _ in units], count):
        complete = sum((inside for _, end, inside in units if end <= cut), Messages())
        if not complete:
            with pytest.raises(InputRefused, match="not one whole message"):
                recovered_from(data[:cut], tmp_path / "b", "a.bag")
            continue
        told, folder = recovered_from(data[:cut], tmp_path / "b", "a.bag")
        assert read_back(folder) == complete
        assert told.messages == complete.total()


@MANY
def test_of_a_damaged_bag_what_is_untouched_comes_back(
    whole: tuple[bytes, list[Unit]], count: int, tmp_path: Path
) -> None:
    data, units = whole
    alone = all(inside.total() == 1 for _, _, inside in units)
    for first, changed in damaged(data, 2, count):
        touched = [begin < first + 8 and first < end for begin, end, _ in units]
        if alone:  # the length of a message is believed only if a record follows it
            touched = [a or b for a, b in zip(touched, [*touched[1:], False], strict=True)]
        _, folder = recovered_from(changed, tmp_path / "b", "a.bag")
        found = read_back(folder)
        assert not all(touched)
        for (_, _, inside), is_touched in zip(units, touched, strict=True):
            assert is_touched or inside <= found


def test_a_whole_bag_loses_nothing(whole: tuple[bytes, list[Unit]], tmp_path: Path) -> None:
    data, units = whole
    told, folder = recovered_from(data, tmp_path / "b", "a.bag.active")
    assert read_back(folder) == sum((inside for _, _, inside in units), Messages())
    assert not told.losses and not any(topic.lost for topic in told.topics)
    assert len(list(read_log(folder / "a.bag").scans)) > 5


def test_the_open_chunk_of_a_killed_recorder_comes_back(tmp_path: Path) -> None:
    """rosbag fills in the length of a chunk when it closes it."""
    path = as_ros1(tmp_path / "a.bag", Robot(ROS1).drive(), chunk_size=4000)
    data, right = bytearray(path.read_bytes()), messages_in(path.read_bytes())
    chunks = [(b, h, p, e) for b, h, p, e in records(bytes(data), 13) if b"op=\x05" in h]
    begin, header, packed, end = chunks[-1]
    sized = header.replace(b"size=" + len(packed).to_bytes(4, "little"), b"size=" + bytes(4))
    data[begin + 4 : begin + 4 + len(header)] = sized
    data[begin + 4 + len(header) : begin + 8 + len(header)] = bytes(4)
    told, folder = recovered_from(bytes(data[:end]), tmp_path / "b", "a.bag.active")
    assert read_back(folder) == right
    assert "has no end" in told.notes[1]


def test_what_is_lost_is_told_by_topic(tmp_path: Path) -> None:
    path = as_ros1(tmp_path / "a.bag", Robot(ROS1).drive(), "BZ2", chunk_size=2000)
    data = path.read_bytes()
    begin, end, inside = units_in(data, "bz2")[3]
    changed = bytearray(data)
    changed[(begin + end) // 2] ^= 1
    told, folder = recovered_from(bytes(changed), tmp_path / "b", "a.bag")
    assert read_back(folder) == messages_in(data) - inside
    assert sum(topic.lost for topic in told.topics) == inside.total()
    assert all(topic.lost_is_known for topic in told.topics)
    assert [loss.first_byte for loss in told.losses] == [begin]


def test_a_message_that_does_not_read_as_its_type_is_left_out(tmp_path: Path) -> None:
    """Without checksums nothing else tells; a reader would refuse the whole topic for it."""
    messages = Robot(ROS1).drive()
    place = next(n for n, (topic, *_) in enumerate(messages) if topic == "/wheel_odom")
    messages[place][2].child_frame_id = "qwzxvk"
    data = as_ros1(tmp_path / "a.bag", messages).read_bytes()
    assert data.count(b"qwzxvk") == 1
    told, folder = recovered_from(data.replace(b"qwzxvk", b"\xff" * 6), tmp_path / "b", "a.bag")
    assert told.messages == len(messages) - 1
    assert sum(topic.lost for topic in told.topics) == 1
    assert read_log(folder / "a.bag").odometry is not None
