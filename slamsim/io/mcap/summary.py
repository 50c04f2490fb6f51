"""Declarations and summary section of an MCAP file."""

from __future__ import annotations

import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from struct import Struct
from typing import BinaryIO, TypeVar

from mcap import records
from mcap.opcode import Opcode

from slamsim.guard.limits import LIMITS
from slamsim.io.mcap.framing import MAGIC, record_bytes
from slamsim.io.mcap.reader import RECORD_HEAD, data_stream, records_in

Declaration = records.Schema | records.Channel

_FOOTER = Struct("<9xQQI")
_FOOTER_BYTES = _FOOTER.size + len(MAGIC)
_Record = TypeVar("_Record", bound=records.McapRecord)


@dataclass(slots=True)
class Summary:
    """What the end of a file says of the whole of it. messages: per channel, None if unknown.

    metadata: byte and length of each such record.
    """

    declarations: list[Declaration] = field(default_factory=list)
    messages: dict[int, int] | None = None
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    metadata: list[tuple[int, int]] = field(default_factory=list)


def summary_of(file: BinaryIO, size: int) -> Summary:
    """Empty where the end of the file is missing or damaged."""
    tail = bytes_at(file, max(size - _FOOTER_BYTES, 0), _FOOTER_BYTES)
    start, _, crc = _FOOTER.unpack_from(tail) if len(tail) == _FOOTER_BYTES else (0, 0, 0)
    length = size - len(MAGIC) - start
    if not tail.endswith(MAGIC) or not 0 < start < size or length > LIMITS.bag_chunk_bytes:
        return Summary()
    data = bytes_at(file, start, length)
    if crc not in (0, zlib.crc32(data[:-4])):
        return Summary()
    summary = Summary()
    with suppress(Exception):
        for opcode, begin, end in records_in(data):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                summary.declarations.append(declaration(opcode, data[begin:end]))
            elif opcode == Opcode.STATISTICS:
                statistics = records.Statistics.read(data_stream(data[begin:end]))
                summary.messages = statistics.channel_message_counts
            elif opcode == Opcode.CHUNK_INDEX:
                summary.chunks.append(records.ChunkIndex.read(data_stream(data[begin:end])))
            elif opcode == Opcode.METADATA_INDEX:
                index = records.MetadataIndex.read(data_stream(data[begin:end]))
                summary.metadata.append((index.offset, index.length))
    return summary


def declaration(opcode: int, data: bytes) -> Declaration:
    """The schema or channel in the content of a record."""
    kind = records.Schema if opcode == Opcode.SCHEMA else records.Channel
    found: Declaration = kind.read(data_stream(data))
    return whole_record(found, data)


def whole_record(record: _Record, data: bytes) -> _Record:
    """The record, if it is all of the data: without a checksum, a wrong length is seen only so."""
    if record_bytes(record)[RECORD_HEAD.size :] != data:
        raise ValueError("a record is damaged")
    return record


def bytes_at(file: BinaryIO, position: int, length: int) -> bytes:
    """As many of them as there are."""
    file.seek(position)
    return file.read(length)
