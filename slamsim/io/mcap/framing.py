"""Frames an MCAP file during writing: chunks, indexes, footer and every CRC.

The records are those of the ``mcap`` library. What stands inside a chunk is the caller's. Format:
mcap.dev/spec.
"""

from __future__ import annotations

import os
import zlib
from collections import Counter
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"


class McapStream:
    """An MCAP file being written to a stream that the caller opened and closes."""

    def __init__(self, stream: BinaryIO, profile: str = "ros2") -> None:
        self._stream = stream
        self._position = 0
        self._data_crc = 0
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._counts = Counter[int]()
        self._chunk_indexes: list[records.ChunkIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._put(MAGIC)
        self._put(record_bytes(records.Header(profile=profile, library="slamsim")))

    @property
    def counts(self) -> dict[str, int]:
        """Messages per topic so far."""
        counts = dict.fromkeys((channel.topic for channel in self._channels.values()), 0)
        for number, channel in self._channels.items():
            counts[channel.topic] += self._counts[number]
        return counts

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """Log time of the first and of the last message; (0, 0) without any."""
        if not self._chunk_indexes:
            return 0, 0
        starts = [index.message_start_time for index in self._chunk_indexes]
        return min(starts), max(index.message_end_time for index in self._chunk_indexes)

    def put_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        offset = self._position
        self._put(record_bytes(records.Metadata(name=name, metadata=dict(entries))))
        self._metadata_indexes.append(
            records.MetadataIndex(offset=offset, length=self._position - offset, name=name)
        )

    def put_attachment(self, attachment: records.Attachment) -> None:
        """A whole file that travels along."""
        offset = self._position
        self._put(record_bytes(attachment))
        self._attachment_indexes.append(
            records.AttachmentIndex(
                offset=offset,
                length=self._position - offset,
                create_time=attachment.create_time,
                log_time=attachment.log_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def list_schema(self, schema: records.Schema) -> None:
        """Name it in the summary; the caller writes it before it is used."""
        self._schemas[schema.id] = schema

    def list_channel(self, channel: records.Channel) -> None:
        """As ``list_schema``."""
        self._channels[channel.id] = channel

    def put(self, record: records.McapRecord) -> None:
        """A record outside of all chunks, such as a declaration."""
        self._put(record_bytes(record))

    def put_chunk(
        self,
        chunk: records.Chunk,
        channels: NDArray[np.integer],
        log_ns: NDArray[np.integer],
        offsets: NDArray[np.integer],
    ) -> None:
        """A chunk with, of its n messages, channel, log time and byte in the content, each (n,)."""
        chunk_start = self._position
        self.put(chunk)
        index_start = self._position
        index_offsets = self._put_message_index(channels, log_ns, offsets)
        self._chunk_indexes.append(
            records.ChunkIndex(
                chunk_length=index_start - chunk_start,
                chunk_start_offset=chunk_start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=self._position - index_start,
                message_index_offsets=index_offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def sync(self) -> None:
        """Hands all that was put to the disk."""
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def finish(self) -> None:
        """Writes summary and footer."""
        self.put(records.DataEnd(data_section_crc=self._data_crc))
        groups: list[tuple[int, list[records.McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, list(self._attachment_indexes)),
            (Opcode.METADATA_INDEX, list(self._metadata_indexes)),
        ]
        summary_start = self._position
        summary, offsets = b"", b""
        for opcode, members in groups:
            start = summary_start + len(summary)
            summary += b"".join(record_bytes(member) for member in members)
            length = summary_start + len(summary) - start
            if length:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start, group_length=length
                )
                offsets += record_bytes(offset)
        footer = record_bytes(
            records.Footer(
                summary_start=summary_start,
                summary_offset_start=summary_start + len(summary),
                summary_crc=0,
            )
        )
        crc = zlib.crc32(summary + offsets + footer[:-4])
        self._put(summary + offsets + footer[:-4] + crc.to_bytes(4, "little") + MAGIC)
        self.sync()

    def _put_message_index(
        self,
        channels: NDArray[np.integer],
        log_ns: NDArray[np.integer],
        offsets: NDArray[np.integer],
    ) -> dict[int, int]:
        index_offsets = {}
        for channel in np.unique(channels).tolist():
            mine = channels == channel
            self._counts[channel] += int(mine.sum())
            columns = [column[mine].astype("<u8") for column in (log_ns, offsets)]
            entries = np.column_stack(columns).tobytes()
            index_offsets[channel] = self._position
            head = bytes([Opcode.MESSAGE_INDEX]) + (6 + len(entries)).to_bytes(8, "little")
            head += channel.to_bytes(2, "little") + len(entries).to_bytes(4, "little")
            self._put(head + entries)
        return index_offsets

    def _statistics(self) -> records.Statistics:
        start_ns, end_ns = self.time_range_ns
        return records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts={n: self._counts[n] for n in self._channels if self._counts[n]},
            chunk_count=len(self._chunk_indexes),
            message_count=self._counts.total(),
            message_end_time=end_ns,
            message_start_time=start_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )

    def _put(self, data: bytes) -> None:
        self._data_crc = zlib.crc32(data, self._data_crc)
        self._stream.write(data)
        self._position += len(data)


def record_bytes(record: records.McapRecord) -> bytes:
    """With opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
