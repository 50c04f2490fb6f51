"""Unpacks gzip, bzip2 and zstd files block by block within limits."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from slamsim.guard.errors import InputRefused
from slamsim.guard.files import open_input
from slamsim.guard.limits import LIMITS, Limits
from slamsim.guard.output import require_free_space

PACKINGS = (".gz", ".bz2", ".zst", ".zstd")
"""What the names of packed files end in; their first bytes decide."""
BLOCK_BYTES = 1 << 16
_GZIP_MAGIC, _BZIP2_MAGIC, _ZSTD_MAGIC = b"\x1f\x8b", b"BZh", b"\x28\xb5\x2f\xfd"
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
    return magic.startswith((_GZIP_MAGIC, _BZIP2_MAGIC, _ZSTD_MAGIC))


def unpack(path: Path, target: Path, limits: Limits = LIMITS) -> None:
    """Write the content of a packed file into a new file.

    Never more than the limits allow, nor than the disk has room for: raises InputRefused for a
    bomb and for a damaged archive, DiskFull.
    """
    total = 0
    with open_input(path) as file, target.open("xb") as unpacked:
        try:
            for block in blocks(file):
                if total // _SPACE_ASKED_BYTES != (total + len(block)) // _SPACE_ASKED_BYTES:
                    require_free_space(target.parent, 2 * _SPACE_ASKED_BYTES)
                total += len(block)
                _require_proportion(total, file.tell(), limits)
                unpacked.write(block)
        except Damaged as damage:
            where = f"byte {total:,} of its content"
            raise InputRefused(path, str(damage), where, limit=damage.limit) from None


def _require_proportion(total: int, packed: int, limits: Limits) -> None:
    if total > limits.unpacked_file_bytes:
        reason = f"unpacks to more than {limits.unpacked_file_bytes:,} bytes"
        raise Damaged(reason, "unpacked_file_bytes")
    if total > max(limits.bag_ratio_floor_bytes, limits.bag_ratio * packed):
        raise Damaged(f"unpacks to more than {limits.bag_ratio} times its size", "bag_ratio")


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
