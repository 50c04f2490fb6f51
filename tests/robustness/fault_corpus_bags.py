"""Hostile recordings: MCAP, rosbag2 with SQLite, ROS 1 bags and tables."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from bag_data import ROS1, ROS2, Robot, as_mcap, as_ros1, as_rosbag2
from fault_corpus_base import Data, Fill, Hostile, one
from mcap.writer import CompressionType

from slamsim.io.open import read_log

_MAGIC = b"\x89MCAP0\r\n"
_ROS1_MAGIC = b"#ROSBAG V2.0\n"
_MIB = 1 << 20


def log(path: Path) -> object:
    """Every scan of it."""
    found = read_log(path)
    return found.name, sum(1 for _ in found.scans)


def _record(opcode: int, data: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(data) if length is None else length) + data


def _text(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _chunk(content: bytes, compression: bytes, announced: int) -> bytes:
    head = struct.pack("<QQQI", 0, 1, announced, 0) + _text(compression)
    return _record(6, head + struct.pack("<Q", len(content)) + content)


def _mcap(*records: bytes) -> bytes:
    return _MAGIC + _record(1, _text(b"ros2") + _text(b"")) + b"".join(records) + _ENDED


_ENDED = _record(15, bytes(4)) + _record(2, bytes(20)) + _MAGIC
_SCHEMA = _record(
    3, struct.pack("<H", 1) + _text(b"a/msg/B") + _text(b"ros2msg") + _text(b"int8 a")
)
_CHANNEL = struct.pack("<HH", 1, 1) + _text(b"/scan") + _text(b"cdr") + _text(b"")


def _zstd(count_mib: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join(packer.compress(bytes(_MIB)) for _ in range(count_mib)) + packer.flush()


def _lz4(count_mib: int) -> bytes:
    with lz4.frame.LZ4FrameCompressor() as packer:
        parts = [packer.begin()] + [packer.compress(bytes(_MIB)) for _ in range(count_mib)]
        return b"".join([*parts, packer.flush()])


MCAPS: dict[str, tuple[Data, str]] = {
    "MCAP of nothing": (b"", "empty"),
    "MCAP of its first bytes": (_MAGIC, "cut off"),
    "MCAP without a message": (_mcap(), "message"),
    "MCAP chunk of 8 GB": (lambda: _mcap(_chunk(_zstd(400), b"zstd", 8 << 30)), "at most"),
    "MCAP chunk of 200 MB": (lambda: _mcap(_chunk(_zstd(400), b"zstd", 200 << 20)), "times its"),
    "MCAP chunk of 15 MB of zeros": (
        lambda: _mcap(_chunk(_zstd(15), b"zstd", 15 << 20)),
        "no place",
    ),
    "MCAP chunk of 2^62": (_mcap(_chunk(b"", b"zstd", 2**62)), "at most"),
    "MCAP chunk that says 1,000": (lambda: _mcap(_chunk(_zstd(400), b"zstd", 1000)), "more than"),
    "MCAP chunk of LZ4": (lambda: _mcap(_chunk(_lz4(400), b"lz4", 1000)), "more than"),
    "MCAP chunk of LZ4 of 2 GB": (lambda: _mcap(_chunk(_lz4(400), b"lz4", 2 << 30)), "at most"),
    "MCAP chunk of rubbish": (_mcap(_chunk(bytes(range(99)), b"zstd", 99)), "byte"),
    "MCAP chunk packed unknown": (_mcap(_chunk(b"", b"rar", 0)), "rar"),
    "MCAP chunk in a chunk": (
        _mcap(_chunk(_chunk(b"", b"", 0), b"", len(_chunk(b"", b"", 0)))),
        "no place",
    ),
    "MCAP record of 2^62": (_MAGIC + _record(6, bytes(99), 2**62), "byte 8"),
    "MCAP record of 2^64 - 1": (_MAGIC + _record(5, bytes(99), 2**64 - 1), "byte 8"),
    "MCAP text of 4 GB": (_mcap(_record(3, struct.pack("<HI", 1, 2**32 - 1))), "byte"),
    "MCAP message on no channel": (_mcap(_record(5, bytes(22))), "not declared"),
    "MCAP message of two bytes": (_mcap(_record(5, bytes(2))), "too short"),
    "MCAP channel of no schema": (_mcap(_record(4, _CHANNEL), _record(5, b"\1" + bytes(21))), ""),
    "MCAP text that is none": (
        _mcap(_record(3, struct.pack("<H", 1) + _text(b"\xff\xfe") + _text(b"") + _text(b""))),
        "byte",
    ),
    "MCAP with an index that lies": (
        _mcap(_SCHEMA, _record(11, struct.pack("<QHIIIIQQ", 9, 1, 1, 0, 0, 0, 0, 0) + bytes(4))),
        "9 messages announced",
    ),
    "MCAP without an end": (_mcap(_SCHEMA)[: -len(_ENDED)], "cut off"),
    "MCAP with a wrong footer": (_mcap()[: -len(_ENDED)] + _record(2, bytes(3)) + _MAGIC, "footer"),
    "MCAP with a tail": (_mcap() + b"x", "end where"),
    "MCAP of 100,000 empty records": (lambda: _mcap(_record(0x70, b"") * 100_000), ""),
}

_SCANS = "sensor_msgs/msg/LaserScan"
_TWO_TYPES = (
    "a_msgs/A a\n================\nMSG: a_msgs/A\nb_msgs/B b\n================\n"
    "MSG: b_msgs/B\na_msgs/A[] a"
)
DEFINITIONS: dict[str, tuple[str, str]] = {
    "an array of 5 million": ("geometry_msgs/Point[5000000] p", "array of 5000000"),
    "a list of 10^30 at most": (f"float64[<={10**30}] p", "array of 1000000"),
    "20,000 fields": ("\n".join(f"float64 x{i}" for i in range(20_000)), "fields"),
    "a million letters": ("#" + "a" * 1_000_000, "characters long"),
    "a type of itself": (_SCANS, "contains itself"),
    "a type of its own list": (f"{_SCANS}[] again", "contains itself"),
    "two types of each other": (_TWO_TYPES, "contains itself"),
    "code as a name": ("float64 __import__('os').system('true')", "damaged"),
    "code as a type": ("__import__('os').system('true') x", "damaged"),
    "code as a constant": ("string X='''+__import__('os').abort()+'''", "damaged"),
    "nothing that is a definition": ("{[(", "damaged"),
    "other fields": ("float64 a\nfloat64 b", "a.mcap"),
}


def _defined(definition: str) -> Fill:
    def fill(folder: Path) -> None:
        text = (
            definition.replace(_SCANS, f"{_SCANS} again", 1) if definition == _SCANS else definition
        )
        as_mcap(
            folder / "a.mcap", Robot(ROS2).drive(), CompressionType.ZSTD, definitions={_SCANS: text}
        )

    return fill


def _bag2(change: Callable[[Path], None]) -> Fill:
    def fill(folder: Path) -> None:
        change(as_rosbag2(folder / "bag", Robot(ROS2).drive()))

    return fill


def _metadata(old: str, new: str, path: Path) -> None:
    file = path / "metadata.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text, text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def _sql(command: str, path: Path) -> None:
    (file,) = path.glob("*.db3")
    with closing(sqlite3.connect(file)) as db:
        db.execute(command)
        db.commit()


def _bytes(place: int, data: bytes, path: Path) -> None:
    (file,) = path.glob("*.db3")
    content = bytearray(file.read_bytes())
    content[place : place + len(data)] = data
    file.write_bytes(content)


_INFORMATION = "rosbag2_bagfile_information:\n"
FOLDERS: dict[str, tuple[Callable[[Path], None], str]] = {
    "metadata of merges": (
        partial(_metadata, _INFORMATION, f"a: &a [1]\nb: *a\n{_INFORMATION}"),
        "alias",
    ),
    "metadata of brackets": (partial(_metadata, _INFORMATION, f"a: {'[' * 5000}\n"), "nested"),
    "metadata that counts wrong": (
        partial(_metadata, "\n  message_count: 1", "\n  message_count: 9"),
        "messages",
    ),
    "metadata of another file": (
        partial(_metadata, "  - bag.db3", "  - ../../../../etc/passwd"),
        "passwd",
    ),
    "metadata of nothing": (partial(_metadata, _INFORMATION, "x:\n"), "rosbag2_bagfile"),
    "metadata whose files are a number": (
        partial(_metadata, "relative_file_paths:\n", "relative_file_paths: 7\nx:\n"),
        "metadata.yaml",
    ),
    "a database of other pages": (partial(_bytes, 16, b"\xff\xff"), "damaged"),
    "a database of rubbish": (partial(_bytes, 100, bytes(range(256)) * 40), "damaged"),
    "a database without messages": (partial(_sql, "DROP TABLE messages"), "damaged"),
    "a database of a view": (
        partial(
            _sql,
            "CREATE VIEW x AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n+1 FROM c) "
            "SELECT * FROM c",
        ),
        "not a plain table",
    ),
    "a database whose messages are text": (
        partial(_sql, "UPDATE messages SET data = 'abc'"),
        "bag",
    ),
    "a database whose stamps are text": (
        partial(_sql, "UPDATE messages SET timestamp = 'abc'"),
        "bag",
    ),
    "a database with a message of 90 MB": (
        partial(_sql, "UPDATE messages SET data = zeroblob(90000000) WHERE id = 3"),
        "at most",
    ),
    "a database of unknown types": (partial(_sql, "UPDATE topics SET type = 'a/msg/B'"), "bag"),
    "a database of long types": (
        partial(_sql, "UPDATE topics SET type = printf('%.*c', 500000, 'x')"),
        "bag",
    ),
    "qualities with aliases": (
        partial(_sql, "UPDATE topics SET offered_qos_profiles = 'a: &a [1]\nb: *a'"),
        "",
    ),
    "qualities without end": (
        partial(_sql, "UPDATE topics SET offered_qos_profiles = printf('%.*c', 5000000, 'x')"),
        "",
    ),
}
"""What is done to a rosbag2 folder with a database, and words of the refusal."""


def _header(**fields: bytes) -> bytes:
    parts = b"".join(_text(name.encode() + b"=" + value) for name, value in fields.items())
    return _text(parts)


def _bag1(*records: bytes) -> bytes:
    index = struct.pack("<Q", 0)
    head = _header(op=b"\3", index_pos=index, conn_count=bytes(4), chunk_count=bytes(4))
    return _ROS1_MAGIC + head + _text(b" " * 4000) + b"".join(records)


def _chunk1(content: bytes, compression: bytes, announced: int) -> bytes:
    size = struct.pack("<I", announced)
    return _header(op=b"\5", compression=compression, size=size) + _text(content)


BAGS: dict[str, tuple[Data, str]] = {
    "bag of its first line": (_ROS1_MAGIC, "a.bag"),
    "bag of version 1.2": (b"#ROSRECORD V1.2\n" + bytes(99), "only 2.0 is read; `rosbag reindex "),
    "bag of version 1.1": (b"#ROSLOG V1.1\n" + bytes(99), "of version 1.1, but only 2.0 is read"),
    "bag record of 4 GB": (_bag1(b"\xff" * 8), "beyond the end"),
    "bag field of 4 GB": (_bag1(_text(b"\xff\xff\xff\xff") + _text(b"")), "damaged"),
    "bag without an operation": (_bag1(_header(a=b"b") + _text(b"")), "damaged"),
    "bag chunk of 4 GB": (lambda: _bag1(_chunk1(_lz4(200), b"lz4", 2**32 - 1)), "at most"),
    "bag chunk that says 1,000": (lambda: _bag1(_chunk1(_lz4(200), b"lz4", 1000)), "more than"),
    "bag chunk packed unknown": (_bag1(_chunk1(b"", b"rar", 0)), "rar"),
    "bag chunk of rubbish": (_bag1(_chunk1(bytes(range(99)), b"bz2", 99)), "damaged"),
    "bag of 100,000 records": (lambda: _bag1((_header(op=b"\6") + _text(b"")) * 100_000), "a.bag"),
}


def _table(columns: dict[str, object], facts: bytes = b"{}") -> Fill:
    def fill(folder: Path) -> None:
        (folder / "parquet").mkdir()
        table = pa.table(columns).replace_schema_metadata({b"slamsim": facts})
        for name in ("scans", "transforms"):
            pq.write_table(table, folder / "parquet" / f"{name}.parquet", compression="zstd")

    return fill


def _many_rows(folder: Path) -> None:
    _table({"stamp_ns": pa.array(np.zeros(30_000_000, np.int64))})(folder)


TABLES: dict[str, tuple[Fill, str]] = {
    "tables of nothing": (_table({}), "parquet"),
    "tables of other columns": (_table({"a": [1, 2]}), "parquet"),
    "tables of odd facts": (_table({"a": [1]}, b"[[[["), "parquet"),
    "tables of 200,000 brackets": (_table({"a": [1]}, b"[" * 200_000), "parquet"),
    "tables of 30 million equal rows": (_many_rows, "parquet"),
}


def hostile_bags() -> Iterator[Hostile]:
    """All of them."""
    for number, (name, (data, words)) in enumerate(MCAPS.items()):
        command = ("check",) if number % 8 == 0 else ()
        yield Hostile(name, "a.mcap", one("a.mcap", data), log, words or "message", command)
    for name, (definition, words) in DEFINITIONS.items():
        yield Hostile(f"definition: {name}", "a.mcap", _defined(definition), log, words)
    for name, (change, words) in FOLDERS.items():
        yield Hostile(name, "bag", _bag2(change), log, words)
    for name, (data, words) in BAGS.items():
        yield Hostile(name, "a.bag", one("a.bag", data), log, words)
    for name, (fill, words) in TABLES.items():
        yield Hostile(name, "parquet", fill, log, words)
    yield Hostile("bag cut off", "a.bag", _cut_bag, log, "a.bag", ("map",))


def _cut_bag(folder: Path) -> None:
    path = as_ros1(folder / "a.bag", Robot(ROS1).drive(), "BZ2")
    path.write_bytes(path.read_bytes()[:-999])
