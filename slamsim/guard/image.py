"""Reads grey images of users: PGM (P2, P5) and PNG, with sizes checked before decoding."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import InputRefused, limit_of
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS, Limits
from slamsim.guard.pictures import PNG_MAGIC, picture_of, require_size

GrayImage = NDArray[np.uint8]

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
    if data.startswith(PNG_MAGIC):
        return _read_png(data, path, limits)
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(data, path, limits)
    if not data:
        raise InputRefused(path, "is empty")
    raise InputRefused(path, "is not an image of the kinds PGM (P2, P5) or PNG")


def _read_pgm(data: bytes, path: Path, limits: Limits) -> GrayImage:
    header = _PGM_HEADER.match(data)
    if header is None:
        raise InputRefused(path, "the PGM header (width, height, maximum) is damaged")
    width, height, maximum = (int(number) for number in header.groups())
    if not 1 <= maximum <= 65535:
        raise InputRefused(path, f"the PGM maximum is {maximum}, not within 1..65535")
    try:
        require_size(width, height, 2, limits)
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


def _read_png(data: bytes, path: Path, limits: Limits) -> GrayImage:
    try:
        picture = picture_of(data, limits)
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
