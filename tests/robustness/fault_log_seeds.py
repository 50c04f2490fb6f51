"""Recordings of one short drive in every format, and what is made of them, to be damaged."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from functools import partial
from pathlib import Path

from fault_content import Content, as_db3, as_mcap, as_ros1_bag, as_rosbag2, content, written_anew
from fault_database_changes import change_database
from fault_log_reads import (
    judged_quickly,
    judged_thoroughly,
    mapped,
    paths,
    relations,
    saved_map,
    whole_log,
)
from fault_record_changes import change_bag_records, change_records
from fault_seeds import Change, Seed
from fault_table_changes import change_arrays, change_table
from fault_text_changes import TEXT, in_bzip2, in_gzip
from mcap.writer import CompressionType

from slamsim.config.slam import SlamConfig
from slamsim.io.bag2.writer import MCAP_NAME, write_recording
from slamsim.io.carmen.writer import CarmenFile
from slamsim.io.open import read_log, read_recording
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.text.tum import write_tum
from slamsim.recording import Recording
from slamsim.slam.mapping.saved_map import write_saved_map
from slamsim.slam.session import map_log

Make = Callable[[Path], Path]

_RARELY = ((3, judged_quickly),)
_DEEP = ((3, judged_quickly), (40, judged_thoroughly), (60, mapped))
_RELATIONS = "".join(f"{i}.5 {i + 3}.25 0.{i} -0.25 0.0 0.0 0.0 0.{i}1\n" for i in range(1, 9))


def _as_single_mcap(path: Path, held: Content) -> Path:
    return as_mcap(path.with_suffix(".mcap"), held, CompressionType.ZSTD)


def _as_single_bag(path: Path, held: Content, compression: str) -> Path:
    return as_ros1_bag(path.with_suffix(".bag"), held, compression)


OTHER_MCAP = written_anew(2, _as_single_mcap)
OTHER_DB3 = written_anew(2, as_db3)
OTHER_BAG = written_anew(1, partial(_as_single_bag, compression=""))
OTHER_PACKED_BAG = written_anew(1, partial(_as_single_bag, compression="LZ4"))


def _mcap(packing: CompressionType, chunked: bool = True) -> Make:
    return lambda folder: as_mcap(folder / "a.mcap", content(2), packing, chunked)


def _ros1(compression: str) -> Make:
    return lambda folder: as_ros1_bag(folder / "a.bag", content(1), compression)


def _rosbag2(mcap: bool = False, packed: bool = False) -> Make:
    return lambda folder: as_rosbag2(folder / "bag", content(2), mcap=mcap, packed=packed)


def _lone_db3(folder: Path) -> Path:
    return as_db3(folder / "a.db3", content(2))


def _made(write: Callable[[Recording, Path], Path]) -> Make:
    """By our own writers."""

    def make(folder: Path) -> Path:
        source = as_mcap(folder / "source.mcap", content(2), CompressionType.NONE)
        recording = read_recording(source)
        source.unlink()
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


def _carmen(
    recording: Recording, folder: Path, pack: Callable[[bytes], bytes] = bytes, suffix: str = ""
) -> Path:
    plain, packed = folder / "plain.clf", folder / f"a.clf{suffix}"
    with CarmenFile(plain) as written:
        written.write(recording)
    packed.write_bytes(pack(plain.read_bytes()))
    plain.unlink()
    return packed


def _saved_map(recording: Recording, folder: Path) -> Path:
    saved = map_log(read_log(_own_mcap(recording, folder)), SlamConfig())[1]
    (folder / "log" / MCAP_NAME).unlink()
    write_saved_map(folder / "session.npz", saved)
    return folder / "session.npz"


def _trajectory(recording: Recording, folder: Path) -> Path:
    odometry = read_log(_own_mcap(recording, folder)).odometry
    (folder / "log" / MCAP_NAME).unlink()
    assert odometry is not None
    write_tum(folder / "trajectory.tum", odometry)
    return folder / "trajectory.tum"


def _relations(folder: Path) -> Path:
    path = folder / "a.relations"
    path.write_text(_RELATIONS)
    return path


def _log(name: str, make: Make, *changes: Change, sealed: bool = False, deep: bool = False) -> Seed:
    return Seed(name, make, whole_log, sealed, changes, _DEEP if deep else _RARELY)


LOG_SEEDS: tuple[Seed, ...] = (
    _log("mcap of ours", _made(_own_mcap), change_records, OTHER_MCAP, sealed=True, deep=True),
    _log("rosbag2 of ours", _made(_own_folder), change_records, *TEXT, sealed=True),
    _log("mcap zstd", _mcap(CompressionType.ZSTD), change_records, OTHER_MCAP, sealed=True),
    _log("mcap lz4", _mcap(CompressionType.LZ4), change_records, sealed=True),
    _log("mcap without chunks", _mcap(CompressionType.NONE, False), change_records, sealed=True),
    _log("mcap without checksums", _rosbag2(mcap=True), change_records, *TEXT),
    _log("rosbag2 sqlite", _rosbag2(), change_database, *TEXT),
    _log("db3 alone", _lone_db3, change_database, OTHER_DB3, OTHER_DB3),
    _log("sqlite zstd", _rosbag2(packed=True), change_database, *TEXT),
    _log("ros 1", _ros1(""), change_bag_records, OTHER_BAG, OTHER_BAG),
    _log("ros 1 bz2", _ros1("BZ2"), change_bag_records),
    _log("ros 1 lz4", _ros1("LZ4"), change_bag_records, OTHER_PACKED_BAG),
    _log("carmen", _made(_carmen), *TEXT, deep=True),
    _log("carmen gz", _made(partial(_carmen, pack=gzip.compress, suffix=".gz")), in_gzip,
         sealed=True),
    _log("carmen bz2", _made(partial(_carmen, pack=bz2.compress, suffix=".bz2")), in_bzip2,
         sealed=True),
    _log("parquet", _made(_parquet), change_table, deep=True),
    Seed("saved map", _made(_saved_map), saved_map, True, (change_arrays,)),
    Seed("trajectory", _made(_trajectory), paths, False, TEXT),
    Seed("relations", _relations, relations, False, TEXT),
)  # fmt: skip
