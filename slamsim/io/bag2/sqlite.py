"""Reads and validates the SQLite files of a rosbag2 recording: tables, types, sizes, pages.

The format has no checksum over its data: what sits inside a message is believed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from slamsim.guard.errors import Excessive
from slamsim.guard.files import open_input, require_magic
from slamsim.guard.limits import LIMITS
from slamsim.io.input_errors import damaged

_MAGIC = b"SQLite format 3\0"
_TYPES = {
    "topics": {"id": "integer", "name": "text", "type": "text", "serialization_format": "text"},
    "messages": {"topic_id": "integer", "timestamp": "integer", "data": "blob"},
}
_SAMPLED = 20
_DEFINITIONS, _HASH = "message_definitions", "type_description_hash"
_QOS = "offered_qos_profiles"
_DEFINITION_TYPES = {"topic_type": "text", "encoding": "text", "encoded_message_definition": "text"}


@dataclass(frozen=True, slots=True)
class SqliteTopic:
    """encoding: ``cdr`` in all that ROS 2 wrote. qos: the profiles that were offered, as YAML."""

    name: str
    type_name: str
    encoding: str
    messages: int
    qos: str = ""


@dataclass(frozen=True, slots=True)
class SqliteIndex:
    """What is in a file. topics: by number. definitions: (type, as what it is written, text).

    hashes: of types, where the file has them. is_sampled: only the first and the last messages of
    each topic are read. span_ns: when the first and the last message was received, None of a file
    without messages.
    """

    path: Path
    topics: dict[int, SqliteTopic]
    definitions: tuple[tuple[str, str, str], ...]
    hashes: dict[str, str]
    span_ns: tuple[int, int] | None
    is_sampled: bool = False


def index_sqlite(path: Path, *, is_sampled: bool = False) -> SqliteIndex:
    """Looks through the file; InputRefused for a damaged or foreign one and for bombs.

    is_sampled: for a first look, which does not check every page of a large file.
    """
    with open_input(path) as file:
        require_magic(file, path, _MAGIC, "SQLite file")
    try:
        with closing(_open(path)) as db:
            if is_sampled:
                require_plain(db)
            else:
                _require_sound(db)
            told = _topics(db), _definitions(db), _hashes(db)
            return SqliteIndex(path, *told, _span_ns(db), is_sampled)
    except (sqlite3.Error, ValueError) as error:
        raise damaged(path, f"damaged, or no recording ({error})", error=error) from error


def sqlite_messages(
    index: SqliteIndex, topics: Collection[int]
) -> Iterator[tuple[int, int, bytes]]:
    """(topic, when it was received in ns, message) of the topics, in the order of time.

    Raises what the libraries raise.
    """
    if not topics:
        return
    marks = ", ".join("?" * len(topics))
    query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})"
    order = "ORDER BY timestamp, rowid"
    with closing(_open(index.path)) as db:
        rows = db.execute(f"{query} {order}", list(topics))
        yield from _ends(db, topics) if index.is_sampled else rows


def _ends(db: sqlite3.Connection, topics: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
    """The first and the last messages of each topic."""
    query = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp"
    for topic in topics:
        first = db.execute(f"{query} LIMIT {_SAMPLED}", (topic,)).fetchall()
        last = db.execute(f"{query} DESC LIMIT {_SAMPLED}", (topic,)).fetchall()
        for row in sorted({*first, *last}, key=lambda row: int(row[1])):
            if not (isinstance(row[2], bytes) and len(row[2]) <= LIMITS.bag_record_bytes):
                raise ValueError("rows of messages hold values of another type, or too large ones")
            yield row


def _open(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)


def _require_sound(db: sqlite3.Connection) -> None:
    """Plain tables with values of the right types."""
    require_plain(db)
    (verdict,) = db.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise ValueError(str(verdict)[:200])
    for table, types in _TYPES.items():
        _require_types(db, table, types)
    (largest,) = db.execute("SELECT max(length(data)) FROM messages").fetchone()
    if (largest or 0) > LIMITS.bag_record_bytes:
        reason = f"a message of {largest:,} bytes, at most {LIMITS.bag_record_bytes:,} are read"
        raise Excessive(reason, "bag_record_bytes")


def require_plain(db: sqlite3.Connection) -> None:
    """Raise ValueError for what is no table of stored values: a view may compute for ever."""
    query = "SELECT name FROM sqlite_master WHERE type NOT IN ('table', 'index') OR sql LIKE ?"
    for (name,) in db.execute(query, ("create virtual%",)):
        raise ValueError(f"{str(name)[:60]!r} is not a plain table")
    for table in (*_TYPES, _DEFINITIONS):
        for row in db.execute(f"PRAGMA table_xinfo({table})"):
            if row[-1]:
                raise ValueError(f"the column {str(row[1])[:60]!r} of {table} is computed")


def _require_types(db: sqlite3.Connection, table: str, types: dict[str, str]) -> None:
    wrong = " OR ".join(f"typeof({name}) <> '{kind}'" for name, kind in types.items())
    (count,) = db.execute(f"SELECT count(*) FROM {table} WHERE {wrong}").fetchone()
    if count:
        raise ValueError(f"{count:,} rows of {table} hold values of another type")


def _topics(db: sqlite3.Connection) -> dict[int, SqliteTopic]:
    query = "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
    counts = dict(db.execute(query).fetchall())
    columns = {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    qos = _QOS if _QOS in columns else "''"  # none before ROS 2 Foxy
    query = f"SELECT id, name, type, serialization_format, {qos} FROM topics"
    topics = {
        number: SqliteTopic(name, type_name, encoding, counts.pop(number, 0), _text(offered))
        for number, name, type_name, encoding, offered in db.execute(query)
    }
    if counts:
        raise ValueError(f"{sum(counts.values()):,} messages belong to no topic")
    return topics


def _span_ns(db: sqlite3.Connection) -> tuple[int, int] | None:
    found = db.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
    if None in found:
        return None
    if not all(isinstance(each, int) for each in found):
        raise ValueError("rows of messages hold values of another type")
    return found[0], found[1]


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _definitions(db: sqlite3.Connection) -> tuple[tuple[str, str, str], ...]:
    """None in files older than ROS 2 Iron."""
    found = db.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (_DEFINITIONS,)).fetchone()
    if found is None:
        return ()
    _require_types(db, _DEFINITIONS, _DEFINITION_TYPES)
    return tuple(db.execute(f"SELECT {', '.join(_DEFINITION_TYPES)} FROM {_DEFINITIONS}"))


def _hashes(db: sqlite3.Connection) -> dict[str, str]:
    """RIHS01 by type, since ROS 2 Iron; any other kind of hash is passed over."""
    if _HASH not in {row[1] for row in db.execute("PRAGMA table_info(topics)")}:
        return {}
    rows = db.execute(f"SELECT type, {_HASH} FROM topics WHERE {_HASH} LIKE 'RIHS01_%'")
    return {type_name: text for type_name, text in rows if isinstance(text, str)}
