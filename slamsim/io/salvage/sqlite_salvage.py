"""Reads a damaged rosbag2 SQLite file around its damaged pages.

A journal beside the file, as a killed recorder leaves it, is taken into account; a file that was
cut off is read as far as it goes.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from slamsim.guard.files import open_as_found
from slamsim.guard.limits import LIMITS
from slamsim.io.bag2.sqlite import require_plain

_JOURNALS = ("-wal", "-journal")
LARGEST_ID = 2**62
_MOST_HOLES = 10_000

Row = tuple[Any, ...]


class SqliteSalvage:
    """A damaged file open for reading; the caller closes ``db``.

    work: a folder for a copy, where a journal or half a page at the end needs one. lost: ranges of
    ids, of those rows that were asked for. Raises sqlite3.Error, or ValueError if there are no
    tables that can be read.
    """

    def __init__(self, path: Path, work: Path) -> None:
        half_page = _half_page(path)
        journals = [name for name in _JOURNALS if Path(f"{path}{name}").is_file()]
        source, options = path, "mode=ro&immutable=1"
        if journals or half_page:
            work.mkdir()
            source, options = work / path.name, "mode=rw"
            for name in ("", *journals):
                shutil.copyfile(f"{path}{name}", f"{source}{name}")
            os.truncate(source, path.stat().st_size - half_page)
        self.db = sqlite3.connect(f"{source.resolve().as_uri()}?{options}", uri=True)
        self.db.text_factory = lambda text: text.decode(errors="replace")
        self.db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LIMITS.bag_record_bytes)
        # else a file that is shorter than its header says is not read at all
        self.db.execute("PRAGMA writable_schema = ON")
        self.db.execute("PRAGMA trusted_schema = OFF")
        require_plain(self.db)
        self.lost: list[tuple[int, int]] = []
        self._holes = 0

    def rows(self, table: str, columns: str) -> Iterator[Row]:
        """(id, columns) in the order of ids; where a page is damaged the next one goes on."""
        first, last = self._end("min", table, 1), self._end("max", table, LARGEST_ID)
        query = f"SELECT id, {columns} FROM {table} WHERE id BETWEEN ? AND ? ORDER BY id"
        while first <= last and self._holes < _MOST_HOLES:
            try:
                for row in self._asked(query, first, last):
                    first = row[0] + 1
                    yield row
                return
            except sqlite3.Error:
                sound = self._next_sound(query, first, last)
            self.lost.append((first, sound - 1))
            self._holes += 1
            first = sound

    def _asked(self, query: str, first: int, last: int) -> Iterator[Row]:
        """A damaged tree may lead to rows that were not asked for."""
        for row in self.db.execute(query, (first, last)):
            if not first <= row[0] <= last:
                raise sqlite3.DatabaseError("a page is not where it belongs")
            yield row
            first = row[0] + 1

    def _next_sound(self, query: str, damaged: int, last: int) -> int:
        """The first id after a damaged one from which on rows can be read, else last + 1."""
        step = 1
        while damaged + step <= last and not self._is_sound(query, damaged + step, last):
            damaged, step = damaged + step, 2 * step
        sound = min(damaged + step, last + 1)
        while sound - damaged > 1:
            middle = (damaged + sound) // 2
            if self._is_sound(query, middle, last):
                sound = middle
            else:
                damaged = middle
        return sound

    def _is_sound(self, query: str, first: int, last: int) -> bool:
        try:
            next(self._asked(f"{query} LIMIT 1", first, last), None)
        except sqlite3.Error:
            return False
        return True

    def columns_of(self, table: str) -> set[str]:
        """Empty without such a table."""
        return {str(row[1]) for row in self.db.execute(f"PRAGMA table_info({table})")}

    def _end(self, which: str, table: str, otherwise: int) -> int:
        """The smallest or largest id, if that can be read."""
        with suppress(sqlite3.Error, TypeError):
            (found,) = self.db.execute(f"SELECT {which}(id) FROM {table}").fetchone()
            return int(found)
        return otherwise


def _half_page(path: Path) -> int:
    """How many bytes after the last whole page: SQLite would take what is missing for zeros."""
    with open_as_found(path) as file:
        file.seek(16)
        page = int.from_bytes(file.read(2), "big")
        size = file.seek(0, 2)
    return size % (65_536 if page == 1 else page) if page else 0
