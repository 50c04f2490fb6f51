"""Declarations and summary section of an MCAP file, and a few chunks found by it: enough to say
what is in the file."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import BinaryIO, TypeVar

from mcap import records
from mcap.opcode import Opcode

from slamsim.guard.files import open_input, require_magic
from slamsim.guard.limits import LIMITS
from slamsim.io.mcap.framing import MAGIC, record_bytes
from slamsim.io.mcap.reader import (
    RECORD_HEAD,
    McapIndex,
    data_stream,
    index_mcap,
    records_in,
    span_of,
)

Declaration = records.Schema | records.Channel

_FOOTER = Struct("<9xQQI")
_FOOTER_BYTES = _FOOTER.size + len(MAGIC)
_Record = TypeVar("_Record", bound=records.McapRecord)


@dataclass(slots=True)
class Summary:
    """What the end of a file says of the whole of it. messages: per channel, None if unknown.

    metadata: byte and length of each such record. span_ns: as ``McapIndex`` has it.
    """

    declarations: list[Declaration] = field(default_factory=list)
    messages: dict[int, int] | None = None
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    metadata: list[tuple[int, int]] = field(default_factory=list)
    span_ns: tuple[int, int] | None = None


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
                summary.span_ns = span_of(statistics)
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
    """The record, if it is all of the data; raises ValueError if not.

    Without a checksum, a wrong length is seen only so.
    """
    if record_bytes(record)[RECORD_HEAD.size :] != data:
        raise ValueError("a record is damaged")
    return record


def bytes_at(file: BinaryIO, position: int, length: int) -> bytes:
    """As many of them as there are."""
    file.seek(position)
    return file.read(length)


MOST_CHUNKS = 100
_LATCHED_CHUNKS = 16
_CHUNK_HEAD_BYTES = 1024


def sampled_mcap(path: Path) -> McapIndex:
    """As ``index_mcap``, with counts by the summary, and places of a few chunks that hold the
    first and the last messages of every channel, and what is latched.

    What the summary says is believed: it is for a first look. Of a file without one all is
    walked over, and all places are given. Raises InputRefused as ``index_mcap`` does.
    """
    with open_input(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        require_magic(file, path, MAGIC, "MCAP file")
        summary = summary_of(file, size)
        places = _places(summary, size)
        index = None if places is None else _index(path, file, summary, places)
    return index_mcap(path) if index is None else index


def _index(
    path: Path, file: BinaryIO, summary: Summary, places: list[tuple[int, int]]
) -> McapIndex:
    index = McapIndex(path, places=places, span_ns=summary.span_ns)
    for each in summary.declarations:
        if isinstance(each, records.Channel):
            index.channels[each.id] = each
        else:
            index.schemas[each.id] = each
    counts = summary.messages or {}
    index.counts.update({n: counts.get(n, 0) for n in index.channels})
    for position, length in summary.metadata:
        if RECORD_HEAD.size < length <= LIMITS.bag_record_bytes:
            data = bytes_at(file, position, length)[RECORD_HEAD.size :]
            index.metadata.append(records.Metadata.read(data_stream(data)))
    return index


def _places(summary: Summary, size: int) -> list[tuple[int, int]] | None:
    """Byte and length of the chunks to be read; None where the summary does not tell them."""
    if summary.messages is None or (any(summary.messages.values()) and not summary.chunks):
        return None
    latched = {
        each.id
        for each in summary.declarations
        if isinstance(each, records.Channel) and each.topic.endswith(("_static", "_description"))
    }
    places = []
    for chunk in _chosen(summary.chunks, latched):
        length = chunk.chunk_length - RECORD_HEAD.size
        end = chunk.chunk_start_offset + chunk.chunk_length
        if not 0 < length <= LIMITS.bag_chunk_bytes + _CHUNK_HEAD_BYTES or end > size:
            return None
        places.append((chunk.chunk_start_offset, length))
    return places


def _chosen(chunks: Sequence[records.ChunkIndex], latched: set[int]) -> list[records.ChunkIndex]:
    """In the order of time."""
    ordered = sorted(chunks, key=lambda chunk: chunk.message_start_time)
    if not any(chunk.message_index_offsets for chunk in ordered):
        half = MOST_CHUNKS // 2
        return ordered if len(ordered) <= MOST_CHUNKS else ordered[:half] + ordered[-half:]
    chosen: dict[int, None] = {}
    for order in (range(len(ordered)), range(len(ordered) - 1, -1, -1)):
        seen: set[int] = set()
        for number in order:
            fresh = ordered[number].message_index_offsets.keys() - seen
            if fresh and len(chosen) < MOST_CHUNKS:
                chosen[number] = None
            seen |= fresh
    of_latched = [
        n for n, chunk in enumerate(ordered) if latched & chunk.message_index_offsets.keys()
    ]
    chosen.update(dict.fromkeys(of_latched[:_LATCHED_CHUNKS]))
    return [ordered[number] for number in sorted(chosen)]
