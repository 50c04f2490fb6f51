"""Headers of PNG and JPEG files in memory, whole and of a sane size before any is decoded; grey
images of users, PGM and PNG."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import Excessive, InputRefused, limit_of
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS

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


def picture_of(data: bytes) -> Picture:
    """The header of a whole PNG or JPEG.

    Raises ValueError, with what is wrong, for anything else and for one that is cut off or
    damaged, Excessive for one of more pixels than ``LIMITS`` allow: nothing is decoded for that.
    """
    if data.startswith(PNG_MAGIC):
        found = _png(data)
    elif data.startswith(JPEG_MAGIC):
        found = _jpeg(data)
    else:
        raise ValueError("is empty" if not data else "is neither a PNG nor a JPEG")
    require_size(found.width, found.height, found.channels * max(found.bits // 8, 1))
    return found


def require_size(width: int, height: int, pixel_bytes: int) -> None:
    """Raise ValueError for an image without pixels, Excessive for one of too many."""
    if width < 1 or height < 1:
        raise ValueError(f"an image of {width} x {height} pixels is empty")
    allowed, limit = min(
        (LIMITS.image_pixels, "image_pixels"),
        (LIMITS.image_decoded_bytes // pixel_bytes, "image_decoded_bytes"),
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


GrayImage = NDArray[np.uint8]

_PGM_HEADER = re.compile(
    rb"P[25]" + rb"(?:\s+(?:#[^\n]{0,4096}\n\s*){0,64})(\d{1,9})" * 3 + rb"(?:\s|\Z)"
)


def read_gray_image(path: Path) -> GrayImage:
    """(rows, columns) uint8, row 0 at the top, 0 black and 255 white.

    Brighter ranges are scaled down; colours become their luminance (ITU-R BT.601), and what is
    transparent keeps its colour. Raises NotFound, or InputRefused for anything but a whole PGM
    or PNG of at most ``LIMITS.image_pixels``.
    """
    data = read_input(path, "image_file_bytes")
    if data.startswith(PNG_MAGIC):
        return _read_png(data, path)
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(data, path)
    if not data:
        raise InputRefused(path, "is empty")
    raise InputRefused(path, "is not an image of the kinds PGM (P2, P5) or PNG")


def _read_pgm(data: bytes, path: Path) -> GrayImage:
    header = _PGM_HEADER.match(data)
    if header is None:
        raise InputRefused(path, "the PGM header (width, height, maximum) is damaged")
    width, height, maximum = (int(number) for number in header.groups())
    if not 1 <= maximum <= 65535:
        raise InputRefused(path, f"the PGM maximum is {maximum}, not within 1..65535")
    try:
        require_size(width, height, 2)
    except ValueError as error:
        raise InputRefused(path, str(error), limit=limit_of(error)) from None
    body = data[header.end() :]
    pixels = _plain_pixels if data.startswith(b"P2") else _raw_pixels
    values = pixels(body, width * height, maximum, path)
    if int(values.max()) > maximum:
        raise InputRefused(path, f"a pixel is {values.max()}, above the PGM maximum {maximum}")
    wide = values.astype(np.uint32)
    scaled = values if maximum == 255 else (wide * 510 + maximum) // (2 * maximum)
    return scaled.astype(np.uint8).reshape(height, width)


def _raw_pixels(body: bytes, count: int, maximum: int, path: Path) -> NDArray[np.uint16]:
    dtype = np.dtype(">u2" if maximum > 255 else "u1")
    if len(body) < count * dtype.itemsize:
        reason = f"is cut off: {len(body):,} of {count * dtype.itemsize:,} bytes of pixels"
        raise InputRefused(path, reason)
    return np.frombuffer(body, dtype, count).astype(np.uint16)


def _plain_pixels(body: bytes, count: int, maximum: int, path: Path) -> NDArray[np.uint16]:
    if len(body) < 2 * count - 1:
        raise InputRefused(path, f"is cut off: {len(body):,} bytes cannot hold {count:,} pixels")
    words = re.sub(rb"#[^\n]*", b"", body).split(maxsplit=count)[:count]
    if len(words) < count:
        raise InputRefused(path, f"is cut off: {len(words):,} of {count:,} pixels")
    try:
        values = np.array(words, dtype="S6").astype(np.int64)
    except ValueError as error:
        raise InputRefused(path, f"a pixel is not a number ({error})") from None
    if values.min() < 0 or values.max() > maximum:
        reason = f"pixels reach from {values.min()} to {values.max()}, not within 0..{maximum}"
        raise InputRefused(path, reason)
    return values.astype(np.uint16)


def _read_png(data: bytes, path: Path) -> GrayImage:
    try:
        picture = picture_of(data)
    except ValueError as error:
        raise InputRefused(path, str(error), limit=limit_of(error)) from None
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise InputRefused(path, f"the PNG cannot be decoded ({error.err})") from None
    if image is None or image.shape != (picture.height, picture.width):
        raise InputRefused(path, "the PNG cannot be decoded: its pixels are damaged")
    return np.asarray(image, np.uint8)
