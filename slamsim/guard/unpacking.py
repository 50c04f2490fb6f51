"""Unpacks gzip, bzip2 and zstd files block by block, and reads text logs line by line, within
limits."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from slamsim.guard.errors import Excessive, InputRefused
from slamsim.guard.files import open_input
from slamsim.guard.limits import LIMITS
from slamsim.guard.output import require_free_space

PACKINGS = (".gz", ".bz2", ".zst", ".zstd")
"""What the names of packed files end in; their first bytes decide."""
BLOCK_BYTES = 1 << 16
_GZIP_MAGIC, _BZIP2_MAGIC, _ZSTD_MAGIC = b"\x1f\x8b", b"BZh", b"\x28\xb5\x2f\xfd"
_MAGICS = (_GZIP_MAGIC, _BZIP2_MAGIC, _ZSTD_MAGIC)
PACKED_TWICE = "is packed twice; unpack it once, then give what comes out"
_MAGIC_BYTES, _ZSTD_HEAD_BYTES = 4, 18
_SPACE_ASKED_BYTES = 64 << 20


class Damaged(Exception):
    """Why no more can be read out of an archive; its place is known further up."""

    def __init__(self, reason: str, limit: str = "") -> None:
        self.limit = limit
        super().__init__(reason)


def is_packed(path: Path) -> bool:
    """Whether ``blocks`` would unpack this file; raises as ``open_input`` does."""
    with open_input(path) as file:
        magic = file.read(_MAGIC_BYTES)
    return magic.startswith(_MAGICS)


def unpack(path: Path, target: Path) -> None:
    """Write the content of a packed file into a new file.

    Never more than the limits allow, nor than the disk has room for: raises InputRefused for a
    bomb and for a damaged archive, DiskFull.
    """
    if damage := unpack_sound(path, target):
        raise damage


def unpack_sound(path: Path, target: Path) -> InputRefused | None:
    """``unpack`` as far as an archive is sound: what is wrong after that, None if nothing is.

    Raises InputRefused for a bomb, DiskFull.
    """
    total = 0
    with open_input(path) as file, target.open("xb") as unpacked:
        try:
            for block in blocks(file):
                if not total and block.startswith(_MAGICS):
                    raise Damaged(PACKED_TWICE)
                if total // _SPACE_ASKED_BYTES != (total + len(block)) // _SPACE_ASKED_BYTES:
                    require_free_space(target.parent, 2 * _SPACE_ASKED_BYTES)
                total += len(block)
                _require_proportion(total, file.tell())
                unpacked.write(block)
        except Damaged as damage:
            where = f"byte {total:,} of its content"
            refusal = InputRefused(path, str(damage), where, limit=damage.limit)
            if damage.limit:
                raise refusal from None
            return refusal
    return None


def _require_proportion(total: int, packed: int) -> None:
    if total > LIMITS.unpacked_file_bytes:
        reason = f"unpacks to more than {LIMITS.unpacked_file_bytes:,} bytes"
        raise Damaged(reason, "unpacked_file_bytes")
    if total > max(LIMITS.bag_ratio_floor_bytes, LIMITS.bag_ratio * packed):
        raise Damaged(f"unpacks to more than {LIMITS.bag_ratio} times its size", "bag_ratio")


def blocks(file: BinaryIO) -> Iterator[bytes]:
    """The content of an open file, unpacked if it is packed; raises Damaged."""
    magic = file.read(_MAGIC_BYTES)
    file.seek(0)
    if magic.startswith(_GZIP_MAGIC):
        return _gzip_blocks(file)
    if magic.startswith(_BZIP2_MAGIC):
        return _bzip2_blocks(file)
    if magic == _ZSTD_MAGIC:
        return _zstd_blocks(file)
    return iter(lambda: file.read(BLOCK_BYTES), b"")


def _zstd_blocks(file: BinaryIO) -> Iterator[bytes]:
    """The library reads over a cut; a frame that tells its size tells of one."""
    import zstandard

    try:
        announced = zstandard.frame_content_size(file.read(_ZSTD_HEAD_BYTES))
    except zstandard.ZstdError as error:
        raise Damaged(f"the zstd file is damaged at its beginning ({error})") from None
    file.seek(0)
    total = 0
    with zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True) as archive:
        try:
            for block in iter(lambda: archive.read(BLOCK_BYTES), b""):
                total += len(block)
                yield block
        except zstandard.ZstdError as error:
            raise Damaged(f"the zstd file is damaged here ({error})") from None
    if total < announced:
        raise Damaged("the zstd file is cut off here")


def _gzip_blocks(file: BinaryIO) -> Iterator[bytes]:
    with gzip.GzipFile(fileobj=file, mode="rb") as archive:
        try:
            yield from iter(lambda: archive.read1(BLOCK_BYTES), b"")
        except EOFError:
            raise Damaged("the gzip file is cut off here") from None
        except (gzip.BadGzipFile, zlib.error) as error:
            raise Damaged(f"the gzip file is damaged here ({error})") from None


def _bzip2_blocks(file: BinaryIO) -> Iterator[bytes]:
    """Stream after stream; the library's own reader would pass over damage at the end."""
    pending = file.read(BLOCK_BYTES)
    while pending:
        decoder = bz2.BZ2Decompressor()
        while not decoder.eof:
            if decoder.needs_input and not pending:
                pending = file.read(BLOCK_BYTES)
                if not pending:
                    raise Damaged("the bzip2 file is cut off here")
            try:
                yield decoder.decompress(pending, BLOCK_BYTES)
            except OSError:
                raise Damaged("the bzip2 file is damaged here") from None
            pending = b""
        # Zeros that pad the file to a block of a tape or disk are no damage.
        pending = decoder.unused_data.lstrip(b"\0")
        while not pending and (block := file.read(BLOCK_BYTES)):
            pending = block.lstrip(b"\0")


