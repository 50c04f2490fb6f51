"""Decompresses the readable parts of a damaged text file: plain, gzip or bzip2.

Of gzip that is all before the damage, and further members; its checksum tells only at the end
whether there was any. Every block of bzip2 has a checksum of its own, and begins with the same 48
bits, at any bit: damaged ones are left out, as ``bzip2recover`` does.
"""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import BinaryIO

GZIP_MAGIC, BZIP2_MAGIC = b"\x1f\x8b\x08", b"BZh"

_BLOCK_BYTES = 1 << 16
_WINDOW_BYTES = 1 << 20
_BLOCK_BITS, _END_BITS = 0x314159265359, 0x177245385090
_MARK_BITS = 48
_END_BIT_COUNT = _MARK_BITS + 32
_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_LARGEST_BLOCK_BYTES = 2 << 20
_MOST_DAMAGED = 10_000


@dataclass(frozen=True, slots=True)
class Text:
    """data follow directly on the text before, unless a ``Hole`` stands between. read: bytes of
    the file so far."""

    data: bytes
    read: int


@dataclass(frozen=True, slots=True)
class Hole:
    """Something is missing here. is_suspect: whether the text before it may be wrong as well."""

    first_byte: int
    bytes: int
    reason: str
    is_suspect: bool = False


Piece = Text | Hole


def text_pieces(file: BinaryIO, compression: str) -> Iterator[Piece]:
    """compression: ``gz``, ``bz2`` or nothing."""
    if compression == "gz":
        return _gzip_pieces(file)
    if compression == "bz2":
        return _bzip2_pieces(file)
    return _plain_pieces(file)


def _plain_pieces(file: BinaryIO) -> Iterator[Piece]:
    while block := file.read(_BLOCK_BYTES):
        yield Text(block, file.tell())


def _gzip_pieces(file: BinaryIO) -> Iterator[Piece]:
    """Member after member."""
    size = file.seek(0, 2)
    position = 0
    while position < size:
        file.seek(position)
        decoder, begin = zlib.decompressobj(wbits=31), position
        try:
            while not decoder.eof:
                block = decoder.unconsumed_tail or file.read(_BLOCK_BYTES)
                if not block:
                    yield Hole(begin, 0, "the gzip file is cut off here")
                    return
                yield Text(decoder.decompress(block, _BLOCK_BYTES), file.tell())
            position = file.tell() - len(decoder.unused_data)
            position += _padding(file, position)
        except zlib.error as error:
            position = _next_member(file, max(file.tell() - _BLOCK_BYTES, begin + 1), size)
            reason = f"the gzip file is damaged here or before ({error})"
            yield Hole(begin, position - begin, reason, is_suspect=True)


def _padding(file: BinaryIO, position: int) -> int:
    """How many zeros follow there: they pad a file to a block of a tape or disk."""
    count = 0
    while block := _at(file, position + count, _BLOCK_BYTES):
        zeros = len(block) - len(block.lstrip(b"\0"))
        count += zeros
        if zeros < len(block):
            break
    return count


def _next_member(file: BinaryIO, position: int, size: int) -> int:
    """Where the next gzip member may begin, else the end."""
    while window := _at(file, position, _WINDOW_BYTES + len(GZIP_MAGIC) - 1):
        found = window.find(GZIP_MAGIC)
        if found >= 0:
            return position + found
        position += _WINDOW_BYTES
    return size


def _bzip2_pieces(file: BinaryIO) -> Iterator[Piece]:
    """Block after block, each as a file of its own."""
    size, damaged = file.seek(0, 2), 0
    begin, is_block = -_END_BIT_COUNT, False
    for end, next_is_block in chain(_bzip2_marks(file), [(8 * size, False)]):
        if is_block:
            text = _bzip2_block(file, begin, end)
            where, length = begin // 8, (end - begin) // 8
            piece = Text(text, end // 8) if text else Hole(where, length, "a damaged bzip2 block")
        else:
            piece = _between_streams(file, -(-(begin + _END_BIT_COUNT) // 8), end, size)
        damaged += isinstance(piece, Hole)
        if damaged > _MOST_DAMAGED:
            break
        yield piece
        begin, was_block, is_block = end, is_block, next_is_block
    if was_block:
        yield Hole(size, 0, "the bzip2 file is cut off here")


def _between_streams(file: BinaryIO, start: int, end: int, size: int) -> Piece:
    """Nothing, if between two streams there is only padding and the header of the second."""
    start += _padding(file, start)
    begins = 8 * (start + 4) == end and _at(file, start, 3) == BZIP2_MAGIC
    if begins or start >= size:
        return Text(b"", end // 8)
    return Hole(start, end // 8 - start, "here is no block of bzip2")


def _bzip2_block(file: BinaryIO, begin: int, end: int) -> bytes:
    """The text in the bits of a block; nothing if it does not fit its checksum."""
    first, last, count = begin // 8, -(-end // 8), end - begin
    if last - first > _LARGEST_BLOCK_BYTES or count < _END_BIT_COUNT:
        return b""
    bits = int.from_bytes(_at(file, first, last - first), "big") >> (8 * last - end)
    bits &= (1 << count) - 1
    checksum = bits >> (count - _END_BIT_COUNT) & 0xFFFFFFFF
    aligned = (bits << -count % 8).to_bytes(-(-count // 8), "big")
    decoder = bz2.BZ2Decompressor()
    try:
        parts = [decoder.decompress(BZIP2_MAGIC + b"9" + aligned)]
        parts += iter(lambda: decoder.decompress(b""), b"")
    except OSError:
        return b""
    text = b"".join(parts)
    return text if _bzip2_checksum(text) == checksum else b""


def _bzip2_checksum(text: bytes) -> int:
    """The CRC of zlib, with the bits of every byte, and of the result, the other way round."""
    crc = zlib.crc32(text.translate(_MIRRORED))
    return int.from_bytes(crc.to_bytes(4, "little").translate(_MIRRORED), "big")


def _bzip2_marks(file: BinaryIO) -> Iterator[tuple[int, bool]]:
    """(bit, whether a block begins there or the file ends) of every mark, in order."""
    shapes = [
        (shift, mark, (mark << (8 - shift)).to_bytes(7, "big"))
        for shift in range(8)
        for mark in (_BLOCK_BITS, _END_BITS)
    ]
    position = 0
    while window := _at(file, position, _WINDOW_BYTES + 7):
        found = []
        for shift, mark, shape in shapes:
            start = window.find(shape[1:6], 1)
            while 0 < start <= _WINDOW_BYTES:
                around = int.from_bytes(window[start - 1 : start + 6].ljust(7, b"\0"), "big")
                if around >> (8 - shift) & (1 << _MARK_BITS) - 1 == mark:
                    found.append((8 * (position + start - 1) + shift, mark == _BLOCK_BITS))
                start = window.find(shape[1:6], start + 1)
        yield from sorted(found)
        position += _WINDOW_BYTES


def _at(file: BinaryIO, position: int, length: int) -> bytes:
    file.seek(position)
    return file.read(length)
