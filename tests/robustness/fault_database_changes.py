"""Changes to a recording in SQLite by way of SQL: sound pages, odd contents."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import numpy as np
from fault_changes import PLAIN
from fault_seeds import Unfit

_VALUES = (
    None,
    0,
    -1,
    2**62,
    -(2**63),
    1.5,
    float("inf"),
    "",
    "text",
    "\x1b[2J",
    "x" * 5000,
    b"",
    b"\0" * 40,
    "- history: &a [*a]",
)
_STATEMENTS = (
    "DELETE FROM messages WHERE id % 3 = 0",
    "DELETE FROM topics WHERE id = 2",
    "DELETE FROM message_definitions",
    "DROP TABLE message_definitions",
    "DROP TABLE metadata",
    "DROP TABLE schema",
    "DROP TABLE topics",
    "DROP TABLE messages",
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "ALTER TABLE topics DROP COLUMN offered_qos_profiles",
    "ALTER TABLE topics RENAME COLUMN name TO title",
    "INSERT INTO messages SELECT id + 100000, topic_id, timestamp, data FROM messages",
    "INSERT INTO topics SELECT id + 100, name, type, serialization_format, "
    "offered_qos_profiles, type_description_hash FROM topics",
    "UPDATE messages SET timestamp = -timestamp",
    "UPDATE messages SET topic_id = topic_id + 1",
    "UPDATE messages SET data = zeroblob(70000000) WHERE id = 1",
    "UPDATE messages SET data = (SELECT data FROM messages LIMIT 1)",
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM messages; END",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT m.id AS id, m.topic_id AS "
    "topic_id, m.timestamp AS timestamp, m.data AS data FROM m, m AS n, m AS o",
    "CREATE TABLE other (a); PRAGMA application_id = 7; PRAGMA user_version = 99",
    "PRAGMA journal_mode = WAL",
    "PRAGMA encoding = 'UTF-16'; VACUUM",
)


def change_database(data: bytes, rng: np.random.Generator) -> bytes:
    """Values, rows, columns, tables."""
    try:
        with closing(sqlite3.connect(":memory:")) as db:
            db.deserialize(data)
            _change(db, rng)
            db.commit()
            return db.serialize()
    except (sqlite3.Error, OverflowError) as error:
        raise Unfit from error


def _change(db: sqlite3.Connection, rng: np.random.Generator) -> None:
    kind = int(rng.integers(3))
    if kind == 0:
        db.executescript(_STATEMENTS[int(rng.integers(len(_STATEMENTS)))])
        return
    tables = ("messages", "messages", "topics", "topics", "message_definitions", "metadata")
    table = tables[int(rng.integers(len(tables)))]
    columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
    rows = [row for (row,) in db.execute(f"SELECT rowid FROM {table}")]
    if not columns or not rows:
        raise Unfit
    column, row = columns[int(rng.integers(len(columns)))], rows[int(rng.integers(len(rows)))]
    (value,) = db.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone()
    where = "" if rng.random() < 0.2 else f"WHERE rowid = {row}"
    if kind == 1 and isinstance(value, str | bytes) and value:
        plain = value if isinstance(value, bytes) else value.encode()
        changed = PLAIN[int(rng.integers(len(PLAIN)))](plain, rng)
        other: object = changed if isinstance(value, bytes) else changed.decode("utf-8", "replace")
    else:
        other = _VALUES[int(rng.integers(len(_VALUES)))]
    db.execute(f"UPDATE {table} SET {column} = ? {where}", (other,))
