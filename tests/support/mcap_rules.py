"""What MCAP's specification asks of a file as a whole, as ``mcap doctor`` looks at it.

Nothing of slamsim reads the file here: the ``mcap`` library parses the records, and each is
compared with what the others say of it.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
_KINDS: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.MESSAGE: records.Message,
    Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}
Placed = tuple[int, int, Any]
"""(offset, length with opcode, record)"""


def placed(data: bytes) -> Iterator[Placed]:
    """The records of a chunk, or of a file between its magic bytes."""
    start = 0
    while start < len(data):
        opcode, length = struct.unpack_from("<BQ", data, start)
        stream = ReadDataStream(io.BytesIO(data[start + 9 : start + 9 + length]))
        kind = _KINDS[opcode]
        sized = kind is records.Message
        yield start, 9 + length, kind.read(stream, length) if sized else kind.read(stream)
        start += 9 + length


def _is_message_index(one: Placed) -> bool:
    return isinstance(one[2], records.MessageIndex)


def content_of(chunk: records.Chunk) -> bytes:
    unpack = {
        "": bytes,
        "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
        "lz4": lz4.frame.decompress,
    }
    return bytes(unpack[chunk.compression](chunk.data))


class Rules:
    """One walk through a file; ``broken`` says which rules do not hold."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        self.broken: list[str] = []
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self._counts = Counter[int]()
        self._latest_ns, self._times_ns = 0, list[int]()
        self._ask(data.startswith(MAGIC) and data.endswith(MAGIC), "magic at both ends")
        at = len(MAGIC)
        whole = [(at + o, n, r) for o, n, r in placed(data[at:-at])]
        ends = [i for i, (_, _, r) in enumerate(whole) if isinstance(r, records.DataEnd)]
        self._ask(len(ends) == 1, "one DataEnd")
        self._ask(isinstance(whole[0][2], records.Header), "the first record is the Header")
        self._ask(isinstance(whole[-1][2], records.Footer), "the last record is the Footer")
        self._head(whole[0][2])
        offset, _, end = whole[ends[0]]
        crc = zlib.crc32(data[:offset])
        self._ask(end.data_section_crc in (0, crc), "checksum of the data section")
        self._data_section(whole[1 : ends[0]])
        self._summary_section(whole[ends[0] + 1 : -1], {o: (n, r) for o, n, r in whole})
        self._foot(whole[-1][2], whole[ends[0] + 1 :], data)

    def _ask(self, holds: bool, rule: str) -> None:
        if not holds:
            self.broken.append(rule)

    def _head(self, header: records.Header) -> None:
        self._ask(bool(header.library), "the Header names the library")
        self._ask(header.profile in ("", "ros1", "ros2"), "the Header's profile is well known")

    def _data_section(self, found: list[Placed]) -> None:
        self._walked: dict[int, set[int]] = {}
        for i, (offset, _, record) in enumerate(found):
            if isinstance(record, records.Chunk):
                indexes: dict[int, Any] = {}
                for _, _, index in takewhile(_is_message_index, islice(found, i + 1, None)):
                    self._ask(index.channel_id not in indexes, "one message index a channel")
                    indexes[index.channel_id] = {o: t for t, o in index.records}
                self._walked[offset] = self._chunk(record, indexes)
            elif isinstance(record, records.Message):
                self._ask(False, "no message stands outside a chunk")
            elif isinstance(record, records.Schema | records.Channel):
                self._declared(record)

    def _declared(self, record: records.Schema | records.Channel) -> None:
        known = self._schemas if isinstance(record, records.Schema) else self._channels
        self._ask(record.id not in known, f"{type(record).__name__} {record.id} is declared once")
        if isinstance(record, records.Schema):
            self._ask(record.id != 0, "no schema has the number 0")
            self._ask(bool(record.encoding and record.data), "a schema has encoding and text")
        else:
            self._ask(record.schema_id in self._schemas, "a channel's schema comes before it")
        known[record.id] = record

    def _chunk(self, chunk: records.Chunk, indexes: dict[int, dict[int, int]]) -> set[int]:
        content = content_of(chunk)
        self._ask(len(content) == chunk.uncompressed_size, "size of a chunk")
        self._ask(chunk.uncompressed_crc in (0, zlib.crc32(content)), "checksum of a chunk")
        stamps_ns, used = [], set()
        for offset, _, record in placed(content):
            if isinstance(record, records.Schema | records.Channel):
                self._declared(record)
                continue
            self._ask(isinstance(record, records.Message), "nothing else is in a chunk")
            self._ask(record.channel_id in self._channels, "a message's channel comes before it")
            self._ask(record.log_time >= self._latest_ns, "messages in the order of log time")
            indexed = indexes.get(record.channel_id, {}).get(offset)
            self._ask(indexed == record.log_time, "the index names place and time of a message")
            self._latest_ns = max(self._latest_ns, record.log_time)
            self._counts[record.channel_id] += 1
            stamps_ns.append(record.log_time)
            used.add(record.channel_id)
        self._ask(sum(map(len, indexes.values())) == len(stamps_ns), "indexes name no others")
        if stamps_ns:
            limits = (chunk.message_start_time, chunk.message_end_time)
            self._ask(limits == (min(stamps_ns), max(stamps_ns)), "times of a chunk")
            self._times_ns += limits
        return used

    def _summary_section(self, found: list[Placed], at: dict[int, tuple[int, Any]]) -> None:
        kinds: dict[type, list[Any]] = {}
        for _, _, record in found:
            kinds.setdefault(type(record), []).append(record)
        for kind, known in (records.Schema, self._schemas), (records.Channel, self._channels):
            told = {record.id: record for record in kinds.get(kind, [])}
            self._ask(told == known, f"each {kind.__name__} is repeated in the summary")
        indexes = kinds.get(records.ChunkIndex, [])
        self._ask(
            sorted(index.chunk_start_offset for index in indexes) == sorted(self._walked),
            "one index for each chunk",
        )
        for index in indexes:
            length, chunk = at.get(index.chunk_start_offset, (0, None))
            self._ask(
                chunk is not None
                and index.chunk_length == length
                and index.compressed_size == len(chunk.data)
                and all(
                    getattr(index, name) == getattr(chunk, name)
                    for name in (
                        "message_start_time",
                        "message_end_time",
                        "compression",
                        "uncompressed_size",
                    )
                ),
                "an index says what its chunk says",
            )
            places = index.message_index_offsets.items()
            named = {
                c for c, o in places if getattr(at.get(o, (0, None))[1], "channel_id", -1) == c
            }
            self._ask(
                named == self._walked.get(index.chunk_start_offset), "an index names its channels"
            )
        (statistics,) = kinds.get(records.Statistics, [None])
        if statistics is not None and self._times_ns:
            self._ask(
                statistics.message_count == self._counts.total()
                and statistics.channel_message_counts == dict(self._counts)
                and statistics.message_start_time == min(self._times_ns)
                and statistics.message_end_time == max(self._times_ns)
                and statistics.chunk_count == len(self._walked)
                and statistics.schema_count == len(self._schemas)
                and statistics.channel_count == len(self._channels),
                "the Statistics count what is there",
            )

    def _foot(self, footer: records.Footer, summary: list[Placed], data: bytes) -> None:
        start = summary[0][0]
        self._ask(footer.summary_start == start, "the Footer says where the summary starts")
        # the checksum covers the summary and the Footer up to the checksum itself
        crc = zlib.crc32(data[start : summary[-1][0] + 9 + 16])
        self._ask(footer.summary_crc in (0, crc), "checksum of the summary")
        places = {offset: record for offset, _, record in summary}
        for _, _, group in summary:
            if isinstance(group, records.SummaryOffset) and group.group_length:
                first = places.get(group.group_start)
                kind = _KINDS[group.group_opcode]
                self._ask(isinstance(first, kind), "a summary offset leads to its group")


def broken_rules(path: Path) -> list[str]:
    """Those of MCAP's specification that the file does not keep, one line for each breach."""
    return Rules(path).broken
