"""What mutations found in the readers of recordings: each of it small, and what it must come to."""

from __future__ import annotations

import sqlite3
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from fault_content import Content, Raw, as_db3, as_mcap, as_ros1_bag, content
from fault_judge import Try, attempt
from fault_log_reads import judged_quickly, whole_log
from mcap.writer import CompressionType

from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.files import read_input
from slamsim.io.open import read_log, read_recording
from slamsim.io.parquet.writer import ParquetLog
from slamsim.io.text.tum import stamp_ns_from_decimal

pytestmark = pytest.mark.fault

READS = (whole_log, judged_quickly)


def changed(held: Content, topic: str, change: Callable[[Raw], Raw]) -> Content:
    raws = tuple(change(raw) if raw.topic == topic else raw for raw in held.messages)
    return replace(held, messages=raws)


def packed(path: Path, held: Content) -> Path:
    return as_mcap(path, held, CompressionType.ZSTD)


@pytest.mark.parametrize("topic", ["/scan\x1b[2J", "/a\nb", "/\u202eevil"])
def test_topics_that_a_terminal_would_obey_are_refused(topic: str, tmp_path: Path) -> None:
    held = changed(content(2), "/scan", lambda raw: replace(raw, topic=topic))
    for read in READS:
        with pytest.raises(InputRefused, match="not a valid name") as caught:
            read(packed(tmp_path / "a.mcap", held))
        assert str(caught.value).isprintable()


def test_frames_that_a_terminal_would_obey_are_shown(tmp_path: Path) -> None:
    held = changed(
        content(2), "/scan", lambda raw: replace(raw, data=raw.data.replace(b"laser", b"l\x1b[2J"))
    )
    path = packed(tmp_path / "a.mcap", held)
    assert next(iter(read_log(path).scans)).geometry.frame_id == r"l\x1b[2J"
    for read in READS:
        assert attempt(Try("frames", lambda read=read: read(path))).good  # type: ignore[misc]


@pytest.mark.parametrize(
    "text",
    [
        "std_msgs/Header header\n" + "=" * 80 + "\nMSG: std_msgs/Header\nstring frame_id\n",
        "float32[] ranges\n",
        "this is none",
        "std_msgs/Header header\nstring angle_min\n",
    ],
)
@pytest.mark.parametrize("topic", ["/scan", "/imu", "/odom", "/tf_static"])
def test_types_without_what_their_names_promise(topic: str, text: str, tmp_path: Path) -> None:
    kind = next(raw.kind for raw in content(2).messages if raw.topic == topic)
    held = replace(content(2), definitions={**content(2).definitions, kind: text})
    path = packed(tmp_path / "a.mcap", held)
    for read in READS:
        assert attempt(Try(topic, lambda read=read: read(path))).good  # type: ignore[misc]


def test_parts_that_are_defined_otherwise_are_no_plain_messages(tmp_path: Path) -> None:
    """The scan's own fields are the standard ones, its header's are in another order."""
    kind = "sensor_msgs/msg/LaserScan"
    text = content(2).definitions[kind]
    other = text.replace(
        "builtin_interfaces/Time stamp\nstring frame_id", "string frame_id\nint64 stamp"
    )
    assert other != text
    held = replace(content(2), definitions={**content(2).definitions, kind: other})
    with pytest.raises(InputRefused):
        read_log(packed(tmp_path / "a.mcap", held))


def test_a_definition_must_fit_its_hash(tmp_path: Path) -> None:
    bag = as_ros1_bag(tmp_path / "a.bag", content(1), "")
    data = bag.read_bytes()
    bag.write_bytes(data.replace(b"float32 angle_min", b"float32 angle_mix"))
    with pytest.raises(InputRefused, match="does not fit its hash"):
        read_log(bag)
    base = as_db3(tmp_path / "a.db3", content(2))
    with closing(sqlite3.connect(base)) as db:
        db.execute(
            "UPDATE message_definitions SET encoded_message_definition = "
            "replace(encoded_message_definition, 'angle_min', 'angle_mix')"
        )
        db.commit()
    with pytest.raises(InputRefused, match="does not fit its hash"):
        read_log(base)


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("UPDATE messages SET data = NULL WHERE id = 7", "another type"),
        ("UPDATE messages SET data = 'text' WHERE id = 7", "another type"),
        ("UPDATE messages SET timestamp = 'late' WHERE id = 7", "another type"),
        ("UPDATE topics SET name = x'00ff'", "another type"),
        ("UPDATE message_definitions SET encoding = NULL", "another type"),
        ("UPDATE messages SET topic_id = 99 WHERE id = 7", "belong to no topic"),
        ("ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT m.id AS id, m.topic_id "
         "AS topic_id, m.timestamp AS timestamp, m.data AS data FROM m, m AS n, m AS o, m AS p",
         "not a plain table"),
        ("CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM messages; END",
         "not a plain table"),
        ("ALTER TABLE messages RENAME COLUMN data TO d; ALTER TABLE messages ADD COLUMN data BLOB "
         "GENERATED ALWAYS AS (zeroblob(50000000)) VIRTUAL", "computed"),
    ],
)  # fmt: skip
def test_databases_that_are_no_recordings(statement: str, told: str, tmp_path: Path) -> None:
    path = as_db3(tmp_path / "a.db3", content(2))
    with closing(sqlite3.connect(path)) as db:
        db.executescript(statement)
    for read in READS:
        with pytest.raises(InputRefused, match=told):
            read(path)


