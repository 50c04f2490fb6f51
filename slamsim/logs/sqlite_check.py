"""Looks through a rosbag2 SQLite file before anyone reads it: pages, sizes, definitions."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import zstandard

from slamsim.logs.bag_limits import BagFacts, check_qos
from slamsim.safe.errors import Excessive, InputRefused, limit_of
from slamsim.safe.files import open_input, require_magic
from slamsim.safe.limits import LIMITS, Limits

_MAGIC = b"SQLite format 3\0"


def check_sqlite(path: Path, compressed_messages: bool, limits: Limits = LIMITS) -> BagFacts:
    """What is in the file; InputRefused for a damaged or foreign one and for bombs.

    The format has no checksum over its data: what sits inside a message is believed.
    """
    with open_input(path) as file:
        require_magic(file, path, _MAGIC, "SQLite file")
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as db:
            return _check(db, compressed_messages, limits)
    except (sqlite3.Error, ValueError, zstandard.ZstdError, UnicodeDecodeError) as error:
        reason = f"damaged, or no recording ({error})"
        raise InputRefused(path, reason, limit=limit_of(error)) from error


def _check(db: sqlite3.Connection, compressed_messages: bool, limits: Limits) -> BagFacts:
    (verdict,) = db.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise ValueError(str(verdict)[:200])
    count, largest = db.execute("SELECT count(*), max(length(data)) FROM messages").fetchone()
    if (largest or 0) > limits.bag_record_bytes:
        reason = f"a message of {largest:,} bytes, at most {limits.bag_record_bytes:,} are read"
        raise Excessive(reason, "bag_record_bytes")
    if compressed_messages:
        for (data,) in db.execute("SELECT data FROM messages"):
            _require_small(data, limits)
    tables = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type='table'")}
    columns = {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    if "offered_qos_profiles" in columns:
        for (text,) in db.execute("SELECT offered_qos_profiles FROM topics"):
            check_qos(text or "", limits)
    definitions: tuple[tuple[str, str], ...] = ()
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        definitions = tuple((str(name), str(text)) for name, text in db.execute(query))
    return BagFacts(int(count), definitions)


def _require_small(data: bytes, limits: Limits) -> None:
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
        left = limits.bag_record_bytes
        while left > 0 and (block := reader.read(1 << 16)):
            left -= len(block)
    if left <= 0:
        reason = f"a message unpacks to more than {limits.bag_record_bytes:,} bytes"
        raise Excessive(reason, "bag_record_bytes")
