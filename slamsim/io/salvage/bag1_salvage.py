"""Finds the intact records and connections of a damaged ROS 1 bag.

The format has no checksums (only bz2 has its own), so a record is whole if its header and its
lengths are sound. A chunk that is not compressed, whole or not, is walked through like the file
itself. After damage the walk goes on at the next thing that reads as a header. Format:
wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from struct import iter_unpack

from rosbags.typesys import Stores, get_typestore

from slamsim.guard.limits import LIMITS
from slamsim.io.bag1.reader import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAGIC,
    MESSAGE,
    chunk_content,
    header_fields,
    records_in_chunk,
)
from slamsim.io.ros.message_types import check_definitions, normal_type_name, register
from slamsim.io.salvage.source import DamagedFile, LoneMessage


@dataclass(frozen=True, slots=True)
class Connection:
    """record: with its header."""

    number: int
    topic: str
    type_name: str
    definition: str
    md5sum: str
    record: bytes

    def fits_its_hash(self) -> bool:
        """Whether the definition is the one whose MD5 stands beside it.

        A bag describes a connection twice, so that one of them may be damaged.
        """
        return _md5sum(normal_type_name(self.type_name), self.definition) == self.md5sum


@lru_cache(maxsize=256)
def _md5sum(name: str, definition: str) -> str | None:
    """As ROS 1 computes it; None for a definition that cannot be."""
    try:
        check_definitions([(name, definition)])
        store = get_typestore(Stores.EMPTY)
        register(store, name, "ros1msg", definition)
        return store.generate_msgdef(name, ros_version=1)[1]
    except Exception:
        return None


def connection(fields: dict[bytes, bytes], record: bytes, data: int) -> Connection:
    """The one in a record with this header, whose data begin at byte ``data``.

    Raises ValueError if it is none.
    """
    described = header_fields(record[data:])
    texts = {name: described.get(name, b"").decode() for name in (b"type", b"message_definition")}
    if not texts[b"type"]:
        raise ValueError("a connection without a type")
    return Connection(
        int.from_bytes(fields[b"conn"], "little"),
        fields[b"topic"].decode(),
        texts[b"type"],
        texts[b"message_definition"],
        described.get(b"md5sum", b"").decode(),
        record,
    )


Fields = dict[bytes, bytes]

_HEADER_BYTES = 1 << 16
_WINDOW_BYTES = 1 << 20
_NEEDED: Mapping[bytes, Mapping[bytes, int | None]] = {
    MESSAGE: {b"conn": 4, b"time": 8},
    BAG_HEADER: {b"index_pos": 8, b"chunk_count": 4},
    INDEX: {b"conn": 4, b"count": 4},
    CHUNK: {b"size": 4, b"compression": None},
    CHUNK_INFO: {b"chunk_pos": 8, b"count": 4},
    CONNECTION: {b"conn": 4, b"topic": None},
}
_NAMES = {b"op", b"ver", b"conn_count", b"start_time", b"end_time"}.union(*_NEEDED.values())
_HEADER_SHAPE = re.compile(rb"(?=..\0\0..\0\0(?:" + b"|".join(sorted(_NAMES)) + rb")=)", re.DOTALL)
_SHAPE_BYTES = 32


@dataclass(frozen=True, slots=True)
class Head:
    """A record with a sound header. begin: its first byte. data: the first of its data."""

    fields: Fields
    begin: int
    data: int
    end: int

    @property
    def op(self) -> bytes:
        return self.fields[b"op"]


@dataclass(frozen=True, slots=True)
class WholeBag1Chunk:
    """packed: as it is in the file. content: the records in it."""

    compression: str
    packed: bytes
    content: bytes


Piece = Connection | WholeBag1Chunk | LoneMessage


@dataclass(slots=True)
class Bag1Summary:
    """What the end of a bag says. messages: by connection, None unless it is whole."""

    connections: list[Connection] = field(default_factory=list)
    messages: Counter[int] | None = None


class Bag1Salvage(DamagedFile[Head, Piece]):
    """A damaged bag. index: what could be read of it."""

    MAGIC, KIND = MAGIC, "a ROS 1 bag"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.index = self._index()

    def _record_at(self, position: int) -> Head | str:
        head = self._head_at(position)
        if isinstance(head, str):
            return head
        if _is_plain_chunk(head):
            return replace(head, end=head.data)
        if head.end > self.size:
            return "the file is cut off in this record, or its length is damaged"
        return head

    def _piece(self, record: Head) -> Piece | None:
        if _is_plain_chunk(record):
            return None
        if record.op == CHUNK:
            packed = self._at(record.data, record.end - record.data)
            content = chunk_content(record.fields, packed)
            for fields, begin, data, end in records_in_chunk(content):
                _require_sound(fields)
                if fields[b"op"] == CONNECTION:
                    connection(fields, content[begin:end], data - begin)
            return WholeBag1Chunk(record.fields[b"compression"].decode(), packed, content)
        whole = self._at(record.begin, record.end - record.begin)
        if record.op == CONNECTION:
            return connection(record.fields, whole, record.data - record.begin)
        if record.op == MESSAGE:
            if not self._may_begin(record.end):
                raise ValueError("the length of a message is damaged")
            return LoneMessage(whole)
        return None

    def _after_damaged(self, record: Head) -> tuple[int, dict[int, int] | None]:
        return self._indexes_at(record.end) if record.op == CHUNK else (record.end, {})

    def _head_at(self, position: int) -> Head | str:
        """The record there, whose data may reach beyond the file; or why there is none."""
        length = int.from_bytes(self._at(position, 4), "little")
        if not 0 < length <= _HEADER_BYTES:
            return "here is no record"
        block = self._at(position + 4, length + 4)
        if len(block) < length + 4:
            return "the file is cut off here"
        try:
            fields = header_fields(block[:length])
            _require_sound(fields)
        except ValueError as error:
            return str(error)
        data = position + length + 8
        size = int.from_bytes(block[length:], "little")
        most = LIMITS.bag_chunk_bytes if fields[b"op"] == CHUNK else LIMITS.bag_record_bytes
        if size > most:
            return f"a record of {size:,} bytes is larger than any in a recording"
        return Head(fields, position, data, data + size)

    def _may_begin(self, position: int) -> bool:
        length = int.from_bytes(self._at(position, 4), "little")
        is_cut = position + 8 + length > self.size and length <= _HEADER_BYTES
        return is_cut or isinstance(self._head_at(position), Head)

    def _next_place(self, position: int) -> int:
        while window := self._at(position, _WINDOW_BYTES + _SHAPE_BYTES):
            for match in _HEADER_SHAPE.finditer(window):
                place = position + match.start()
                head = self._head_at(place)
                if isinstance(head, Head) and (head.end <= self.size or head.op == CHUNK):
                    return place
            position += _WINDOW_BYTES
        return self.size

    def _indexes_at(self, position: int) -> tuple[int, dict[int, int] | None]:
        """(end, messages by connection) of the indexes that follow a chunk."""
        counts = Counter[int]()
        while isinstance(head := self._head_at(position), Head) and head.op == INDEX:
            counts[_number(head.fields[b"conn"])] += _number(head.fields[b"count"])
            position = head.end
        return position, dict(counts) or None

    def _index(self) -> Bag1Summary:
        """What stands where the header of the bag says; nothing if that is damaged."""
        index, counts, chunks = Bag1Summary(), Counter[int](), 0
        head = self._head_at(len(MAGIC))
        if isinstance(head, str) or head.op != BAG_HEADER:
            return index
        announced, position = head.fields[b"chunk_count"], _number(head.fields[b"index_pos"])
        while 0 < position < self.size and isinstance(head := self._head_at(position), Head):
            if head.op not in (CONNECTION, CHUNK_INFO) or head.end > self.size:
                break
            data = self._at(head.data, head.end - head.data)
            if head.op == CHUNK_INFO:
                chunks += 1
                for conn, count in iter_unpack("<II", data[: len(data) // 8 * 8]):
                    counts[conn] += count
            else:
                record = self._at(head.begin, head.end - head.begin)
                with suppress(ValueError):
                    found = connection(head.fields, record, head.data - head.begin)
                    index.connections.append(found)
            position = head.end
        index.messages = counts if chunks == _number(announced) else None
        return index


def _is_plain_chunk(head: Head) -> bool:
    """Whether its records can be walked over like those of the file."""
    return head.op == CHUNK and head.fields[b"compression"] == b"none"


def _require_sound(fields: Fields) -> None:
    """Raises ValueError unless these are the fields of a record."""
    needed = _NEEDED.get(fields.get(b"op", b""))
    if needed is None:
        raise ValueError("here is no record")
    for name, length in needed.items():
        if name not in fields or length not in (None, len(fields[name])):
            raise ValueError("the header of a record is damaged")


def _number(value: bytes) -> int:
    return int.from_bytes(value, "little")
