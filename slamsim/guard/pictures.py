"""Headers of PNG and JPEG files in memory: whole and of a sane size, before any is decoded."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Literal

from slamsim.guard.errors import Excessive
from slamsim.guard.limits import LIMITS, Limits

PNG_MAGIC, JPEG_MAGIC = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DECODED_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 4, 6: 4}
"""What a decoder makes of a PNG's colour type; a palette may become colours with transparency."""
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"
_LONE_MARKERS = {0x01, *range(0xD0, 0xD9)}
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of a frame header, SOF0 to SOF15 (ITU-T T.81, table B.1)."""


@dataclass(frozen=True, slots=True)
class Picture:
    """What a header says. channels: as decoded. bits: of a sample."""

    kind: Literal["png", "jpeg"]
    width: int
    height: int
    channels: int
    bits: int


def picture_of(data: bytes, limits: Limits = LIMITS) -> Picture:
    """The header of a whole PNG or JPEG.

    Raises ValueError, with what is wrong, for anything else and for one that is cut off or
    damaged, Excessive for one of more pixels than ``limits`` allow: nothing is decoded for that.
    """
    if data.startswith(PNG_MAGIC):
        found = _png(data)
    elif data.startswith(JPEG_MAGIC):
        found = _jpeg(data)
    else:
        raise ValueError("is empty" if not data else "is neither a PNG nor a JPEG")
    require_size(found.width, found.height, found.channels * max(found.bits // 8, 1), limits)
    return found


def require_size(width: int, height: int, pixel_bytes: int, limits: Limits = LIMITS) -> None:
    """Raise ValueError for an image without pixels, Excessive for one of too many."""
    if width < 1 or height < 1:
        raise ValueError(f"an image of {width} x {height} pixels is empty")
    allowed, limit = min(
        (limits.image_pixels, "image_pixels"),
        (limits.image_decoded_bytes // pixel_bytes, "image_decoded_bytes"),
    )
    if width * height > allowed:
        raise Excessive(f"{width} x {height} pixels, at most {allowed:,} are read", limit)


def _png(data: bytes) -> Picture:
    """Every chunk with its CRC: the decoder would pass over a cut or a wrong one."""
    offset, header = len(PNG_MAGIC), None
    while offset + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, offset)
        end = offset + 12 + length
        if end > len(data):
            break
        kind = data[offset + 4 : offset + 8]
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[offset + 4 : end - 4]) != crc:
            raise ValueError(f"the PNG is damaged: wrong checksum at byte {offset}")
        if header is None:
            if kind != b"IHDR" or length != 13:
                raise ValueError("the PNG does not begin with its header")
            header = struct.unpack_from(">IIBB", data, offset + 8)
        if kind == b"IEND":
            return _png_picture(*header)
        offset = end
    raise ValueError(f"the PNG is cut off at byte {offset}")


def _png_picture(width: int, height: int, bits: int, colour: int) -> Picture:
    if colour not in _PNG_CHANNELS or bits not in (1, 2, 4, 8, 16):
        raise ValueError(f"the PNG header is damaged (depth {bits}, colour {colour})")
    return Picture("png", width, height, _DECODED_CHANNELS[colour], bits)


def _jpeg(data: bytes) -> Picture:
    """The segments up to the first scan, which must hold a frame header, and the end marker.

    Raises ValueError as ``picture_of``. Bytes behind the end are let pass: cameras pad with them.
    """
    offset, found = 2, None
    while offset + 4 <= len(data):
        marker = data[offset + 1]
        if data[offset] != 0xFF:
            raise ValueError(f"the JPEG is damaged: no marker at byte {offset}")
        if marker == 0xFF:  # fill bytes may stand before a marker
            offset += 1
            continue
        if marker in _LONE_MARKERS:
            offset += 2
            continue
        (length,) = struct.unpack_from(">H", data, offset + 2)
        if marker in _FRAMES:
            found = _jpeg_picture(data[offset + 4 : offset + 2 + length])
        if marker == _START_OF_SCAN:
            break
        offset += 2 + length
    if found is None or data.find(_END_OF_IMAGE, offset) < 0:
        raise ValueError(f"the JPEG is cut off after {len(data):,} bytes")
    return found


def _jpeg_picture(segment: bytes) -> Picture:
    if len(segment) < 6:
        raise ValueError("the JPEG is damaged: its frame header is too short")
    bits, height, width, channels = struct.unpack_from(">BHHB", segment)
    if bits != 8 or channels not in (1, 3, 4):
        raise ValueError(
            f"the JPEG has {channels} channels of {bits} bits; 1, 3 or 4 of 8 are read"
        )
    return Picture("jpeg", width, height, channels, bits)
