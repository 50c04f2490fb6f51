"""Cut and damaged MCAP recordings come back: all that is whole, nothing that is not."""

from __future__ import annotations

import shutil
from collections import Counter
from io import BytesIO
from pathlib import Path

import pytest
from bag_data import ROS2, Robot, as_mcap, as_rosbag2
from fault_recovery import MANY, cuts, damaged
from foreign_bags import drive as foreign_drive
from foreign_bags import offered_in_numbers, sent, store_of, write
from log_data import drive, header, readings
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType
from rosbags.rosbag2 import Reader, StoragePlugin

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.bag2.writer import MCAP_NAME
from slamsim.io.open import read_log
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.report import Recovered
from slamsim.io.salvage.source import damaged_recording
from slamsim.simulation.log_writer import LogWriter

pytestmark = pytest.mark.fault

Messages = Counter[tuple[str, int, bytes]]
ROBOT = Robot(ROS2)


def messages_in(path: Path) -> Messages:
    """As the ``mcap`` library reads them, every checksum checked."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = reader.iter_messages(log_time_order=False)
        return Counter((channel.topic, m.log_time, m.data) for _, channel, m in found)


def chunks_in(path: Path) -> list[tuple[int, int, Messages]]:
    """(first byte, end, messages) of each chunk of a whole file, by the ``mcap`` library."""
    data = path.read_bytes()
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    places = [(i.chunk_start_offset, i.chunk_length) for i in summary.chunk_indexes]
    chunks = [r for r in StreamReader(BytesIO(data), emit_chunks=True).records if type(r) is Chunk]
    return [
        (begin, begin + length, _inside(chunk, topics))
        for (begin, length), chunk in zip(sorted(places), chunks, strict=True)
    ]


def _inside(chunk: Chunk, topics: dict[int, str]) -> Messages:
    messages = [record for record in breakup_chunk(chunk) if isinstance(record, Message)]
    return Counter((topics[m.channel_id], m.log_time, m.data) for m in messages)


@pytest.fixture(scope="module", params=["own", *CompressionType])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with many small chunks, by our own writer or by the ``mcap`` library's."""
    folder = tmp_path_factory.mktemp("whole")
    if request.param != "own":
        return as_mcap(folder / MCAP_NAME, ROBOT.drive(), request.param, chunk_size=3000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slamsim.io.mcap.writer.CHUNK_BYTES", 10_000)
        return own(folder / "log") / MCAP_NAME


def own(folder: Path) -> Path:
    with LogWriter(folder, header()) as writer:
        writer.write(readings(0.0, 1.0), drive(0.0, 1.0))
    return folder


def recovered_from(data: bytes, folder: Path) -> tuple[Recovered, Path]:
    """(what is told, the file written) of a file with these bytes."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "out").mkdir(parents=True)
    (folder / MCAP_NAME).write_bytes(data)
    told = recover(damaged_recording(folder), folder / "out")
    return told, folder / "out" / MCAP_NAME


@MANY
def test_of_a_file_cut_anywhere_every_complete_chunk_comes_back(
    whole: Path, count: int, tmp_path: Path
) -> None:
    data, chunks = whole.read_bytes(), chunks_in(whole)
    assert len(chunks) > 5
    for cut in cuts(data, 1, [end for _, end, _ in chunks], count):
        complete = [inside for _, end, inside in chunks if end <= cut]
        if not complete:
            with pytest.raises(InputRefused, match="not one whole message"):
                recovered_from(data[:cut], tmp_path / "b")
            continue
        told, out = recovered_from(data[:cut], tmp_path / "b")
        assert messages_in(out) == sum(complete, Messages())
        assert told.messages == messages_in(out).total()


@MANY
def test_of_a_damaged_file_exactly_the_damaged_chunk_is_missing(
    whole: Path, count: int, tmp_path: Path
) -> None:
    data, chunks = whole.read_bytes(), chunks_in(whole)
    lost = 0
    for first, changed in damaged(data, 2, count):
        touched = [begin <= first + 8 and first < end for begin, end, _ in chunks]
        _, out = recovered_from(changed, tmp_path / "b")
        found = messages_in(out)
        for (_, _, inside), is_touched in zip(chunks, touched, strict=True):
            is_there = inside <= found
            assert is_there or is_touched
            if not is_there:
                assert not inside & found
                lost += 1
        assert found <= sum((inside for _, _, inside in chunks), Messages())
    assert lost > count // 6


def test_a_whole_recording_comes_back_byte_for_byte(tmp_path: Path) -> None:
    log = own(tmp_path / "log")
    (tmp_path / "out").mkdir()
    told = recover(damaged_recording(log), tmp_path / "out")
    assert not told.losses and not told.notes and not any(topic.lost for topic in told.topics)
    for name in (MCAP_NAME, "metadata.yaml"):
        assert (tmp_path / "out" / name).read_bytes() == (log / name).read_bytes()


def test_what_is_lost_is_told_by_topic(tmp_path: Path) -> None:
    whole = as_mcap(tmp_path / MCAP_NAME, ROBOT.drive(), chunk_size=3000)
    data, (begin, end, inside) = bytearray(whole.read_bytes()), chunks_in(whole)[4]
    data[(begin + end) // 2] ^= 1
    gone = Counter(topic for topic, _, _ in inside)
    for cut in (len(data), len(data) - 200):  # with and without what the end of the file says
        told, _ = recovered_from(bytes(data[:cut]), tmp_path / "b")
        assert {topic.topic: topic.lost for topic in told.topics if topic.lost} == gone
        assert all(topic.lost_is_known for topic in told.topics)
        (loss,) = told.losses
        assert loss.messages == gone and loss.first_byte == begin
        assert loss.gap_s == pytest.approx(0.08)
        assert not told.notes
    told, _ = recovered_from(bytes(data[: chunks_in(whole)[-1][1]]), tmp_path / "b")
    assert "has no end" in told.notes[0]


def test_declarations_in_a_damaged_chunk_are_found_at_the_end_of_the_file(tmp_path: Path) -> None:
    whole = as_mcap(tmp_path / MCAP_NAME, ROBOT.drive(), chunk_size=3000)
    data, chunks = bytearray(whole.read_bytes()), chunks_in(whole)
    data[chunks[1][1] - 5] ^= 1
    _, out = recovered_from(bytes(data), tmp_path / "b")
    left = [inside for number, (_, _, inside) in enumerate(chunks) if number != 1]
    assert messages_in(out) == sum(left, Messages())
    told, out = recovered_from(bytes(data[:-100]), tmp_path / "b")
    assert chunks[0][2] <= messages_in(out) <= sum(left, Messages())
    assert sum("nothing declares" in loss.reason for loss in told.losses) > len(chunks) // 2


def test_messages_outside_of_chunks_come_back(tmp_path: Path) -> None:
    whole = as_mcap(tmp_path / MCAP_NAME, ROBOT.drive(), chunked=False)
    data, right = whole.read_bytes(), messages_in(whole)
    told, out = recovered_from(data, tmp_path / "b")
    assert messages_in(out) == right
    assert "without a checksum" in told.notes[0]
    places, position = [], 8
    while position < len(data) - 8:
        places += [position] * (data[position] == Opcode.MESSAGE)
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    for place in places[20:-20:10]:
        changed = bytearray(data)
        changed[place + 1] ^= 4  # a length that leads into the next message, or not so far
        _, out = recovered_from(bytes(changed), tmp_path / "b")
        assert messages_in(out) <= right
        assert right.total() - messages_in(out).total() <= 2


def test_a_folder_of_several_files_without_metadata_is_one_recording(tmp_path: Path) -> None:
    messages = ROBOT.drive()
    (tmp_path / "log").mkdir()
    parts = [messages[:20], messages[20:90], messages[90:]]
    files = [
        as_mcap(tmp_path / "log" / f"a_{number}.mcap", part)
        for number, part in zip((0, 9, 10), parts, strict=True)
    ]
    files[2].write_bytes(files[2].read_bytes()[:500])
    (tmp_path / "out").mkdir()
    told = recover(damaged_recording(tmp_path / "log"), tmp_path / "out")
    assert told.messages == 90
    with Reader(tmp_path / "out") as reader:
        stamps = [stamp_ns for _, stamp_ns, _ in reader.messages()]
    assert stamps == sorted(log_ns for _, log_ns, _ in messages[:90])
    assert len(read_log(tmp_path / "out").scans) > 1


def test_foreign_recordings_of_rosbags_are_rebuilt(tmp_path: Path) -> None:
    log = as_rosbag2(tmp_path / "log", ROBOT.drive(), StoragePlugin.MCAP)
    (log / "metadata.yaml").write_bytes(b"\xff\x00 damaged")
    (tmp_path / "out").mkdir()
    told = recover(damaged_recording(log), tmp_path / "out")
    assert told.messages == len(ROBOT.drive())
    assert messages_in(tmp_path / "out" / "log.mcap") == messages_in(log / "log.mcap")
    assert len(list(read_log(tmp_path / "out").scans)) > 1


@pytest.mark.parametrize("kind", ["rosbag2_mcap", "rosbag2_sqlite"])
def test_what_ros_2_jazzy_recorded_can_be_played_by_humble(kind: str, tmp_path: Path) -> None:
    store = store_of(kind)
    messages = list(sent(kind, store, foreign_drive(store, 3)))
    log = write(kind, tmp_path / "log", messages, store)
    (tmp_path / "out").mkdir()
    told = recover(damaged_recording(log), tmp_path / "out")
    assert told.messages == len(messages) and not told.losses
    assert offered_in_numbers(tmp_path / "out").keys() == {each.topic for each in messages}


def test_nothing_to_recover_is_refused(tmp_path: Path) -> None:
    for data in (b"", b"hello\n" * 100, bytes(3000), b"\x89MCAP0\r\n"):
        with pytest.raises(InputRefused, match="not one whole message"):
            recovered_from(data, tmp_path / "b")
    with pytest.raises(NotFound):
        damaged_recording(tmp_path / "nothing")
    with pytest.raises(InputRefused, match="there is no"):
        damaged_recording(tmp_path)
