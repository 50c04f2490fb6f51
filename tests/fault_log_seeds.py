"""Recordings of one short drive in every format, to be damaged."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from bag_data import ROS1, ROS2, START_NS, Message, Robot, as_mcap, as_ros1, as_rosbag2
from fault_log_reads import judged_quickly, judged_thoroughly, mapped, whole_log
from fault_seeds import Seed
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from slamsim.logs.bag_folder import MCAP_NAME
from slamsim.logs.carmen_writer import CarmenFile
from slamsim.logs.parquet_log import ParquetLog
from slamsim.logs.raw import read_recording
from slamsim.logs.raw_writer import write_recording
from slamsim.recording import Recording

_SECONDS, _SPEED_M_S = 2.0, 0.4
_BEAMS = 61
_LOG_RARELY = ((3, judged_quickly),)
_DEEP_RARELY = ((3, judged_quickly), (150, judged_thoroughly), (300, mapped))


def _ranges(x_m: float) -> list[float]:
    """What a lidar sees in a room of 7 x 5 m with a niche, 2 m in front of the wall behind."""
    angles = -2.0 + 4.0 / (_BEAMS - 1) * np.arange(_BEAMS)
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.where(cos > 0.0, (5.0 - x_m) / cos, (-2.0 - x_m) / cos)
        across = np.where(sin > 0.0, 2.0 / sin, -3.0 / sin)
    niche = (angles > 0.3) & (angles < 0.5)
    ranges = np.minimum(np.abs(along), np.abs(across)) + 0.7 * niche
    return [float(range_m) for range_m in ranges]


def messages(robot: Robot) -> list[Message]:
    """A drive straight through a room: scans, odometry, IMU and transforms by log time."""
    found = [robot.mounting()]
    for i in range(round(_SECONDS * 10)):
        stamp_ns = START_NS + 100_000_000 * i
        ranges = _ranges(0.2 + _SPEED_M_S * 0.1 * i)
        declared = {"angle_min": -2.0, "angle_max": 2.0, "angle_increment": 4.0 / (_BEAMS - 1)}
        scan = robot.scan(stamp_ns, ranges, **declared, time_increment=5e-4, range_min=0.1)
        found.append(("/scan", stamp_ns + 40_000_000, scan))
    for i in range(round(_SECONDS * 20) + 3):
        stamp_ns, x_m = START_NS - 50_000_000 + 50_000_000 * i, _SPEED_M_S * 0.05 * i
        found.append(("/odom", stamp_ns, robot.odometry(stamp_ns, x_m)))
        found.append(("/imu", stamp_ns, robot.imu(stamp_ns, 0.0)))
        moving = robot.transform(stamp_ns, ("odom", "base_footprint"), x_m)
        found.append(("/tf", stamp_ns, robot.tf(moving)))
    return sorted(found, key=lambda message: message[1])


@cache
def messages1() -> list[Message]:
    return messages(Robot(ROS1))


@cache
def messages2() -> list[Message]:
    return messages(Robot(ROS2))


def _recorded(folder: Path) -> Recording:
    """The drive as a recording in memory."""
    return read_recording(as_mcap(folder / "source.mcap", messages2()))


def _made(write: Callable[[Recording, Path], Path]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        recording = _recorded(folder)
        (folder / "source.mcap").unlink()
        return write(recording, folder)

    return make


def _own_folder(recording: Recording, folder: Path) -> Path:
    write_recording(recording, folder / "log")
    return folder / "log"


def _own_mcap(recording: Recording, folder: Path) -> Path:
    written = _own_folder(recording, folder)
    (written / "metadata.yaml").unlink()
    return written / MCAP_NAME


def _parquet(recording: Recording, folder: Path) -> Path:
    with ParquetLog(folder / "parquet") as written:
        written.write(recording)
    return folder / "parquet"


def _carmen(recording: Recording, folder: Path) -> Path:
    with CarmenFile(folder / "a.clf") as written:
        written.write(recording)
    return folder / "a.clf"


def _carmen_gz(recording: Recording, folder: Path) -> Path:
    plain = _carmen(recording, folder)
    packed = folder / "a.clf.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
    plain.unlink()
    return packed


def _carmen_bz2(recording: Recording, folder: Path) -> Path:
    plain = _carmen(recording, folder)
    packed = folder / "a.clf.bz2"
    packed.write_bytes(bz2.compress(plain.read_bytes()))
    plain.unlink()
    return packed


def _only_db3(folder: Path) -> Path:
    bag = as_rosbag2(folder / "bag", messages2())
    (bag / "metadata.yaml").unlink()
    return next(bag.glob("*.db3"))


def _packed_messages(folder: Path) -> Path:
    """SQLite whose messages are compressed one by one."""
    writer = Writer2(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, log_ns, message in messages2():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], log_ns, ROS2.serialize_cdr(message, kind))
    return folder / "bag"


def _mcap(compression: CompressionType, chunked: bool = True) -> Callable[[Path], Path]:
    return lambda folder: as_mcap(folder / "a.mcap", messages2(), compression, chunked)


def _ros1(compression: str) -> Callable[[Path], Path]:
    return lambda folder: as_ros1(folder / "a.bag", messages1(), compression)


def _foreign(name: str, make: Callable[[Path], Path]) -> Seed:
    return Seed(name, make, whole_log, rarely=_LOG_RARELY)


LOG_SEEDS: tuple[Seed, ...] = (
    Seed("mcap of ours", _made(_own_mcap), whole_log, sealed=True, rarely=_DEEP_RARELY),
    Seed("rosbag2 of ours", _made(_own_folder), whole_log, sealed=True, rarely=_LOG_RARELY),
    Seed("mcap zstd", _mcap(CompressionType.ZSTD), whole_log, sealed=True, rarely=_LOG_RARELY),
    Seed("mcap lz4", _mcap(CompressionType.LZ4), whole_log, sealed=True, rarely=_LOG_RARELY),
    _foreign(
        "mcap without checksums",
        lambda folder: as_rosbag2(folder / "bag", messages2(), StoragePlugin.MCAP),
    ),
    _foreign("rosbag2 sqlite", lambda folder: as_rosbag2(folder / "bag", messages2())),
    _foreign("db3 alone", _only_db3),
    _foreign("sqlite zstd", _packed_messages),
    _foreign("ros 1", _ros1("")),
    _foreign("ros 1 bz2", _ros1("BZ2")),
    _foreign("ros 1 lz4", _ros1("LZ4")),
    Seed("carmen", _made(_carmen), whole_log, rarely=_DEEP_RARELY),
    Seed("carmen gz", _made(_carmen_gz), whole_log, sealed=True, rarely=_LOG_RARELY),
    Seed("carmen bz2", _made(_carmen_bz2), whole_log, sealed=True, rarely=_LOG_RARELY),
    Seed("parquet", _made(_parquet), whole_log, rarely=_DEEP_RARELY),
)
