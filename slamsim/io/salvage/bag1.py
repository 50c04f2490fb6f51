"""Rebuilds a ROS 1 bag from its intact records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from struct import pack, unpack
from typing import BinaryIO

from slamsim.core.progress import Progress
from slamsim.io.bag1.reader import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER_BYTES,
    INDEX,
    MAGIC,
    MESSAGE,
    records_in_chunk,
)
from slamsim.io.salvage.bag1_salvage import (
    Bag1Salvage,
    Connection,
    Piece,
    WholeBag1Chunk,
    connection,
)
from slamsim.io.salvage.report import DecodableMessages, Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged, Gap, LoneMessage

_UNKNOWN = "messages that nothing describes any more, or that are damaged"


def recover_bag1(source: Damaged, folder: Path, progress: Progress) -> Recovered:
    """Into a new file in a folder; compressed chunks are copied as they are packed."""
    (path,) = source.files
    report, target = RecoveryReport(path), folder / f"{path.name.split('.')[0] or 'recording'}.bag"
    salvage = Bag1Salvage(path)
    with closing(salvage.file), target.open("xb") as stream:
        filler = Bag1Filler(stream, report)
        for known in salvage.index.connections:
            filler.know(known)
        for begun, piece in salvage.pieces(progress):
            _take(piece, begun, filler, report)
        filler.finish()
    report.note("A ROS 1 bag has no checksums: damage inside a message cannot be seen")
    if salvage.index.messages is None:
        report.note(f"{path.name} has no end: what should have followed is not counted as lost")
    else:
        report.announced = _by_topic(salvage.index.messages, filler)
    return recovered(target, [report])


def _take(piece: Piece | Gap, begun: int, filler: Bag1Filler, report: RecoveryReport) -> None:
    """begun: the byte from which on it was looked for."""
    match piece:
        case Gap():
            messages = None if piece.messages is None else _by_topic(piece.messages, filler)
            report.lose(piece.first_byte, piece.bytes, piece.reason, messages)
        case WholeBag1Chunk():
            undeclared = filler.chunk(piece)
            if undeclared:
                report.lose(begun, len(piece.packed), f"{undeclared} {_UNKNOWN}", {})
        case LoneMessage():
            if not filler.message(piece.record):
                report.lose(begun, len(piece.record), f"1 {_UNKNOWN}", {})
        case Connection():
            filler.know(piece)


def _by_topic(counts: Mapping[int, int], filler: Bag1Filler) -> dict[str, int]:
    by_topic = Counter[str]()
    for number, count in counts.items():
        if number in filler.known:
            by_topic[filler.known[number].topic] += count
    return dict(by_topic)


_CHUNK_BYTES = 768 << 10


@dataclass(frozen=True, slots=True)
class _Place:
    """A message in a chunk. time: as its header has it, seconds and nanoseconds."""

    connection: int
    time: bytes
    begin: int
    bytes: int

    @property
    def stamp_ns(self) -> int:
        seconds, nanoseconds = unpack("<II", self.time)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)


class Bag1Filler:
    """A new bag; the caller opened and closes the stream. known: connections by number."""

    def __init__(self, stream: BinaryIO, report: RecoveryReport) -> None:
        self._stream, self._report = stream, report
        self._readable = DecodableMessages()
        self.known: dict[int, Connection] = {}
        self._copied: set[int] = set()
        self._waiting = bytearray()
        self._infos: list[bytes] = []
        self._put(MAGIC + bytes(8 + HEADER_BYTES))

    def know(self, found: Connection) -> None:
        """A connection whose messages can be used from here on; of two the sound one."""
        known = self.known.setdefault(found.number, found)
        is_other = known.record != found.record and found.number not in self._copied
        if is_other and not known.fits_its_hash() and found.fits_its_hash():
            self.known[found.number] = known = found
        self._readable.describe(known.topic, known.type_name, "ros1", "ros1msg", known.definition)
        self._report.know(found.topic, found.type_name)

    def message(self, record: bytes) -> bool:
        """A message with its header; whether it could be used."""
        ((fields, _, data, _),) = records_in_chunk(record)
        if not self._is_usable(fields, record[data:]):
            return False
        self._waiting += record
        if len(self._waiting) >= _CHUNK_BYTES:
            self._pack()
        return True

    def chunk(self, chunk: WholeBag1Chunk) -> int:
        """A whole chunk as it is; how many messages are left out, of connections not known."""
        self._pack()
        places, undeclared, is_sound = self._places(chunk.content)
        if not is_sound:
            for place in places:
                self.message(chunk.content[place.begin : place.begin + place.bytes])
        elif places:
            self._copied.update(place.connection for place in places)
            self._chunk(chunk.compression, chunk.packed, len(chunk.content), places)
        return undeclared

    def finish(self) -> None:
        """Writes what is left, the index and, last, the header that leads to it."""
        self._pack()
        for known in self.known.values():
            if not known.fits_its_hash():
                self._report.note(f"{known.topic}: the definition of its messages may be damaged")
        index_pos = self._stream.tell()
        for known in self.known.values():
            self._put(known.record)
        for info in self._infos:
            self._put(info)
        counts = {b"conn_count": len(self.known), b"chunk_count": len(self._infos)}
        fields = {b"index_pos": pack("<Q", index_pos)}
        fields |= {name: pack("<I", count) for name, count in counts.items()}
        head = _header(BAG_HEADER, fields)
        padding = HEADER_BYTES + 4 - len(head)
        self._stream.seek(len(MAGIC))
        self._put(head + pack("<I", padding) + b" " * padding)

    def _places(self, content: bytes) -> tuple[list[_Place], int, bool]:
        """(messages that can be used, number of others, whether all of it can be used).

        Connections in it are known from here.
        """
        places, undeclared, is_sound = list[_Place](), 0, True
        for fields, begin, data, end in records_in_chunk(content):
            if fields[b"op"] == CONNECTION:
                found = connection(fields, content[begin:end], data - begin)
                self.know(found)
                is_sound &= self.known[found.number].record == found.record
            elif fields[b"op"] == MESSAGE:
                number = int.from_bytes(fields[b"conn"], "little")
                if self._is_usable(fields, content[data:end]):
                    places.append(_Place(number, fields[b"time"], begin, end - begin))
                else:
                    undeclared += 1
        return places, undeclared, is_sound and not undeclared

    def _is_usable(self, fields: dict[bytes, bytes], data: bytes) -> bool:
        known = self.known.get(int.from_bytes(fields[b"conn"], "little"))
        return known is not None and self._readable(known.topic, data)

    def _pack(self) -> None:
        """The messages that wait become a chunk, not compressed."""
        if self._waiting:
            content, self._waiting = bytes(self._waiting), bytearray()
            self._chunk("none", content, len(content), self._places(content)[0])

    def _chunk(self, compression: str, packed: bytes, size: int, places: list[_Place]) -> None:
        position = self._stream.tell()
        fields = {b"compression": compression.encode(), b"size": pack("<I", size)}
        self._put(_record(CHUNK, fields, packed))
        entries: dict[int, bytes] = {}
        for place in places:
            entry = place.time + pack("<I", place.begin)
            entries[place.connection] = entries.get(place.connection, b"") + entry
        counts = {number: len(entry) // 12 for number, entry in entries.items()}
        for number, entry in entries.items():
            fields = {b"ver": pack("<I", 1), b"conn": pack("<I", number)}
            fields |= {b"count": pack("<I", counts[number])}
            self._put(_record(INDEX, fields, entry))
        times = sorted(places, key=lambda place: place.stamp_ns)
        fields = {
            b"ver": pack("<I", 1),
            b"chunk_pos": pack("<Q", position),
            b"start_time": times[0].time,
            b"end_time": times[-1].time,
            b"count": pack("<I", len(counts)),
        }
        data = b"".join(pack("<II", number, count) for number, count in counts.items())
        self._infos.append(_record(CHUNK_INFO, fields, data))
        self._report.packed_bytes += len(packed)
        self._count(places)

    def _count(self, places: list[_Place]) -> None:
        by_topic: dict[str, list[_Place]] = {}
        for place in places:
            by_topic.setdefault(self.known[place.connection].topic, []).append(place)
        for topic, mine in by_topic.items():
            stamps = [place.stamp_ns for place in mine]
            size = sum(place.bytes for place in mine)
            self._report.keep(topic, len(mine), size, (min(stamps), max(stamps)))

    def _put(self, data: bytes) -> None:
        self._stream.write(data)


def _header(op: bytes, fields: dict[bytes, bytes]) -> bytes:
    pairs = [name + b"=" + value for name, value in {b"op": op, **fields}.items()]
    content = b"".join(pack("<I", len(pair)) + pair for pair in pairs)
    return pack("<I", len(content)) + content


def _record(op: bytes, fields: dict[bytes, bytes], data: bytes) -> bytes:
    return _header(op, fields) + pack("<I", len(data)) + data
