"""Damaged, cut, foreign and hostile recordings: the right answer or one clear refusal."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bag_data import ROS1, ROS2, Robot, as_mcap, as_ros1, as_rosbag2
from log_data import drive, header, readings
from mcap.writer import CompressionType

from slamsim.core.types import Log
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.bag2.writer import MCAP_NAME, GrowingBag
from slamsim.io.open import read_log, read_truth
from slamsim.recording import row_store
from slamsim.simulation.log_writer import LogWriter

ROBOT1, ROBOT2 = Robot(ROS1), Robot(ROS2)


def _own(folder: Path) -> Path:
    with LogWriter(folder, header()) as writer:
        writer.write(readings(0.0, 2.0, scan_hz=20.0), drive(0.0, 2.0))
    return folder


def _digest(log: Log) -> bytes:
    """Everything that is read, as one hash."""
    parts = [log.epoch.encode(), log.T_base_laser.tobytes(), repr(log.warnings).encode()]
    for scan in log.scans:
        parts += [str(scan.stamp_ns).encode(), repr(scan.geometry).encode()]
        parts.append(scan.ranges_m.tobytes())
    for stream in (log.odometry, log.imu, log.encoders):
        if stream is not None:
            values = [getattr(stream, name) for name in stream.__slots__]
            parts += [
                v.tobytes() if isinstance(v, np.ndarray) else repr(v).encode() for v in values
            ]
    return zlib.crc32(b"".join(parts)).to_bytes(4, "big")


def _mutated(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for position in rng.integers(0, len(data), rng.integers(1, 9)):
        changed[position] ^= int(rng.integers(1, 256))
    return bytes(changed)


@pytest.fixture(scope="module")
def own_mcap(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return (_own(tmp_path_factory.mktemp("own") / "log") / MCAP_NAME).read_bytes()


def test_no_damage_to_our_own_file_goes_unseen(own_mcap: bytes, tmp_path: Path) -> None:
    path = tmp_path / MCAP_NAME
    path.write_bytes(own_mcap)
    right = _digest(read_log(path))
    rng = np.random.default_rng(11)
    refused = 0
    for _ in range(150):
        path.write_bytes(_mutated(own_mcap, rng))
        try:
            assert _digest(read_log(path)) == right
        except InputRefused as refusal:
            assert refusal.path == path
            refused += 1
    assert refused >= 149


def test_every_cut_of_our_own_file_is_refused(own_mcap: bytes, tmp_path: Path) -> None:
    path = tmp_path / MCAP_NAME
    for size in [0, 1, 8, 9, 20, *np.linspace(30, len(own_mcap) - 1, 40).astype(int)]:
        path.write_bytes(own_mcap[:size])
        with pytest.raises(InputRefused):
            read_log(path)


FOREIGN: dict[str, Callable[[Path], Path]] = {
    "mcap": lambda folder: as_mcap(folder / "a.mcap", ROBOT2.drive(), CompressionType.NONE),
    "sqlite": lambda folder: next(as_rosbag2(folder / "a", ROBOT2.drive()).glob("*.db3")),
    "ros 1": lambda folder: as_ros1(folder / "a.bag", ROBOT1.drive()),
    "ros 1 bz2": lambda folder: as_ros1(folder / "a.bag", ROBOT1.drive(), "BZ2"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_damaged_foreign_files_never_raise_anything_odd(name: str, tmp_path: Path) -> None:
    path = FOREIGN[name](tmp_path)
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    cuts = [data[:size] for size in np.linspace(0, len(data) - 1, 8).astype(int)]
    refused = 0
    for changed in [*cuts, *(_mutated(data, rng) for _ in range(12))]:
        path.write_bytes(changed)
        try:
            log = read_log(path)
            for _ in log.scans:
                pass
        except InputRefused:
            refused += 1
    assert refused >= 8


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".db3"])
@pytest.mark.parametrize("content", [b"", b"hello, this is a text\n" * 50, bytes(5000)])
def test_foreign_content_is_refused(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputRefused, match="empty" if not content else "this is no"):
        read_log(path)


def test_foreign_names_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("FLASER")
    with pytest.raises(InputRefused, match=r"\.clf or \.log"):
        read_log(tmp_path / "a.txt")
    with pytest.raises(InputRefused, match=r"metadata\.yaml"):
        read_log(tmp_path)
    for read in (read_log, read_truth):
        with pytest.raises(NotFound):
            read(tmp_path / "nothing")


def test_a_log_without_scans_names_what_is_there(tmp_path: Path) -> None:
    messages = [m for m in ROBOT2.drive() if m[0] == "/imu"]
    with pytest.raises(InputRefused, match=r"without scans.*sensor_msgs/msg/Imu.*slamsim info"):
        read_log(as_mcap(tmp_path / "a.mcap", messages))
    with pytest.raises(InputRefused, match="no message at all"):
        read_log(as_mcap(tmp_path / "b.mcap", []))


def test_scans_without_stamps_and_clocks_far_apart_are_refused(tmp_path: Path) -> None:
    same = [("/scan", i, ROBOT2.scan(0)) for i in range(5)]
    with pytest.raises(InputRefused, match="all 5 scans carry the stamp 0"):
        read_log(as_mcap(tmp_path / "a.mcap", same))
    early = [("/scan", i, ROBOT2.scan(10**9 + 10**8 * i)) for i in range(20)]
    odometry = [m for m in ROBOT2.drive() if m[0] == "/wheel_odom"]
    with pytest.raises(InputRefused, match="no common time: scans 1000000000"):
        read_log(as_mcap(tmp_path / "b.mcap", [*early, *odometry]))


def _mcap_with_chunk(content: bytes, compression: bytes, announced: int) -> bytes:
    def record(opcode: int, data: bytes) -> bytes:
        return bytes([opcode]) + struct.pack("<Q", len(data)) + data

    string = struct.pack("<I", len(compression)) + compression
    chunk = struct.pack("<QQQI", 0, 1, announced, 0) + string + struct.pack("<Q", len(content))
    head = b"\x89MCAP0\r\n" + record(1, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))
    end = record(15, bytes(4)) + record(2, bytes(20)) + b"\x89MCAP0\r\n"
    return head + record(6, chunk + content) + end


@pytest.mark.parametrize(
    ("announced", "told"),
    [(1 << 30, "at most"), (200 << 20, "times its size"), (1000, "more than the 1,000 bytes")],
)
def test_chunks_that_unpack_to_gigabytes_are_refused_unopened(
    tmp_path: Path, announced: int, told: str
) -> None:
    path = tmp_path / "bomb.mcap"
    bomb = zstandard.compress(bytes(400 << 20))
    path.write_bytes(_mcap_with_chunk(bomb, b"zstd", announced))
    del bomb
    tracemalloc.start()
    with pytest.raises(InputRefused, match=told):
        read_log(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


def test_records_longer_than_the_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n\x06" + struct.pack("<Q", 1 << 62) + bytes(100))
    with pytest.raises(InputRefused, match="byte 8"):
        read_log(path)


@pytest.mark.parametrize(
    ("definition", "told"),
    [
        ("float64[5000000] x", "array of 5000000"),
        ("\n".join(f"float64 x{i}" for i in range(1500)), "1000 fields"),
        ("a" * 300_000, "characters long"),
        ("sensor_msgs/LaserScan again", "contains itself"),
        (
            "a_msgs/A a\n================\nMSG: a_msgs/A\nb_msgs/B b\n================\n"
            "MSG: b_msgs/B\na_msgs/A[] a",
            "contains itself",
        ),
        ("float64 __import__('os')", "damaged"),
        ("this is no definition at all {", "damaged"),
    ],
)
def test_hostile_definitions_are_refused(tmp_path: Path, definition: str, told: str) -> None:
    definitions = {"sensor_msgs/msg/LaserScan": definition}
    path = as_mcap(tmp_path / "a.mcap", ROBOT2.drive(), definitions=definitions)
    with pytest.raises(InputRefused, match=told):
        read_log(path)


def _edit_metadata(folder: Path, old: str, new: str) -> Path:
    path = folder / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return folder


def test_metadata_that_does_not_fit_its_files_is_refused(tmp_path: Path) -> None:
    def fresh() -> Path:
        shutil.rmtree(tmp_path / "log", ignore_errors=True)
        return _own(tmp_path / "log")

    count = next(line for line in (fresh() / "metadata.yaml").read_text().split("\n") if
                 line.startswith("  message_count"))  # fmt: skip
    for old, new, told in [
        (count, "  message_count: 3", "announces 3 messages"),
        (f"- {MCAP_NAME}", "- ../../../etc/passwd", "passwd"),
        (f"- {MCAP_NAME}", "- missing_0.mcap", "missing_0"),
        ("compression_mode: ''", "compression_mode: FILE", "log_0.mcap is not compressed"),
        ("rosbag2_bagfile_information", "something", "rosbag2_bagfile_information"),
        ("  version: 8", "  x: &a [1]\n  y: *a", "alias|anchor"),
    ]:
        with pytest.raises((InputRefused, NotFound), match=told):
            read_log(_edit_metadata(fresh(), old, new))


def test_a_killed_writer_leaves_all_but_the_open_chunk(tmp_path: Path) -> None:
    """What stands on the disk before the end is whole chunks, readable one after the other."""
    writer = LogWriter(tmp_path / "log", header())
    for start_s in range(0, 12, 2):
        part = readings(start_s, start_s + 2.0, scan_hz=40.0, beams=1081, intensities=True)
        writer.write(part, drive(start_s, start_s + 2.0))
    bag = writer._sinks[0]
    assert isinstance(bag, GrowingBag)
    bag._bag._file.sync()
    data = (tmp_path / "log" / MCAP_NAME).read_bytes()
    bag._bag._stream.close()
    position, inflated = 8, 0
    while position < len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        if opcode == 6:
            (size,) = struct.unpack_from("<Q", data, position + 9 + 16)
            inflated += size
        position += 9 + length
    assert position == len(data)
    per_window = 2 * 40 * 2 * 4 * 1081
    assert inflated > 6 * per_window - (2 << 20)
    with pytest.raises(InputRefused, match="not ended"):
        read_log(tmp_path / "log" / MCAP_NAME)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the limit from which on ranges are kept in a file."""
    monkeypatch.setattr(row_store.RowStore.__init__, "__defaults__", (1 << 20,))
    peaks = []
    for windows in (10, 40):
        tracemalloc.start()
        with LogWriter(tmp_path / f"log{windows}", header()) as writer:
            for i in range(windows):
                part = readings(2.0 * i, 2.0 * i + 2.0, scan_hz=40.0, beams=1081)
                writer.write(part, drive(2.0 * i, 2.0 * i + 2.0))
        log = read_log(tmp_path / f"log{windows}")
        assert sum(1 for _ in log.scans) == len(log.scans)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]
