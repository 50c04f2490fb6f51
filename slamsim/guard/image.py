"""Reads grey images of users: PGM (P2, P5) and PNG, with sizes checked before decoding."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS, Limits

GrayImage = NDArray[np.uint8]

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PGM_HEADER = re.compile(
    rb"P[25]" + rb"(?:\s+(?:#[^\n]{0,4096}\n\s*){0,64})(\d{1,9})" * 3 + rb"(?:\s|\Z)"
)


def read_gray_image(path: Path, limits: Limits = LIMITS) -> GrayImage:
    """(rows, columns) uint8, row 0 at the top, 0 black and 255 white.

    Brighter ranges are scaled down; colours become their luminance (ITU-R BT.601), and what is
    transparent keeps its colour. Raises NotFound, or InputRefused for anything but a whole PGM
    or PNG of at most ``limits.image_pixels``.
    """
    data = read_input(path, "image_file_bytes", limits)
    if data.startswith(_PNG_MAGIC):
        return _read_png(data, path, limits)
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(data, path, limits)
    if not data:
        raise InputRefused(path, "is empty")
    raise InputRefused(path, "is not an image of the kinds PGM (P2, P5) or PNG")


def _check_size(width: int, height: int, bytes_per_pixel: int, path: Path, limits: Limits) -> None:
    if width < 1 or height < 1:
        raise InputRefused(path, f"an image of {width} x {height} pixels is empty")
    pixels = width * height
    allowed, limit = min(
        (limits.image_pixels, "image_pixels"),
        (limits.image_decoded_bytes // bytes_per_pixel, "image_decoded_bytes"),
    )
    if pixels > allowed:
        reason = f"{width} x {height} pixels, at most {allowed:,} are read"
        raise InputRefused(path, reason, limit=limit)


def _read_pgm(data: bytes, path: Path, limits: Limits) -> GrayImage:
    header = _PGM_HEADER.match(data)
    if header is None:
        raise InputRefused(path, "the PGM header (width, height, maximum) is damaged")
    width, height, maximum = (int(number) for number in header.groups())
    if not 1 <= maximum <= 65535:
        raise InputRefused(path, f"the PGM maximum is {maximum}, not within 1..65535")
    _check_size(width, height, 2, path, limits)
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


def _read_png(data: bytes, path: Path, limits: Limits) -> GrayImage:
    width, height, depth, colour = _check_png(data, path)
    if colour not in _PNG_CHANNELS or depth not in (1, 2, 4, 8, 16):
        raise InputRefused(path, f"the PNG header is damaged (depth {depth}, colour {colour})")
    bytes_per_pixel = _PNG_CHANNELS[colour] * max(depth // 8, 1)
    _check_size(width, height, bytes_per_pixel, path, limits)
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise InputRefused(path, f"the PNG cannot be decoded ({error.err})") from None
    if image is None or image.shape != (height, width):
        raise InputRefused(path, "the PNG cannot be decoded: its pixels are damaged")
    return np.asarray(image, np.uint8)


def _check_png(data: bytes, path: Path) -> tuple[int, int, int, int]:
    """Width, height, depth and colour type; the decoder would pass over a cut or a wrong CRC."""
    offset, header = len(_PNG_MAGIC), None
    while offset + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, offset)
        end = offset + 12 + length
        if end > len(data):
            break
        kind = data[offset + 4 : offset + 8]
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[offset + 4 : end - 4]) != crc:
            raise InputRefused(path, "the PNG is damaged: wrong checksum", f"byte {offset}")
        if header is None:
            if kind != b"IHDR" or length != 13:
                raise InputRefused(path, "the PNG does not begin with its header")
            header = struct.unpack_from(">IIBB", data, offset + 8)
        if kind == b"IEND":
            return header
        offset = end
    raise InputRefused(path, "the PNG is cut off", f"byte {offset}")
