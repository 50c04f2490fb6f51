"""Finds the intact records of a damaged MCAP file.

A chunk is whole if its content fits its checksum and is a row of records. After damage the walk
goes on at the next thing that has the shape of a chunk: its length is written in it twice. The
idea of copying chunk by chunk is that of ``mcap recover``. Format: mcap.dev/spec.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mcap import records
from mcap.opcode import Opcode

from slamsim.guard.limits import LIMITS
from slamsim.io.mcap.framing import MAGIC
from slamsim.io.mcap.reader import MESSAGE_HEAD, RECORD_HEAD, data_stream, read_chunk, records_in
from slamsim.io.mcap.summary import (
    Declaration,
    bytes_at,
    declaration,
    summary_of,
    whole_record,
)
from slamsim.io.salvage.source import DamagedFile, LoneMessage

_CHUNK_SHAPE = re.compile(
    rb"\x06(?=.{4}\0{4}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0|\x04\0\0\0none).{8})",
    re.DOTALL,
)
_MESSAGE_SHAPE = re.compile(rb"\x05(?=.{4}\0{4}.{22})", re.DOTALL)
_SHAPE_BYTES = 64
_CHUNK_HEAD = Struct("<BQQQQII")
_INDEX_HEAD = Struct("<HI")
_INDEX_ENTRY_BYTES = 16
_TEXTS = ("ros1msg", "ros2msg", "ros2idl", "omgidl")
_LENGTHS: dict[int, int] = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}
_WINDOW_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class WholeMcapChunk:
    """content: the records in it, unpacked."""

    chunk: records.Chunk
    content: bytes


Piece = WholeMcapChunk | LoneMessage | Declaration | records.Metadata


@dataclass(frozen=True, slots=True)
class _Record:
    """begin, end: its bytes in the file. data: its content."""

    opcode: int
    data: bytes
    begin: int
    end: int


class McapSalvage(DamagedFile[_Record, Piece]):
    """A damaged MCAP file. profile: as its header has it. summary: what could be read of it."""

    MAGIC, KIND = MAGIC, "an MCAP file"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.profile = self._profile()
        self.summary = summary_of(self.file, self.size)
        self._channels = {d.id for d in self.summary.declarations if isinstance(d, records.Channel)}
        self._has_chunks = self._next_chunk(0) < self.size

    def _profile(self) -> str:
        found = self._record_at(len(MAGIC))
        with suppress(Exception):
            if isinstance(found, _Record) and found.opcode == Opcode.HEADER:
                return str(records.Header.read(data_stream(found.data)).profile)
        return "ros2"

    def _record_at(self, position: int) -> _Record | str:
        head = self._at(position, RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            return "the file is cut off here"
        opcode, length = RECORD_HEAD.unpack(head)
        if not _possible(opcode, length):
            return "here is no record"
        if length > self.size - position - RECORD_HEAD.size:
            return "the file is cut off in this record, or its length is damaged"
        end = position + RECORD_HEAD.size + length
        return _Record(opcode, self.file.read(length), position, end)

    def _may_begin(self, position: int) -> bool:
        head = self._at(position, RECORD_HEAD.size)
        return len(head) < RECORD_HEAD.size or _possible(*RECORD_HEAD.unpack(head))

    def _piece(self, record: _Record) -> Piece | None:
        opcode, data = record.opcode, record.data
        if opcode == Opcode.CHUNK:
            chunk, content = read_chunk(data)
            self._look_through(content)
            return WholeMcapChunk(chunk, content)
        if opcode == Opcode.MESSAGE:
            if not self._may_begin(record.end):
                raise ValueError("the length of a message is damaged")
            _require_head(len(data))
            return LoneMessage(RECORD_HEAD.pack(opcode, len(data)) + data)
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            found = self._declared(opcode, data)
            if isinstance(found, records.Schema) and found.encoding in _TEXTS:
                found.data.decode()
            return found
        if opcode == Opcode.METADATA:
            metadata: records.Metadata = records.Metadata.read(data_stream(data))
            return whole_record(metadata, data)
        if opcode == Opcode.DATA_END:
            self.ended = True
        elif opcode == Opcode.HEADER:
            whole_record(records.Header.read(data_stream(data)), data)
        elif opcode == Opcode.MESSAGE_INDEX:
            _index_of(data)
        elif opcode == Opcode.ATTACHMENT:
            raise ValueError("an attachment, which is not copied")
        else:
            raise ValueError("a record that does not belong here")
        return None

    def _look_through(self, content: bytes) -> None:
        """Raises ValueError unless it is a row of records; notes the channels."""
        for opcode, start, end in records_in(content):
            if opcode == Opcode.MESSAGE:
                _require_head(end - start)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declared(opcode, content[start:end])

    def _declared(self, opcode: int, data: bytes) -> Declaration:
        found = declaration(opcode, data)
        if isinstance(found, records.Channel):
            self._channels.add(found.id)
        return found

    def _after_damaged(self, record: _Record) -> tuple[int, dict[int, int] | None]:
        position, counts = record.end, Counter[int]()
        while record.opcode == Opcode.CHUNK:
            found = self._record_at(position)
            if isinstance(found, str) or found.opcode != Opcode.MESSAGE_INDEX:
                break
            with suppress(Exception):
                channel, messages = _index_of(found.data)
                counts[channel] += messages
            position = found.end
        return position, dict(counts) or None

    def _next_place(self, position: int) -> int:
        """The next chunk, or lone message where there are no chunks."""
        if self._has_chunks:
            return self._next_chunk(position)
        for place in _matches(self.file, position, _MESSAGE_SHAPE):
            if self._is_message(place):
                return place
        return self.size

    def _next_chunk(self, position: int) -> int:
        for place in _matches(self.file, position, _CHUNK_SHAPE):
            if self._is_chunk(place):
                return place
        return self.size

    def _is_chunk(self, place: int) -> bool:
        head = self._at(place, _CHUNK_HEAD.size)
        _, length, _, _, unpacked, _, name = _CHUNK_HEAD.unpack(head)
        packed = int.from_bytes(self._at(place + _CHUNK_HEAD.size + name, 8), "little")
        stated = _CHUNK_HEAD.size - RECORD_HEAD.size + name + 8 + packed
        fits = place + RECORD_HEAD.size + length <= self.size
        return fits and bool(length == stated and unpacked <= LIMITS.bag_chunk_bytes)

    def _is_message(self, place: int) -> bool:
        """Of a known channel, and followed by something that can be a record."""
        head = self._at(place, RECORD_HEAD.size + 2)
        length, channel = RECORD_HEAD.unpack(head[:-2])[1], int.from_bytes(head[-2:], "little")
        end = place + RECORD_HEAD.size + length
        return channel in self._channels and end <= self.size and self._may_begin(end)


def _index_of(data: bytes) -> tuple[int, int]:
    """(channel, messages) of a message index."""
    if len(data) < _INDEX_HEAD.size:
        raise ValueError("a message index is too short")
    channel, size = _INDEX_HEAD.unpack_from(data)
    if size != len(data) - _INDEX_HEAD.size:
        raise ValueError("a message index is damaged")
    return channel, size // _INDEX_ENTRY_BYTES


def _require_head(length: int) -> None:
    if length < MESSAGE_HEAD.size:
        raise ValueError("a message record is too short")


def _possible(opcode: int, length: int) -> bool:
    if opcode in _LENGTHS:
        return length == _LENGTHS[opcode]
    chunk = opcode == Opcode.CHUNK
    limit = LIMITS.bag_chunk_bytes + 1024 if chunk else LIMITS.bag_record_bytes
    return 1 <= opcode <= Opcode.DATA_END and length <= limit


def _matches(file: BinaryIO, position: int, shape: re.Pattern[bytes]) -> Iterator[int]:
    """Where the bytes look like that."""
    while window := bytes_at(file, position, _WINDOW_BYTES + _SHAPE_BYTES):
        for match in shape.finditer(window):
            if match.start() < _WINDOW_BYTES:
                yield position + match.start()
        position += _WINDOW_BYTES
