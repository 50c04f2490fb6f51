"""JPEG and PNG files in memory, with channels in the order red, green, blue."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.guard.numbers import BadNumbers
from slamsim.guard.pictures import Picture, picture_of

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
_TO_RGB = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}
PNG_LEVEL = 1
"""Of zlib, from 0 to 9: noisy depth becomes hardly smaller beyond it, and takes several times as
long (``tests/cameras/test_codecs.py`` has the table)."""


def decode_picture(data: bytes) -> Pixels:
    """(h, w) or (h, w, 3) RGB, uint8 or uint16; what is transparent keeps its colour.

    The header is looked at before anything is decoded. Turns that a camera noted in EXIF are not
    made. Raises ValueError for what is no whole PNG or JPEG, Excessive beyond ``LIMITS``.
    """
    picture = picture_of(data)
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ValueError(f"the {picture.kind.upper()} cannot be decoded ({error.err})") from None
    if pixels is None or pixels.shape[:2] != (picture.height, picture.width):
        raise ValueError(f"the {picture.kind.upper()} cannot be decoded: its pixels are damaged")
    return _in_rgb(pixels, picture)


def _in_rgb(pixels: Any, picture: Picture) -> Pixels:
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"the {picture.kind.upper()} has samples of {pixels.dtype}")
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if channels <= 2:
        return np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, 0])
    return np.asarray(cv2.cvtColor(pixels, _TO_RGB[channels]))


def encode_jpeg(pixels: NDArray[np.uint8], quality: int = 90) -> bytes:
    """(h, w) grey or (h, w, 3) RGB as JPEG; quality from 0 to 100 (libjpeg's)."""
    return _encoded(".jpg", pixels, (np.uint8,), [cv2.IMWRITE_JPEG_QUALITY, quality])


def encode_png(pixels: Pixels, level: int = PNG_LEVEL) -> bytes:
    """(h, w) or (h, w, 3) RGB of 8 or 16 bits as PNG."""
    return _encoded(".png", pixels, (np.uint8, np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, level])


def _encoded(suffix: str, pixels: Pixels, dtypes: tuple[type, ...], options: list[int]) -> bytes:
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if pixels.ndim not in (2, 3) or channels not in (1, 3) or not pixels.size:
        raise BadNumbers(f"an image has (h, w) or (h, w, 3) pixels, not {pixels.shape}")
    if pixels.dtype not in dtypes:
        raise BadNumbers(f"images of {pixels.dtype} cannot be written as {suffix}")
    ordered = pixels if channels == 1 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(suffix, ordered, options)[1].tobytes())
