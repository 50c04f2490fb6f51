"""Reads text logs of users, plain or compressed, line by line within limits."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from slamsim.guard.errors import Excessive, InputRefused
from slamsim.guard.files import open_input
from slamsim.guard.limits import LIMITS, Limits

_BLOCK_BYTES = 1 << 16
_GZIP_MAGIC, _BZIP2_MAGIC, _BOM = b"\x1f\x8b", b"BZh", b"\xef\xbb\xbf"


class _Damaged(Exception):
    """Why no more can be read out of an archive; the line is known further up."""

    def __init__(self, reason: str, limit: str = "") -> None:
        self.limit = limit
        super().__init__(reason)


def open_lines(path: Path, limits: Limits = LIMITS) -> Iterator[tuple[int, str]]:
    """(1-based line number, line without its end) of a plain, gzip or bzip2 file.

    The first bytes decide which it is, not the name. Bytes that are not UTF-8 arrive as
    ``\\xNN``. Raises NotFound or InputRefused when the file cannot be opened, and InputRefused
    naming the line reached for a cut or damaged archive, a bomb, or a file that is not text.
    All whole lines before the damage are yielded first.
    """
    file = open_input(path)
    return _lines(path, file, limits)


def is_packed(path: Path) -> bool:
    """Whether ``open_lines`` would unpack this file; raises as it does."""
    with open_input(path) as file:
        magic = file.read(3)
    return magic.startswith(_GZIP_MAGIC) or magic == _BZIP2_MAGIC


def _lines(path: Path, file: BinaryIO, limits: Limits) -> Iterator[tuple[int, str]]:
    number, rest, total = 0, b"", 0
    with file:
        try:
            for block in _blocks(file):
                total += len(block)
                require_proportion(total, number, file.tell(), limits)
                joined = rest + block
                suspect = b"\0" in joined or len(joined) > limits.text_line_bytes
                pieces = joined.split(b"\n")
                rest = pieces.pop()
                for piece in pieces:
                    if suspect:
                        _check_line(piece, limits)
                    number += 1
                    yield number, _decode(piece, number)
                if suspect:
                    _check_line(rest, limits)
        except (_Damaged, Excessive) as damage:
            where = f"line {number + 1}"
            raise InputRefused(path, str(damage), where, limit=damage.limit) from None
        except OSError as error:
            reason = f"cannot be read: {error.strerror or error}"
            raise InputRefused(path, reason, f"line {number + 1}") from None
        if rest:
            yield number + 1, _decode(rest, number + 1)


def _decode(piece: bytes, number: int) -> str:
    if number == 1:
        piece = piece.removeprefix(_BOM)
    return piece.rstrip(b"\r").decode("utf-8", errors="backslashreplace")


def _check_line(piece: bytes, limits: Limits) -> None:
    if len(piece) > limits.text_line_bytes:
        reason = f"the line is longer than {limits.text_line_bytes:,} bytes"
        raise _Damaged(reason, "text_line_bytes")
    if b"\0" in piece:
        raise _Damaged("holds a NUL byte: this is not a text file")


def require_proportion(total: int, lines: int, packed: int, limits: Limits = LIMITS) -> None:
    """Raise Excessive for more text than belongs into this many bytes of a file, packed or not.

    total: bytes of text so far, in this many lines.
    """
    if total > limits.text_total_bytes:
        reason = f"more than {limits.text_total_bytes:,} bytes of text"
        raise Excessive(reason, "text_total_bytes")
    bomb = "unpacks to more text than a log of this size can hold"
    if lines > limits.text_lines_floor and lines > limits.text_lines_per_byte * packed:
        raise Excessive(bomb, "text_lines_per_byte")
    if total > limits.text_ratio_floor_bytes and total > limits.text_ratio * packed:
        raise Excessive(bomb, "text_ratio")


def _blocks(file: BinaryIO) -> Iterator[bytes]:
    magic = file.read(3)
    file.seek(0)
    if magic.startswith(_GZIP_MAGIC):
        return _gzip_blocks(file)
    if magic == _BZIP2_MAGIC:
        return _bzip2_blocks(file)
    return iter(lambda: file.read(_BLOCK_BYTES), b"")


def _gzip_blocks(file: BinaryIO) -> Iterator[bytes]:
    with gzip.GzipFile(fileobj=file, mode="rb") as archive:
        try:
            yield from iter(lambda: archive.read1(_BLOCK_BYTES), b"")
        except EOFError:
            raise _Damaged("the gzip file is cut off here") from None
        except (gzip.BadGzipFile, zlib.error) as error:
            raise _Damaged(f"the gzip file is damaged here ({error})") from None


def _bzip2_blocks(file: BinaryIO) -> Iterator[bytes]:
    """Stream after stream; the library's own reader would pass over damage at the end."""
    pending = file.read(_BLOCK_BYTES)
    while pending:
        decoder = bz2.BZ2Decompressor()
        while not decoder.eof:
            if decoder.needs_input and not pending:
                pending = file.read(_BLOCK_BYTES)
                if not pending:
                    raise _Damaged("the bzip2 file is cut off here")
            try:
                yield decoder.decompress(pending, _BLOCK_BYTES)
            except OSError:
                raise _Damaged("the bzip2 file is damaged here") from None
            pending = b""
        # Zeros that pad the file to a block of a tape or disk are no damage.
        pending = decoder.unused_data.lstrip(b"\0")
        while not pending and (block := file.read(_BLOCK_BYTES)):
            pending = block.lstrip(b"\0")
