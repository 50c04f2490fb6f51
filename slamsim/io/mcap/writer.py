"""Writes one MCAP file of CDR messages in batches, with every CRC set.

The inside of a chunk is assembled here for many messages at once, which is ten times faster than
the ``mcap`` library's ``Writer.add_message``. A chunk is closed when it has reached 1 MiB, wherever
batches begin and end, so that equal messages make equal bytes.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import zstandard
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import NDArray

from slamsim.core.arrays import Samples
from slamsim.core.types import IntArray
from slamsim.io.mcap.framing import McapStream, record_bytes

CHUNK_BYTES = 1 << 20
ZSTD_LEVEL = 1
_FLUSH_EVERY_S = 1.0
"""So much of a recording may be lost when the machine loses power."""
_MESSAGE_HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_ns", "publish_ns"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": 31,
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch(Samples):
    """Messages of one channel and one size. log_ns: (n,). data: (n, size) uint8."""

    channel: int
    log_ns: IntArray
    data: NDArray[np.uint8]


class McapFile:
    """An MCAP file being written to a stream that the caller opened and closes."""

    def __init__(self, stream: BinaryIO, metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._file = McapStream(stream)
        self._schemas: dict[str, records.Schema] = {}
        self._counts: list[int] = []
        self._open: list[bytes | memoryview] = []
        self._open_bytes = 0
        self._open_index: list[tuple[NDArray[np.uint16], IntArray, IntArray]] = []
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._flushed_s = time.monotonic()
        for name, entries in metadata.items():
            self._file.put_metadata(name, entries)

    @property
    def counts(self) -> dict[str, int]:
        """Messages per topic in closed chunks."""
        return self._file.counts

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """Log time of the first and of the last message in closed chunks; (0, 0) without any."""
        return self._file.time_range_ns

    def put_attachment(self, attachment: records.Attachment) -> None:
        """Before the first message."""
        self._file.put_attachment(attachment)

    def add_channel(self, topic: str, type_name: str, definition: str, qos_yaml: str) -> int:
        """Its id. Schema and channel stand at the beginning of the next chunk."""
        schema = self._schemas.get(type_name)
        if schema is None:
            schema = records.Schema(
                id=len(self._schemas) + 1,
                data=definition.encode(),
                encoding="ros2msg",
                name=type_name,
            )
            self._schemas[type_name] = schema
            self._file.list_schema(schema)
            self._append_open(record_bytes(schema))
        channel = records.Channel(
            id=len(self._counts) + 1,
            topic=topic,
            message_encoding="cdr",
            metadata={"offered_qos_profiles": qos_yaml},
            schema_id=schema.id,
        )
        self._file.list_channel(channel)
        self._counts.append(0)
        self._append_open(record_bytes(channel))
        return int(channel.id)

    def write(self, batches: Sequence[MessageBatch]) -> None:
        """All messages of the batches in the order of log time; ties in the order given.

        The caller sees to it that no message is older than those of an earlier call.
        """
        batches = [batch for batch in batches if batch.log_ns.size]
        if not batches:
            return
        pieces: list[memoryview] = []
        for batch in batches:
            pieces += self._message_records(batch)
        log_ns = np.concatenate([batch.log_ns for batch in batches])
        channels = np.repeat(
            np.array([batch.channel for batch in batches], dtype=np.uint16),
            [batch.log_ns.size for batch in batches],
        )
        order = np.argsort(log_ns, kind="stable")
        ordered = [pieces[i] for i in order.tolist()]
        self._fill_chunks(ordered, channels[order], log_ns[order])
        if time.monotonic() - self._flushed_s >= _FLUSH_EVERY_S:
            self.sync()

    def sync(self) -> None:
        """Hands all closed chunks to the disk; an interrupted file keeps them."""
        self._file.sync()
        self._flushed_s = time.monotonic()

    def finish(self) -> None:
        """Closes the open chunk and writes index, statistics and footer."""
        self._close_chunk()
        self._file.finish()

    def _message_records(self, batch: MessageBatch) -> list[memoryview]:
        count, size = batch.data.shape
        head = np.zeros(count, dtype=_MESSAGE_HEAD)
        head["opcode"] = int(Opcode.MESSAGE)
        head["length"] = _MESSAGE_HEAD.itemsize - 9 + size
        head["channel"] = batch.channel
        head["sequence"] = self._counts[batch.channel - 1] + np.arange(count)
        head["log_ns"] = batch.log_ns
        head["publish_ns"] = batch.log_ns
        self._counts[batch.channel - 1] += count
        whole = np.concatenate([head.view(np.uint8).reshape(count, -1), batch.data], axis=1)
        step = whole.shape[1]
        view = memoryview(whole.tobytes())
        return [view[start : start + step] for start in range(0, count * step, step)]

    def _append_open(self, data: bytes) -> None:
        self._open.append(data)
        self._open_bytes += len(data)

    def _fill_chunks(
        self, pieces: list[memoryview], channels: NDArray[np.uint16], log_ns: IntArray
    ) -> None:
        sizes = np.array([len(piece) for piece in pieces], dtype=np.int64)
        starts = np.cumsum(sizes) - sizes
        begin = 0
        while begin < len(pieces):
            offsets = self._open_bytes + starts[begin:] - starts[begin]
            end = begin + int(np.searchsorted(offsets + sizes[begin:], CHUNK_BYTES)) + 1
            taken = slice(begin, min(end, len(pieces)))
            self._open += pieces[taken]
            self._open_bytes += int(sizes[taken].sum())
            count = taken.stop - begin
            self._open_index.append((channels[taken], log_ns[taken], offsets[:count]))
            if self._open_bytes >= CHUNK_BYTES:
                self._close_chunk()
            begin = taken.stop

    def _close_chunk(self) -> None:
        if not self._open_index:
            return
        content = b"".join(self._open)
        channels, log_ns, offsets = (
            np.concatenate([index[i] for index in self._open_index]) for i in range(3)
        )
        chunk = records.Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=int(log_ns[0]),
            message_end_time=int(log_ns[-1]),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        self._file.put_chunk(chunk, channels, log_ns, offsets)
        self._open, self._open_bytes, self._open_index = [], 0, []
