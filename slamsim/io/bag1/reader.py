"""Reads and validates ROS 1 bags (format 2.0): sizes, chunks, counts.

Readers that follow the index of a bag believe what it says. This one walks record by record with
bounded memory, as for MCAP, and holds what it finds against what the index announces. The format
has no checksums of its own; only bz2 chunks carry one. Format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from slamsim.guard.errors import Excessive, InputRefused
from slamsim.guard.files import open_input, require_magic
from slamsim.guard.limits import LIMITS
from slamsim.io.input_errors import damaged
from slamsim.io.ros.message_types import inflate

MAGIC = b"#ROSBAG V2.0\n"
ANY_VERSION = re.compile(rb"#ROS(?:BAG|RECORD|LOG) V([0-9.]+)\n")
CONVERTIBLE = "1.2"
"""The one other version that ``rosbag`` of ROS 1 reads."""
HEADER_BYTES = 4096
"""The header of a bag and its padding, without the lengths of both, as ``rosbag`` writes them."""
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = (bytes([op]) for op in range(2, 8))

Fields = dict[bytes, bytes]


@dataclass(frozen=True, slots=True)
class Connection1:
    """What the messages of one publisher are. definition: its text, with those of its parts.

    md5sum: of the type, empty where it was not computed. callerid, latching: where it says them.
    """

    topic: str
    type_name: str
    definition: str
    md5sum: str
    callerid: str | None = None
    latching: str | None = None


@dataclass(slots=True)
class Bag1Index:
    """What a walk over a bag found.

    counts: messages by number of connection. places: where each chunk begins. announced: how many
    messages the index says there are.
    """

    path: Path
    connections: dict[int, Connection1] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    places: list[int] = field(default_factory=list)
    announced: int = 0


def index_bag1(path: Path) -> Bag1Index:
    """Walks over the file; InputRefused, with the byte, for one that is cut, damaged or a bomb."""
    index = Bag1Index(path)
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        _require_bag1(file, path)
        while file.tell() < size:
            position = file.tell()
            try:
                _take(*_record(file, size), position, index)
            except Exception as error:
                detail = " ".join(str(error).split())[:200] or type(error).__name__
                reason = f"{detail} ({type(error).__name__}): the bag is damaged or cut off"
                raise damaged(path, reason, f"byte {position:,}", error) from error
    if undeclared := index.counts.keys() - index.connections.keys():
        reason = f"messages on connection {min(undeclared)}, which is never declared: damaged"
        raise damaged(path, reason)
    found = index.counts.total()
    if index.announced != found:
        reason = f"the index knows {index.announced:,} messages, {found:,} are there"
        raise damaged(path, f"{reason}: a recording that was not ended, or damaged")
    return index


def sampled_bag1(path: Path) -> Bag1Index:
    """As ``index_bag1``, with counts by the index at the end, and places of a few chunks that
    hold the first and the last messages of every connection.

    What the index says is believed: it is for a first look. A bag without one is walked over.
    """
    index = Bag1Index(path)
    chunks: list[tuple[int, int, set[int]]] = []
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        _require_bag1(file, path)
        try:
            head, _ = _record(file, size)
            file.seek(int.from_bytes(head[b"index_pos"], "little"))
            if head[b"op"] != BAG_HEADER or file.tell() < len(MAGIC):
                return index_bag1(path)
            while file.tell() < size:
                fields, data = _record(file, size)
                if fields[b"op"] == CHUNK_INFO:
                    counts = dict(struct.iter_unpack("<II", data))
                    index.counts.update(counts)
                    place = int.from_bytes(fields[b"chunk_pos"], "little")
                    chunks.append((_time_ns(fields[b"start_time"]), place, set(counts)))
                else:
                    _take(fields, data, 0, index)
        except Exception:  # the walk says where it is damaged
            return index_bag1(path)
    chosen: set[int] = set()
    for backward in (False, True):
        seen: set[int] = set()
        for _, place, connections in sorted(chunks, reverse=backward):
            if connections - seen:
                chosen.add(place)
            seen |= connections
    index.places = sorted(chosen)
    return index


def bag1_messages(
    index: Bag1Index, connections: Container[int]
) -> Iterator[tuple[int, int, bytes]]:
    """(connection, when it was received in ns, message) of the connections.

    Chunk after chunk, inside a chunk by time. Raises ValueError and what the libraries raise if
    the file is no longer what it was.
    """
    with open_input(index.path) as file:
        size = file.seek(0, 2)
        for position in index.places:
            file.seek(position)
            content = chunk_content(*_record(file, size))
            found = []
            for fields, _, start, end in records_in_chunk(content):
                if fields[b"op"] != MESSAGE:
                    continue
                if (connection := _number(fields[b"conn"])) in connections:
                    found.append((_time_ns(fields[b"time"]), start, end, connection))
            for received_ns, start, end, connection in sorted(found):
                yield connection, received_ns, content[start:end]


def _require_bag1(file: BinaryIO, path: Path) -> None:
    """Read the first line; InputRefused, and what helps, for another than that of version 2.0."""
    found = ANY_VERSION.match(file.read(len(MAGIC) + 7))
    file.seek(0)
    if found is not None and found[0] != MAGIC:
        version = found[1].decode()
        advice = f"; `rosbag reindex {path.name}` of ROS 1 writes it as 2.0"
        reason = f"a ROS 1 bag of version {version}, but only 2.0 is read"
        raise InputRefused(path, reason + (advice if version == CONVERTIBLE else ""))
    require_magic(file, path, MAGIC, "ROS 1 bag")


def _record(file: BinaryIO, size: int) -> tuple[Fields, bytes]:
    head = header_fields(_block(file, size, "bag_record_bytes"))
    return head, _block(file, size, "bag_chunk_bytes")


def _block(file: BinaryIO, size: int, limit: str) -> bytes:
    length = int.from_bytes(file.read(4), "little")
    if length > size - file.tell():
        raise ValueError("a record reaches beyond the end of the file")
    most: int = getattr(LIMITS, limit)
    if length > most:
        raise Excessive(f"a record of {length:,} bytes, at most {most:,} are read", limit)
    return file.read(length)


def header_fields(data: bytes) -> Fields:
    """The values of a header by name; ValueError unless it is all fields."""
    fields, position = {}, 0
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "little")
        name, separator, value = data[position + 4 : position + 4 + length].partition(b"=")
        position += 4 + length
        if not separator or position > len(data):
            raise ValueError("a header field is damaged")
        fields[name] = value
    return fields


def chunk_content(head: Fields, data: bytes) -> bytes:
    """The records in a chunk with this header, unpacked; raises as ``inflate`` does."""
    size = int.from_bytes(head[b"size"], "little")
    return inflate(data, head[b"compression"].decode(), size)


def records_in_chunk(content: bytes) -> Iterator[tuple[Fields, int, int, int]]:
    """(header, first byte of the record, of its data, end); ValueError unless it is all records."""
    position = 0
    while position < len(content):
        ends = [position]
        for _ in range(2):
            length = int.from_bytes(content[ends[-1] : ends[-1] + 4], "little")
            ends.append(ends[-1] + 4 + length)
        begin, middle, end = ends
        if end > len(content):
            raise ValueError("a record reaches beyond the end of its chunk")
        yield header_fields(content[begin + 4 : middle]), begin, middle + 4, end
        position = end


def _take(head: Fields, data: bytes, position: int, index: Bag1Index) -> None:
    kind = head[b"op"]
    if kind == CHUNK:
        index.places.append(position)
        content = chunk_content(head, data)
        for fields, _, start, end in records_in_chunk(content):
            if fields[b"op"] == CONNECTION:
                _connect(fields, content[start:end], index)
            elif fields[b"op"] == MESSAGE:
                _time_ns(fields[b"time"])
                index.counts[_number(fields[b"conn"])] += 1
    elif kind == CONNECTION:
        _connect(head, data, index)
    elif kind == CHUNK_INFO:
        if len(data) != 8 * _number(head[b"count"]):
            raise ValueError("an entry of the index is damaged")
        index.announced += sum(count for _, count in struct.iter_unpack("<II", data))
    elif kind == MESSAGE:
        raise ValueError("a message stands outside of any chunk")
    elif kind == BAG_HEADER and b"encryptor" in head and head[b"encryptor"]:
        raise ValueError("the bag is encrypted")


def _connect(head: Fields, data: bytes, index: Bag1Index) -> None:
    number, fields = _number(head[b"conn"]), header_fields(data)
    texts = head[b"topic"], fields[b"type"], fields[b"message_definition"], fields[b"md5sum"]
    topic, type_name, definition, md5sum = (text.decode() for text in texts)
    told = (
        fields[name].decode() if name in fields else None for name in (b"callerid", b"latching")
    )
    known = "" if md5sum == "*" else md5sum
    connection = Connection1(topic, type_name, definition, known, *told)
    if index.connections.setdefault(number, connection) != connection:
        raise ValueError(f"connection {number} is declared twice, each time otherwise")


def _number(value: bytes) -> int:
    if len(value) != 4:
        raise ValueError("a number of a record's header is damaged")
    return int.from_bytes(value, "little")


def _time_ns(value: bytes) -> int:
    seconds, nanoseconds = struct.unpack("<II", value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
