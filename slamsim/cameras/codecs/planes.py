"""Lossless packing of numbers in images: bytes of differences between neighbours, then zstd.

What is smooth, or the same over whole areas, has neighbours whose bits hardly differ. Floats count
as the integers that their bits make, so that every one comes back as it was, nan included.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

_LEVEL = 1


def pack_planes(pixels: NDArray[Any]) -> bytes:
    """(h, w) or (h, w, channels) numbers of 1, 2, 4 or 8 bytes: differences along the rows, all
    first bytes before all second ones, little-endian."""
    words = _words(np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")))
    changes = words.copy()
    changes[:, 1:] -= words[:, :-1]
    planes = changes.reshape(-1).view(np.uint8).reshape(-1, words.itemsize).T
    return zstandard.ZstdCompressor(level=_LEVEL).compress(planes.tobytes())


def unpack_planes(data: bytes | memoryview, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """The image of this shape and dtype, whose size the caller has held to its limits.

    Raises ValueError for data that are damaged, cut, or of another size.
    """
    kind = np.dtype(dtype)
    size = int(np.prod(shape)) * kind.itemsize
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            content = reader.read(size + 1)
    except zstandard.ZstdError as error:
        raise ValueError(f"the zstd data are damaged ({error})") from None
    if len(content) != size:
        raise ValueError(f"the zstd data are {len(content):,} bytes, not {size:,}: cut or damaged")
    planes = np.frombuffer(content, np.uint8).reshape(kind.itemsize, -1)
    words = np.ascontiguousarray(planes.T).view(f"<u{kind.itemsize}").reshape(shape)
    whole = np.add.accumulate(words, axis=1, dtype=words.dtype)
    return np.asarray(whole.view(kind.newbyteorder("<")).astype(kind, copy=False))


def _words(pixels: NDArray[Any]) -> NDArray[Any]:
    return pixels.view(f"<u{pixels.dtype.itemsize}")