_BOM = b"\xef\xbb\xbf"


def open_lines(path: Path) -> Iterator[tuple[int, str]]:
    """(1-based line number, line without its end) of a plain, gzip, bzip2 or zstd file.

    The first bytes decide which it is, not the name. Bytes that are not UTF-8 arrive as
    ``\\xNN``. Raises NotFound or InputRefused when the file cannot be opened, and InputRefused
    naming the line reached for a cut or damaged archive, a bomb, or a file that is not text.
    All whole lines before the damage are yielded first.
    """
    file = open_input(path)
    return _lines(path, file)


def _lines(path: Path, file: BinaryIO) -> Iterator[tuple[int, str]]:
    number, rest, total = 0, b"", 0
    with file:
        try:
            for block in blocks(file):
                total += len(block)
                require_proportion(total, number, file.tell())
                joined = rest + block
                suspect = b"\0" in joined or len(joined) > LIMITS.text_line_bytes
                pieces = joined.split(b"\n")
                rest = pieces.pop()
                for piece in pieces:
                    if suspect:
                        _check_line(piece)
                    number += 1
                    yield number, _decode(piece, number)
                if suspect:
                    _check_line(rest)
        except (Damaged, Excessive) as damage:
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


def _check_line(piece: bytes) -> None:
    if len(piece) > LIMITS.text_line_bytes:
        reason = f"the line is longer than {LIMITS.text_line_bytes:,} bytes"
        raise Damaged(reason, "text_line_bytes")
    if b"\0" in piece:
        raise Damaged("holds a NUL byte: this is not a text file")


def require_proportion(total: int, lines: int, packed: int) -> None:
    """Raise Excessive for more text than belongs into this many bytes of a file, packed or not.

    total: bytes of text so far, in this many lines.
    """
    if total > LIMITS.text_total_bytes:
        reason = f"more than {LIMITS.text_total_bytes:,} bytes of text"
        raise Excessive(reason, "text_total_bytes")
    bomb = "unpacks to more text than a log of this size can hold"
    if lines > LIMITS.text_lines_floor and lines > LIMITS.text_lines_per_byte * packed:
        raise Excessive(bomb, "text_lines_per_byte")
    if total > LIMITS.text_ratio_floor_bytes and total > LIMITS.text_ratio * packed:
        raise Excessive(bomb, "text_ratio")
