"""Reads and validates MCAP files: sizes, order of records, every CRC.

Index-following readers believe what an index says: a damaged one hides messages, and a small
chunk can unpack to gigabytes. This one walks record by record with bounded memory, notes where
chunks are, and counts what is really there. Format: mcap.dev/spec.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from slamsim.guard.errors import Excessive
from slamsim.guard.files import open_input, require_magic
from slamsim.guard.limits import LIMITS
from slamsim.io.input_errors import damaged
from slamsim.io.mcap.framing import MAGIC
from slamsim.io.ros.message_types import inflate

RECORD_HEAD = Struct("<BQ")
MESSAGE_HEAD = Struct("<HIQQ")
_BLOCK_BYTES = 1 << 20
_CHUNK_HEAD_BYTES = 1024


@dataclass(slots=True)
class McapIndex:
    """What a walk over a file found.

    profile: as the header has it. counts: messages per channel id. places: byte and length of
    every record that holds messages, a chunk or a lone message; attachments: of those.
    unchecked: how many of each part carry no checksum. span_ns: when the first and the last message
    was received, as the file says; None if it does not.
    """

    path: Path
    profile: str = ""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    metadata: list[records.Metadata] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    announced: int | None = None
    span_ns: tuple[int, int] | None = None
    unchecked: Counter[str] = field(default_factory=Counter)


def index_mcap(path: Path) -> McapIndex:
    """Walks over the file; InputRefused, with the byte, for one that is cut, damaged or a bomb."""
    index = McapIndex(path)
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        require_magic(file, path, MAGIC, "MCAP file")
        position, crc, ended = file.tell(), zlib.crc32(MAGIC), False
        while not ended:
            try:
                crc, ended = _next_record(file, size, index, crc)
            except Exception as error:
                detail = " ".join(str(error).split())[:200] or type(error).__name__
                raise damaged(path, detail, f"byte {position:,}", error) from error
            position = file.tell()
        if file.read(len(MAGIC) + 1) != MAGIC:
            raise damaged(path, "the file does not end where its footer says it does")
    found = index.counts.total()
    if index.announced not in (None, found):
        raise damaged(path, f"{index.announced:,} messages announced, {found:,} are there")
    return index


def mcap_messages(
    index: McapIndex, channels: Container[int]
) -> Iterator[tuple[int, int, int, int, bytes]]:
    """(channel id, log time, publish time, sequence, message) of the channels.

    Chunk after chunk, inside a chunk by log time. Raises ValueError and what the libraries raise
    if the file is no longer what it was.
    """
    with open_input(index.path) as file:
        for position, length in index.places:
            file.seek(position)
            head, data = file.read(RECORD_HEAD.size), file.read(length)
            if len(data) != length:
                raise ValueError("the file has become shorter")
            content = read_chunk(data)[1] if head[0] == Opcode.CHUNK else head + data
            found = []
            for opcode, start, end in records_in(content):
                if opcode == Opcode.MESSAGE:
                    channel, sequence, log_ns, published_ns = MESSAGE_HEAD.unpack_from(
                        content, start
                    )
                    if channel in channels:
                        found.append((log_ns, start, channel, end, published_ns, sequence))
            for log_ns, start, channel, end, published_ns, sequence in sorted(found):
                data = content[start + MESSAGE_HEAD.size : end]
                yield channel, log_ns, published_ns, sequence, data


def mcap_attachments(index: McapIndex) -> Iterator[records.Attachment]:
    """One after the other; raises as ``mcap_messages`` does, and Excessive for a too large one."""
    with open_input(index.path) as file:
        for position, length in index.attachments:
            if length > LIMITS.attachment_bytes:
                raise Excessive(f"an attachment of {length:,} bytes", "attachment_bytes")
            file.seek(position + RECORD_HEAD.size)
            data = file.read(length)
            stored = int.from_bytes(data[-4:], "little")
            _require_crc(stored, zlib.crc32(data[:-4]), "an attachment")
            yield records.Attachment.read(data_stream(data))


def span_of(statistics: records.Statistics) -> tuple[int, int] | None:
    """When the first and the last message was received; None of a file without messages."""
    span = statistics.message_start_time, statistics.message_end_time
    return span if statistics.message_count else None


def _next_record(file: BinaryIO, size: int, index: McapIndex, crc: int) -> tuple[int, bool]:
    """(running checksum, whether this was the footer) after one more record."""
    position = file.tell()
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise ValueError("the file is cut off here: a recording that was not ended")
    opcode, length = RECORD_HEAD.unpack(head)
    if length > size - file.tell():
        raise ValueError("the file is cut off in this record, or the record is damaged")
    if opcode == Opcode.ATTACHMENT:
        index.attachments.append((position, length))
        return _skip(file, length, zlib.crc32(head, crc)), False
    limit = "bag_chunk_bytes" if opcode == Opcode.CHUNK else "bag_record_bytes"
    if length > getattr(LIMITS, limit) + _CHUNK_HEAD_BYTES:
        reason = f"a record of {length:,} bytes is larger than any in a recording"
        raise Excessive(reason, limit)
    data = file.read(length)
    if opcode == Opcode.DATA_END:
        _check(index, "the data section", int.from_bytes(data[:4], "little"), crc)
        return 0, False
    if opcode == Opcode.FOOTER:
        if length != 20:
            raise ValueError("the footer is damaged")
        computed = zlib.crc32(head + data[:16], crc)
        _check(index, "the summary section", int.from_bytes(data[16:20], "little"), computed)
        return 0, True
    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
        index.places.append((position, length))
    _take(opcode, data, index)
    return zlib.crc32(data, zlib.crc32(head, crc)), False


def _skip(file: BinaryIO, length: int, crc: int) -> int:
    while length:
        block = file.read(min(length, _BLOCK_BYTES))
        if not block:
            raise ValueError("the file is cut off in this record")
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return crc


def _check(index: McapIndex, what: str, stored: int, computed: int) -> None:
    index.unchecked[what] += stored == 0
    _require_crc(stored, computed, what)


def _require_crc(stored: int, computed: int, what: str) -> None:
    if stored not in (0, computed):
        raise ValueError(f"the checksum of {what} does not fit: damaged")


def _take(opcode: int, data: bytes, index: McapIndex) -> None:
    if opcode == Opcode.CHUNK:
        chunk, content = read_chunk(data)
        index.unchecked["a chunk"] += chunk.uncompressed_crc == 0
        for inner, start, end in records_in(content):
            if inner == Opcode.MESSAGE:
                _count(content, start, end, index)
            elif inner in (Opcode.SCHEMA, Opcode.CHANNEL):
                _take(inner, content[start:end], index)
            else:
                raise ValueError(f"a record of the kind 0x{inner:02x} has no place in a chunk")
    elif opcode == Opcode.MESSAGE:
        _count(data, 0, len(data), index)
    elif opcode == Opcode.SCHEMA:
        schema = records.Schema.read(data_stream(data))
        index.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = records.Channel.read(data_stream(data))
        index.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        index.metadata.append(records.Metadata.read(data_stream(data)))
    elif opcode == Opcode.HEADER:
        index.profile = records.Header.read(data_stream(data)).profile
    elif opcode == Opcode.STATISTICS:
        statistics = records.Statistics.read(data_stream(data))
        index.announced, index.span_ns = statistics.message_count, span_of(statistics)


def _count(content: bytes, start: int, end: int, index: McapIndex) -> None:
    if end - start < MESSAGE_HEAD.size:
        raise ValueError("a message record is too short")
    channel = MESSAGE_HEAD.unpack_from(content, start)[0]
    if channel not in index.channels:
        raise ValueError(f"a message on channel {channel}, which is not declared before it")
    index.counts[channel] += 1


def read_chunk(data: bytes) -> tuple[records.Chunk, bytes]:
    """(chunk, the records in it unpacked); ValueError when they do not fit its checksum."""
    chunk = records.Chunk.read(data_stream(data))
    content = inflate(chunk.data, chunk.compression, chunk.uncompressed_size)
    _require_crc(chunk.uncompressed_crc, zlib.crc32(content), "a chunk")
    return chunk, content


def records_in(content: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, start, end) of the content of each record.

    Raises ValueError for one that is cut off.
    """
    position = 0
    while position < len(content):
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > len(content):
            raise ValueError("a record reaches beyond the end of its chunk")
        yield opcode, start, position


def data_stream(data: bytes) -> ReadDataStream:
    """As the records of the ``mcap`` library are read from."""
    return ReadDataStream(BytesIO(data))
