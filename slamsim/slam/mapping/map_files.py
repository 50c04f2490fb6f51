"""A grid as the files that other tools open: ROS map_server's PGM and YAML, and a PNG."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Grid

OCCUPIED, UNKNOWN, FREE = 0, 205, 254
_YAML_THRESHOLDS = (0.65, 0.196)
"""How map_server is to read the three grey values back: occupied above the first share of black,
free below the second; 205 is 0.19608 of black and must stay unknown."""


def map_files(grid: Grid) -> dict[str, bytes]:
    """``map.pgm``, ``map.yaml`` and ``map.png`` by name.

    Trinary map_server convention: 0 occupied, 254 free, 205 unknown; the first row of the image
    holds the largest y; ``origin`` is the pose of the lower left corner.
    """
    image = trinary_image(grid)
    rows, columns = image.shape
    x, y = (float(value) for value in grid.origin_m)
    text = (
        "image: map.pgm\n"
        "mode: trinary\n"
        f"resolution: {float(grid.resolution_m)!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {_YAML_THRESHOLDS[0]}\n"
        f"free_thresh: {_YAML_THRESHOLDS[1]}\n"
    )
    return {
        "map.pgm": f"P5\n{columns} {rows}\n255\n".encode() + image.tobytes(),
        "map.yaml": text.encode(),
        "map.png": _gray_png(image),
    }


def trinary_image(grid: Grid) -> NDArray[np.uint8]:
    """(rows, cols) grey values, the first row at the largest y."""
    image = np.full(grid.occupancy.shape, UNKNOWN, dtype=np.uint8)
    image[grid.occupancy > Grid.OCCUPIED_ABOVE] = OCCUPIED
    image[grid.occupancy < Grid.FREE_BELOW] = FREE
    return np.ascontiguousarray(image[::-1])


def _gray_png(image: NDArray[np.uint8]) -> bytes:
    """An 8-bit grey PNG (RFC 2083), each row unfiltered."""
    rows, columns = image.shape
    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    lines = np.pad(image, ((0, 0), (1, 0))).tobytes()
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(lines, 6)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(kind, data) for kind, data in chunks)


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)
