"""Lossless codecs of 16-bit depth images, and the compressedDepth transport of ROS.

Images are (h, w) uint16, 0 where there is no depth.
"""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import decode_picture, encode_png
from slamsim.cameras.codecs.planes import pack_planes, unpack_planes
from slamsim.cameras.codecs.rvl import decode_rvl, encode_rvl
from slamsim.core.types import Float32Array
from slamsim.guard.numbers import BadNumbers
from slamsim.guard.pictures import require_size

DepthCodec = Literal["png", "rvl", "zstd"]
DepthImage = NDArray[np.uint16]

_SIZE = struct.Struct("<II")
"""Columns and rows, before the data of RVL (as compressedDepth has them) and of zstd."""
_TRANSPORT = struct.Struct("<iff")
"""The head of compressedDepth: kind (0), and the two parameters of inverse depth."""
DEPTH_HEAD_BYTES = _TRANSPORT.size
_PARAMETER = 100.0
"""depth_quantization of compressed_depth_image_transport, as it is by default."""


def encode_depth(depths: DepthImage, codec: DepthCodec) -> bytes:
    """One image (h, w) of uint16; ``decode_depth`` gives the same back bit for bit.

    Raises BadNumbers for any other array.
    """
    if depths.dtype != np.uint16 or depths.ndim != 2 or not depths.size:
        raise BadNumbers(f"a depth image is (h, w) uint16, not {depths.shape} {depths.dtype}")
    if codec == "png":
        return encode_png(depths)
    size = _SIZE.pack(depths.shape[1], depths.shape[0])
    return size + (encode_rvl(depths) if codec == "rvl" else pack_planes(depths))


def decode_depth(data: bytes, codec: DepthCodec) -> DepthImage:
    """(h, w) uint16. Raises ValueError for what is damaged or cut, Excessive beyond ``LIMITS``."""
    if codec == "png":
        pixels = decode_picture(data)
        if pixels.ndim != 2 or pixels.dtype != np.uint16:
            raise ValueError("a PNG of depths has one channel of 16 bits")
        return np.asarray(pixels, np.uint16)
    if len(data) < _SIZE.size:
        raise ValueError("the depth image is cut off before its size")
    width, height = _SIZE.unpack_from(data)
    require_size(width, height, 2)
    body = memoryview(data)[_SIZE.size :]
    if codec == "zstd":
        return unpack_planes(body, (height, width), "u2")
    return np.asarray(decode_rvl(body, width * height).reshape(height, width), np.uint16)


def encode_compressed_depth(
    depths: DepthImage | Float32Array, codec: Literal["png", "rvl"] = "png", most_m: float = 10.0
) -> tuple[str, bytes]:
    """(format, data) of a CompressedImage as compressed_depth_image_transport publishes it.

    depths: (h, w) uint16 millimetres, kept bit for bit; or float32 metres, of which the inverse is
    quantised to 16 bits: nan, and from most_m on, become none. Off by less than depth^2 / 10,100 m:
    10 mm at 10 m.
    """
    if depths.dtype == np.uint16:
        head, words, kind = _TRANSPORT.pack(0, 0.0, 0.0), np.asarray(depths, np.uint16), "16UC1"
    else:
        quotient = _PARAMETER * (_PARAMETER + 1.0)
        shift = 1.0 - quotient / most_m
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = quotient / np.asarray(depths, np.float64) + shift
            is_there = (depths > 0.0) & (depths < most_m) & (inverse < 65535.5)
        words = np.where(is_there, inverse, 0.0).astype(np.uint16)
        head, kind = _TRANSPORT.pack(0, quotient, shift), "32FC1"
    return f"{kind}; compressedDepth {codec}", head + encode_depth(words, codec)


def decode_compressed_depth(told: str, data: bytes) -> DepthImage | Float32Array:
    """The image of a CompressedImage with the format ``told``: uint16 as it was, or float32 metres
    with nan for none.

    Formats of before 2021 end in ``compressedDepth`` and mean PNG. Raises ValueError for another
    format or what is damaged, Excessive beyond ``LIMITS``. The image is (h, w).
    """
    kind, _, rest = told.partition(";")
    words = rest.split()
    codec = words[1] if len(words) > 1 else "png"
    if kind.strip() not in ("16UC1", "32FC1") or words[:1] != ["compressedDepth"]:
        raise ValueError(
            f"the format {told[:60]!r} is no compressedDepth of 16UC1 or 32FC1, such as "
            "'16UC1; compressedDepth png'"
        )
    if codec not in ("png", "rvl"):
        raise ValueError(f"compressedDepth {codec[:20]!r} is not known; png and rvl are")
    if len(data) <= _TRANSPORT.size:
        raise ValueError("the compressedDepth image is cut off in its head of 12 bytes")
    _, quotient, shift = _TRANSPORT.unpack_from(data)
    plain = decode_depth(data[_TRANSPORT.size :], "rvl" if codec == "rvl" else "png")
    return plain if kind.strip() == "16UC1" else _of_inverse(plain, quotient, shift)


def _of_inverse(words: DepthImage, quotient: float, shift: float) -> Float32Array:
    if not (np.isfinite([quotient, shift]).all() and quotient > 0.0):
        raise ValueError(f"the parameters of inverse depth are {quotient:g} and {shift:g}")
    with np.errstate(divide="ignore", invalid="ignore"):
        depths_m = np.float32(quotient) / (words.astype(np.float32) - np.float32(shift))
        return np.where((words > 0) & (depths_m > 0.0), depths_m, np.float32(np.nan))