def test_the_index_of_a_ros_1_bag_is_not_followed_but_compared(tmp_path: Path) -> None:
    bag = as_ros1_bag(tmp_path / "a.bag", content(1), "")
    data = bag.read_bytes()
    right = list(read_log(bag).scans)
    at = data.index(b"index_pos=") + 10
    bag.write_bytes(data[:at] + b"\xff" * 8 + data[at + 8 :])
    again = list(read_log(bag).scans)
    assert [scan.stamp_ns for scan in again] == [scan.stamp_ns for scan in right]
    info = data.rindex(b"op=\x06")
    for entry in (data[: data.index(b"op=\x06") - 8], data[:info] + b"op=\x07" + data[info + 4 :]):
        bag.write_bytes(entry)
        with pytest.raises(InputRefused, match="damaged"):
            read_log(bag)


def test_numbers_beyond_all_measure_are_left_out_without_a_warning(tmp_path: Path) -> None:
    huge = np.array([1e300]).tobytes()

    def enlarged(raw: Raw) -> Raw:
        return replace(raw, data=raw.data[:68] + huge * 4 + raw.data[100:])

    path = packed(tmp_path / "a.mcap", changed(content(2), "/odom", enlarged))
    verdicts = [attempt(Try("huge", lambda read=read: read(path))) for read in READS]  # type: ignore[misc]
    assert all(verdict.good for verdict in verdicts), verdicts


@pytest.mark.parametrize("reading", ["1e-320", "1e308", "-1e308", "29.999999999", "nan", "1e-46"])
def test_carmen_readings_stay_within_their_bounds(reading: str, tmp_path: Path) -> None:
    path = tmp_path / "a.clf"
    line = "FLASER 2 1.0 {} 0 0 0 {} 0 0 {} host 0\n"
    lines = [line.format(reading if i == 3 else 2.0, 0.1 * i, 100 + i) for i in range(9)]
    path.write_text("PARAM robot_front_laser_max 30.0 1 h 1\n" + "".join(lines))
    scans = list(read_log(path).scans)
    assert len(scans) == 9
    for scan in scans:
        met = scan.ranges_m[np.isfinite(scan.ranges_m)]
        assert ((met > 0.0) & (met < np.float32(30.0))).all()


def test_stamps_whose_difference_would_not_fit_are_none() -> None:
    assert stamp_ns_from_decimal("4611686018.427387904") == 2**62
    for text in ("4611686018.427387905", "-4611686019", "9223372036", "1e11"):
        with pytest.raises(ValueError, match=r"does not fit|is not a stamp"):
            stamp_ns_from_decimal(text)


Table = Callable[[pa.Table], pa.Table]


def _replaced(name: str, value: pa.Array | list[object]) -> Table:
    def replace_column(table: pa.Table) -> pa.Table:
        return table.set_column(table.column_names.index(name), name, pa.array(value))

    return replace_column


def _facts(old: bytes, new: bytes) -> Table:
    def replace_fact(table: pa.Table) -> pa.Table:
        text = table.schema.metadata[b"slamsim"]
        assert old in text
        return table.replace_schema_metadata({b"slamsim": text.replace(old, new, 1)})

    return replace_fact


def _gaps(table: pa.Table) -> pa.Table:
    ranges_m = table["ranges_m"].combine_chunks()
    gaps = pc.if_else(pa.array([i != 3 for i in range(len(table))]), ranges_m, None)
    field = pa.field("ranges_m", ranges_m.type)
    return table.set_column(table.column_names.index("ranges_m"), field, gaps)


TABLES: dict[str, tuple[str, Table]] = {
    "a column is missing": ("imu", lambda table: table.drop_columns(["angular_velocity_z_rad_s"])),
    "stamps with gaps": ("imu", _replaced("stamp_ns", [None, *range(42)])),
    "stamps of a text": ("odometry", _replaced("stamp_ns", [str(i) for i in range(43)])),
    "no time": ("odometry", _replaced("received_ns", [2**63 - 1 - i for i in range(43)])),
    "numbers for names": ("transforms", _replaced("parent", [0.5] * 46)),
    "a layout that is not there": ("scans", _replaced("layout", pa.array([7] * 20, pa.uint8()))),
    "a layout of words": ("scans", _facts(b'"range_max_m": 20.0', b'"range_max_m": "far"')),
    "a topic that is a list": ("encoders", _facts(b'"/wheel_ticks"', b"[1]")),
    "a topic without a name": ("encoders", _facts(b'"/wheel_ticks"', b'" "')),
    "no frame": ("imu", _facts(b'["imu_link"]', b"[]")),
    "another epoch": ("scans", _facts(b'"epoch": "unix"', b'"epoch": "stone age"')),
    "rows without ranges": ("scans", _gaps),
    "no row": ("imu", lambda table: table.slice(0, 0)),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_that_are_no_recordings(name: str, tmp_path: Path) -> None:
    source = packed(tmp_path / "a.mcap", content(2))
    with ParquetLog(tmp_path / "parquet") as written:
        written.write(read_recording(source))
    table, change = TABLES[name]
    path = tmp_path / "parquet" / f"{table}.parquet"
    pq.write_table(change(pq.read_table(path)), path)
    for read in READS:
        with pytest.raises(InputRefused) as caught:
            read(tmp_path / "parquet")
        assert caught.value.path == path


def test_a_small_file_needs_little_memory_whatever_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "session.npz"
    path.write_bytes(bytes(1000))
    tracemalloc.start()
    assert read_input(path, "saved_map_bytes") == bytes(1000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6


def test_messages_hold_nothing_that_a_terminal_obeys_and_no_screenful() -> None:
    assert str(SlamsimError("a\x1b[2J\r\nb\u202e")) == "a\\x1b[2J\\r\nb\\u202e"
    refusal = InputRefused("a", "two\nlines\0", "topic " + "x" * 5000)
    assert refusal.reason == "two lines\\x00"
    assert "\n" not in str(refusal) and len(str(refusal)) < 300
