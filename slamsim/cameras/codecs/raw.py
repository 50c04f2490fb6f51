"""Pixels as sensor_msgs/Image holds them: every encoding that cv_bridge knows as an image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import nearest_name, shown
from slamsim.guard.pictures import require_size

Kind = Literal["colour", "grey", "depth"]


_NEAREST_M, _FARTHEST_M = 0.01, 1000.0
"""Between these lies every depth that a camera measures, in metres."""


@dataclass(frozen=True, slots=True)
class Encoding:
    """dtype and channels: of a pixel as stored. to_rgb: OpenCV's conversion, None for none."""

    kind: Kind
    dtype: str
    channels: int = 1
    to_rgb: int | None = None


_BGR = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}
_BAYER = {
    "rggb": cv2.COLOR_BayerRGGB2RGB,
    "bggr": cv2.COLOR_BayerBGGR2RGB,
    "gbrg": cv2.COLOR_BayerGBRG2RGB,
    "grbg": cv2.COLOR_BayerGRBG2RGB,
}
"""Named after the first pixels of the first two rows, as in ROS (REP 118's image_encodings.h)."""
_UYVY, _YUYV = (Encoding("colour", "u1", 2, code) for code in (107, 115))

ENCODINGS: Mapping[str, Encoding] = {
    "rgb8": Encoding("colour", "u1", 3),
    "rgba8": Encoding("colour", "u1", 4, cv2.COLOR_RGBA2RGB),
    "bgr8": Encoding("colour", "u1", 3, _BGR[3]),
    "bgra8": Encoding("colour", "u1", 4, _BGR[4]),
    "8UC3": Encoding("colour", "u1", 3, _BGR[3]),
    "8UC4": Encoding("colour", "u1", 4, _BGR[4]),
    "rgb16": Encoding("colour", "u2", 3),
    "rgba16": Encoding("colour", "u2", 4, cv2.COLOR_RGBA2RGB),
    "bgr16": Encoding("colour", "u2", 3, _BGR[3]),
    "bgra16": Encoding("colour", "u2", 4, _BGR[4]),
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUYV,
    "yuyv": _YUYV,
    "mono8": Encoding("grey", "u1"),
    "8UC1": Encoding("grey", "u1"),
    "mono16": Encoding("grey", "u2"),
    "16UC1": Encoding("depth", "u2"),
    "32FC1": Encoding("depth", "f4"),
    **{f"bayer_{name}8": Encoding("colour", "u1", 1, code) for name, code in _BAYER.items()},
    **{f"bayer_{name}16": Encoding("colour", "u2", 1, code) for name, code in _BAYER.items()},
}
"""Of REP 118 and image_encodings.h; those without a meaning for an image, such as 64FC4, are not
there. 8UC3 and 8UC4 are taken for OpenCV's order, blue first."""


def encoding_of(name: str) -> Encoding:
    """Raises ValueError for an unknown one, which names the known and the nearest."""
    if name in ENCODINGS:
        return ENCODINGS[name]
    lower = {known.lower(): known for known in ENCODINGS}
    near = nearest_name(name.lower(), lower)
    meant = f"; did you mean {lower[near]!r}?" if near else ""
    known = ", ".join(ENCODINGS)
    raise ValueError(f"the encoding {shown(name)} is not known{meant or '.'} Known are {known}")


@dataclass(frozen=True, slots=True, eq=False)
class RawImage:
    """What a sensor_msgs/Image says. data: (n,) uint8; row_bytes: ``step``, padding included."""

    height: int
    width: int
    encoding: str
    is_bigendian: bool
    row_bytes: int
    data: NDArray[np.uint8]


def decode_raw(image: RawImage) -> tuple[Kind, NDArray[Any]]:
    """Its kind, and the pixels: colour (h, w, 3) uint8 RGB, grey (h, w) uint8, depth (h, w) as
    stored, uint16 millimetres or float32 metres.

    Of 16 bits of colour and grey the upper eight are kept. Raises ValueError for an unknown
    encoding, no pixels or too few bytes, Excessive beyond ``LIMITS``.
    """
    encoding = encoding_of(image.encoding)
    stored = _stored(image, encoding)
    if encoding.kind == "depth":
        return "depth", stored
    pixels = (stored >> 8).astype(np.uint8) if stored.dtype == np.uint16 else stored
    if encoding.to_rgb is not None:
        pixels = _converted(pixels, encoding.to_rgb)
    return encoding.kind, np.ascontiguousarray(pixels)


def _stored(image: RawImage, encoding: Encoding) -> NDArray[Any]:
    """(h, w) or (h, w, channels) in the byte order of this machine."""
    order = ">" if image.is_bigendian else "<"
    dtype, channels = np.dtype(order + encoding.dtype), encoding.channels
    require_size(image.width, image.height, channels * dtype.itemsize)
    rows, used = image.height, image.width * channels * dtype.itemsize
    if image.row_bytes < used:
        reason = f"rows of {image.row_bytes:,} bytes cannot hold {image.width} pixels of"
        raise ValueError(f"{reason} {image.encoding}, which take {used:,}")
    if image.data.size < image.row_bytes * (rows - 1) + used:
        reason = f"is cut off: {image.data.size:,} of {image.row_bytes * rows:,} bytes"
        raise ValueError(reason)
    if encoding.kind == "depth" and encoding.dtype == "u2" and _are_metres(image):
        raise ValueError(
            f"its rows hold four bytes a pixel, which are floats in metres: {image.encoding} has "
            "two, 32FC1 holds floats (REP 118)"
        )
    whole = np.lib.stride_tricks.as_strided(image.data, (rows, used), (image.row_bytes, 1))
    pixels = np.ascontiguousarray(whole).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return pixels.reshape(rows, image.width, channels) if channels > 1 else pixels


def _are_metres(image: RawImage) -> bool:
    """Whether rows that are twice as long as they need be hold a depth in metres for each pixel.

    What pads rows of integers makes no such floats: their exponents would have to fit each time.
    """
    rows, used = image.height, 4 * image.width
    if image.row_bytes != used or image.data.size < rows * used:
        return False
    order = ">" if image.is_bigendian else "<"
    depths = np.ascontiguousarray(image.data[: rows * used]).view(f"{order}f4")
    found = depths[np.isfinite(depths) & (depths != 0.0)]
    return bool(found.size and found.min() > _NEAREST_M and found.max() < _FARTHEST_M)


def _converted(pixels: NDArray[np.uint8], code: int) -> NDArray[np.uint8]:
    try:
        return np.asarray(cv2.cvtColor(pixels, code), np.uint8)
    except cv2.error:
        height, width = pixels.shape[:2]
        reason = f"{width} x {height} pixels are too few, or not an even number in a row"
        raise ValueError(f"{reason}, for colours from such an encoding") from None
