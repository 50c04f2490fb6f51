"""Changes that know the records of MCAP and ROS 1 files: inside they are sound again after."""

from __future__ import annotations

import bz2
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from fault_changes import PLAIN
from fault_seeds import Unfit
from fault_strings import change_string

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK, _DATA_END, _FOOTER = 6, 15, 2
_PACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
}


@dataclass(frozen=True, slots=True)
class Record:
    """inside: the records of a chunk, None for any other record. packing: of a chunk."""

    opcode: int
    body: bytes
    inside: tuple[Record, ...] | None = None
    packing: str = ""


def change_records(data: bytes, rng: np.random.Generator) -> bytes:
    """One record of an MCAP file changed, lost, doubled or moved; lengths and sums repaired."""
    records = mcap_records(data)
    chunks = [i for i, record in enumerate(records) if record.inside]
    if chunks and rng.random() < 0.7:
        place = chunks[int(rng.integers(len(chunks)))]
        inside = _other_records(records[place].inside or (), rng)
        records[place] = replace(records[place], inside=inside)
    else:
        records = list(_other_records(tuple(records), rng))
    return mcap_bytes(records)


def mcap_records(data: bytes) -> list[Record]:
    """Of a sound file, chunks unpacked; raises Unfit for any other."""
    try:
        return [_unpacked(record) for record in _split(data[len(_MAGIC) : -len(_MAGIC)])]
    except Exception as error:
        raise Unfit from error


def mcap_bytes(records: list[Record]) -> bytes:
    """A file of these records, with the sums that belong to them."""
    file, crc_from = bytearray(_MAGIC), 0
    for record in records:
        if record.inside is not None:
            file += _packed(record)
        elif record.opcode == _DATA_END:
            file += _record(_DATA_END, struct.pack("<I", zlib.crc32(file)))
            crc_from = len(file)
        elif record.opcode == _FOOTER and len(record.body) == 20:
            head = struct.pack("<BQ", _FOOTER, 20) + record.body[:16]
            file += head + struct.pack("<I", zlib.crc32(head, zlib.crc32(file[crc_from:])))
        else:
            file += _record(record.opcode, record.body)
    return bytes(file + _MAGIC)


def _split(data: bytes) -> list[Record]:
    found, place = [], 0
    while place < len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        found.append(Record(opcode, data[place + 9 : place + 9 + length]))
        place += 9 + length
    if place != len(data):
        raise Unfit
    return found


def _unpacked(record: Record) -> Record:
    if record.opcode != _CHUNK:
        return record
    (named,) = struct.unpack_from("<I", record.body, 28)
    packing = record.body[32 : 32 + named].decode()
    data = record.body[40 + named :]
    if packing == "zstd":
        data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
    elif packing == "lz4":
        data = lz4.frame.decompress(data)
    return Record(_CHUNK, record.body[:16], tuple(_split(data)), packing)


def _packed(chunk: Record) -> bytes:
    content = b"".join(_record(record.opcode, record.body) for record in chunk.inside or ())
    data, name = _PACK[chunk.packing](content), chunk.packing.encode()
    sizes = struct.pack("<QI", len(content), zlib.crc32(content)) + struct.pack("<I", len(name))
    return _record(_CHUNK, chunk.body + sizes + name + struct.pack("<Q", len(data)) + data)


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _other_records(records: tuple[Record, ...], rng: np.random.Generator) -> tuple[Record, ...]:
    if not records:
        raise Unfit
    place, kind = int(rng.integers(len(records))), int(rng.integers(7))
    mine = records[place]
    if kind == 0:
        return records[:place] + records[place + 1 :]
    if kind == 1:
        copies = int(rng.integers(1, 5))
        return records[:place] + (mine,) * copies + records[place:]
    if kind == 2:
        other = int(rng.integers(len(records)))
        swapped = list(records)
        swapped[place], swapped[other] = swapped[other], swapped[place]
        return tuple(swapped)
    if kind == 3:
        changed = replace(mine, opcode=int(rng.integers(0, 20)), inside=None)
    elif kind == 4:
        changed = replace(mine, body=change_string(mine.body, rng))
    else:
        changed = replace(mine, body=PLAIN[int(rng.integers(len(PLAIN)))](mine.body, rng))
    return (*records[:place], changed, *records[place + 1 :])


def change_bag_records(data: bytes, rng: np.random.Generator) -> bytes:
    """One record of a ROS 1 bag (or in a chunk of it that is not packed) with its header or data
    changed, lengths repaired."""
    magic, _, rest = data.partition(b"\n")
    blocks = _blocks(rest)
    places = [i for i, block in enumerate(blocks) if block]
    place = places[int(rng.integers(len(places)))]
    change = change_string if rng.random() < 0.3 else PLAIN[int(rng.integers(len(PLAIN)))]
    packed = bz2.decompress(blocks[place]) if blocks[place].startswith(b"BZh") else None
    if packed is not None:
        blocks[place] = bz2.compress(change(packed, rng))
    else:
        blocks[place] = change(blocks[place], rng)
    joined = b"".join(struct.pack("<I", len(block)) + block for block in blocks)
    return magic + b"\n" + joined


def _blocks(data: bytes) -> list[bytes]:
    """Header, data, header, data ... of the records."""
    found, place = [], 0
    while place < len(data):
        length = int.from_bytes(data[place : place + 4], "little")
        if place + 4 + length > len(data):
            raise Unfit
        found.append(data[place + 4 : place + 4 + length])
        place += 4 + length
    if not any(found):
        raise Unfit
    return found
