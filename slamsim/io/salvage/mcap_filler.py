"""Writes recovered chunks and messages into a new MCAP file."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import BinaryIO

import numpy as np
import zstandard
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import NDArray

from slamsim.io.bag2.metadata import with_numbered_policies
from slamsim.io.mcap.framing import McapStream
from slamsim.io.mcap.reader import MESSAGE_HEAD, RECORD_HEAD, records_in
from slamsim.io.mcap.summary import Declaration, declaration
from slamsim.io.mcap.writer import CHUNK_BYTES, ZSTD_LEVEL
from slamsim.io.ros.message_types import ZSTD_MAGIC, plain_message
from slamsim.io.salvage.report import DecodableMessages, RecoveryReport

_Place = tuple[int, int, int, int]
"""(channel, log time, first byte, end) of a message record in its chunk."""
_DATA = RECORD_HEAD.size + MESSAGE_HEAD.size


def _channel(record: bytes) -> int:
    """Of a message with opcode and length."""
    return int.from_bytes(record[RECORD_HEAD.size : RECORD_HEAD.size + 2], "little")


def _readable_by_all(declared: Declaration) -> Declaration:
    """A channel with the policies of its quality of service as numbers; a schema as it is."""
    if isinstance(declared, records.Schema):
        return declared
    return replace(declared, metadata=with_numbered_policies(declared.metadata))


class McapFiller:
    """A new MCAP file; the caller opened and closes the stream.

    channels and schemas: by id, those declared so far. metadata: what the caller put, by name.
    """

    def __init__(self, stream: BinaryIO, profile: str, report: RecoveryReport) -> None:
        self.file = McapStream(stream, profile)
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, records.Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._report = report
        self._readable = DecodableMessages()
        self._later: dict[tuple[type, int], Declaration] = {}
        self._waiting = bytearray()

    def know(self, known: Declaration) -> None:
        """It is declared when it is first needed, and instead of another one outside of chunks."""
        self._later[type(known), known.id] = known

    def declare(self, declared: Declaration) -> None:
        """A schema or a channel, to be used from here on."""
        declared = _readable_by_all(self._later.get((type(declared), declared.id), declared))
        known = self.schemas if isinstance(declared, records.Schema) else self.channels
        if known.get(declared.id) == declared:
            return
        self._pack()
        if isinstance(declared, records.Channel):
            self._require_schema(declared.schema_id)
        self.file.put(declared)
        self._list(declared)

    def unchecked_message(self, record: bytes) -> bool:
        """One without a checksum; whether it could be used."""
        data = self._plain(record)
        if data is None or not self._readable(self.channels[_channel(record)].topic, data):
            return False
        self._add(record, data)
        return True

    def message(self, record: bytes) -> bool:
        """One message, with opcode and length, unpacked if it was compressed by itself; whether its
        channel is known and it could be unpacked."""
        data = self._plain(record)
        if data is None:
            return False
        self._add(record, data)
        return True

    def _plain(self, record: bytes) -> bytes | None:
        """The content of a message; None of an unknown channel, or where it cannot be unpacked."""
        if not self._is_known(_channel(record)):
            return None
        try:
            encoding = self.channels[_channel(record)].message_encoding
            return plain_message(record[_DATA:], encoding)
        except (ValueError, zstandard.ZstdError):
            return None

    def _add(self, record: bytes, data: bytes) -> None:
        head = record[RECORD_HEAD.size : _DATA]
        self._waiting += RECORD_HEAD.pack(Opcode.MESSAGE, len(head) + len(data)) + head + data
        if len(self._waiting) >= CHUNK_BYTES:
            self._pack()

    def chunk(self, chunk: records.Chunk, content: bytes) -> int:
        """A whole chunk, as it is if ROS 2 Humble can read what it declares and its messages; how
        many messages are left out, for nothing declares them or they cannot be unpacked."""
        self._pack()
        declared, places, undeclared = self._in_order(content)
        is_packed = any(content.startswith(ZSTD_MAGIC, place[2] + _DATA) for place in places)
        is_readable = declared == [_readable_by_all(each) for each in declared]
        if undeclared or not places or is_packed or not is_readable:
            for each in declared:
                self.declare(each)
            taken = [self.message(content[start:end]) for _, _, start, end in places]
            return undeclared + taken.count(False)
        for each in declared:
            self._list(each)
        self._put(chunk, content, places)
        return 0

    def by_topic(self, counts: Mapping[int, int]) -> dict[str, int]:
        """Messages per channel as messages per topic, where a channel is known."""
        by_topic = Counter[str]()
        for number, count in counts.items():
            known = self.channels.get(number) or self._later.get((records.Channel, number))
            if isinstance(known, records.Channel):
                by_topic[known.topic] += count
        return dict(by_topic)

    def finish(self) -> None:
        """Writes what is left, index and footer."""
        self._pack()
        self.file.finish()

    def _in_order(self, content: bytes) -> tuple[list[Declaration], list[_Place], int]:
        """(declarations, messages whose channel is declared by then, number of others)."""
        declared, places, undeclared = list[Declaration](), list[_Place](), 0
        inside = set[tuple[type, int]]()
        for opcode, start, end in records_in(content):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                found = declaration(opcode, content[start:end])
                declared.append(found)
                inside.add((type(found), found.id))
                if isinstance(found, records.Channel) and (
                    (records.Schema, found.schema_id) not in inside
                ):
                    self._require_schema(found.schema_id)
            elif opcode == Opcode.MESSAGE:
                channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content, start)
                if (records.Channel, channel) in inside or self._is_known(channel):
                    places.append((channel, log_ns, start - RECORD_HEAD.size, end))
                else:
                    undeclared += 1
        return declared, places, undeclared

    def _is_known(self, channel: int) -> bool:
        later = self._later.get((records.Channel, channel))
        if channel not in self.channels and later is not None:
            self.declare(later)
        return channel in self.channels

    def _require_schema(self, number: int) -> None:
        later = self._later.get((records.Schema, number))
        if number not in self.schemas and later is not None:
            self.declare(later)

    def _list(self, declared: Declaration) -> None:
        if isinstance(declared, records.Schema):
            self.schemas[declared.id] = declared
            self.file.list_schema(declared)
        else:
            self.channels[declared.id] = declared
            self.file.list_channel(declared)
            schema = self.schemas.get(declared.schema_id)
            kind = "" if schema is None else schema.name
            self._report.know(declared.topic, kind)
            if schema is not None:
                text = schema.data.decode(errors="replace")
                encoding = declared.message_encoding
                self._readable.describe(declared.topic, kind, encoding, schema.encoding, text)

    def _pack(self) -> None:
        """The messages that wait become a chunk."""
        if not self._waiting:
            return
        content, self._waiting = bytes(self._waiting), bytearray()
        compressed = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(content)
        _, places, _ = self._in_order(content)
        self._put(records.Chunk("zstd", compressed, 0, 0, 0, len(content)), content, places)

    def _put(self, chunk: records.Chunk, content: bytes, places: list[_Place]) -> None:
        channels = np.array([place[0] for place in places], dtype=np.uint16)
        log_ns, starts, ends = (
            np.array([place[column] for place in places], dtype=np.uint64) for column in (1, 2, 3)
        )
        first_ns, last_ns = int(log_ns.min()), int(log_ns.max())
        sealed = replace(
            chunk,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(content),
        )
        self.file.put_chunk(sealed, channels, log_ns, starts)
        self._report.packed_bytes += len(chunk.data)
        self._count(channels, log_ns, ends - starts)

    def _count(
        self, channels: NDArray[np.uint16], log_ns: NDArray[np.uint64], sizes: NDArray[np.uint64]
    ) -> None:
        for channel in np.unique(channels).tolist():
            mine = channels == channel
            span_ns = int(log_ns[mine].min()), int(log_ns[mine].max())
            topic = self.channels[channel].topic
            self._report.keep(topic, int(mine.sum()), int(sizes[mine].sum()), span_ns)
