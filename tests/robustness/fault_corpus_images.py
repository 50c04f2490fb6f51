"""Hostile images and the maps of ROS map_server."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import cv2
import fault_doors as doors
import numpy as np
from fault_corpus_base import Hostile, one, several
from numpy.typing import NDArray


def chunk(kind: bytes, data: bytes) -> bytes:
    """Of a PNG, with its checksum."""
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def png(width: int, height: int, packed: bytes, depth: int = 8, colour: int = 0) -> bytes:
    """packed: the compressed pixels, whatever the header says."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


@cache
def _zeros(count_mib: int) -> bytes:
    packer = zlib.compressobj(1)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(count_mib)) + packer.flush()


def _packed(gray: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", (255 * gray).astype(np.uint8))[1].tobytes()


def _small() -> bytes:
    walls = np.full((40, 40), 255, np.uint8)
    walls[[0, -1]] = walls[:, [0, -1]] = 0
    return cv2.imencode(".png", walls)[1].tobytes()


SMALL = _small()
DESCRIBED = (
    "image: map.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
)

IMAGES: dict[str, tuple[bytes | Callable[[], bytes], str]] = {
    "PNG of 100,000 by 100,000": (png(100_000, 100_000, b""), "at most"),
    "PNG of 30,000 by 30,000, packed": (lambda: png(30_000, 30_000, _zeros(900)), "at most"),
    "PNG of 2 billion by 1": (png(2**31 - 1, 1, b""), "at most"),
    "PNG of nothing": (png(0, 7, b""), "empty"),
    "PNG with more pixels than it says": (lambda: png(8, 8, _zeros(64)), ""),
    "PNG with fewer pixels than it says": (png(4000, 4000, zlib.compress(b"\0" * 9)), "damaged"),
    "PNG whose pixels are rubbish": (png(9, 9, bytes(range(99))), "damaged"),
    "PNG of depth 7": (png(8, 8, zlib.compress(bytes(72)), 7), "header is damaged"),
    "PNG of colour 5": (png(8, 8, zlib.compress(bytes(72)), 8, 5), "header is damaged"),
    "PNG palette without colours": (png(8, 8, zlib.compress(bytes(72)), 8, 3), "damaged"),
    "PNG of four 16-bit channels": (png(8000, 8000, b"", 16, 6), "at most"),
    "PNG cut off": (SMALL[:-20], "cut off"),
    "PNG with a flipped bit": (SMALL[:50] + bytes([SMALL[50] ^ 4]) + SMALL[51:], "checksum"),
    "PNG without a header": (SMALL[:8] + SMALL[33:], "header"),
    "PNG with a chunk of 4 GB": (
        SMALL[:33] + struct.pack(">I", 2**32 - 1) + b"IDAT" + SMALL[41:],
        "cut off",
    ),
    "PNG with 100,000 chunks": (
        SMALL[:33] + chunk(b"tEXt", b"a\0b") * 100_000 + SMALL[33:],
        "",
    ),
    "PNG with a packed text of 1 GB": (
        lambda: SMALL[:33] + chunk(b"zTXt", b"a\0\0" + _zeros(900)) + SMALL[33:],
        "",
    ),
    "PNG with a packed profile of 1 GB": (
        lambda: SMALL[:33] + chunk(b"iCCP", b"a\0\0" + _zeros(900)) + SMALL[33:],
        "",
    ),
    "PGM of 100,000 by 100,000": (b"P5 100000 100000 255\n", "at most"),
    "PGM of 10^9 by 10^9": (b"P5 999999999 999999999 255\n", "at most"),
    "PGM of 10^20": (b"P5 100000000000000000000 1 255\n", "header"),
    "PGM of -1": (b"P5 -1 1 255\n\0", "header"),
    "PGM whose brightest is 0": (b"P5 1 1 0\n\0", "maximum"),
    "PGM whose brightest is 10^6": (b"P5 1 1 1000000\n\0", "maximum"),
    "PGM cut off": (b"P5 100 100 255\n" + bytes(99), "cut off"),
    "PGM with a comment of 50 MB": (b"P5\n#" + b"x" * 50_000_000 + b"\n1 1 255\n\0", "header"),
    "PGM with 100,000 comments": (b"P5\n" + b"#\n" * 100_000 + b"1 1 255\n\0", "header"),
    "PGM brighter than it says": (b"P5 1 1 9\n\xff", "above"),
    "PGM of words": (b"P2 2 2 255\n1 2 three 4\n", "number"),
    "PGM of a million digits": (b"P2 1 1 255\n" + b"9" * 1_000_000, "pixels reach"),
    "PGM of negative numbers": (b"P2 2 1 255\n-1 3\n", "pixels reach"),
    "PGM of a comment in pixels": (b"P2 2 1 255\n# 1 2 3\n4 5\n", ""),
    "PPM": (b"P6 1 1 255\n\0\0\0", "kinds PGM"),
    "a text": (b"hello", "kinds PGM"),
    "an empty image": (b"", "empty"),
    "JPEG": (b"\xff\xd8\xff\xe0" + bytes(100), "kinds PGM"),
}

MAPS: dict[str, tuple[str, bytes | Callable[[], bytes], str]] = {
    "map of an image elsewhere": (DESCRIBED.replace("map.png", "../../map.png"), SMALL, "inside"),
    "map of an absolute image": (DESCRIBED.replace("map.png", "/etc/hostname"), SMALL, "inside"),
    "map of an image with NUL": (DESCRIBED.replace("map.png", r'"a\0b"'), SMALL, "inside"),
    "map of itself": (DESCRIBED.replace("map.png", "a.yaml"), SMALL, "kinds PGM"),
    "map of a folder": (DESCRIBED.replace("map.png", "."), SMALL, "folder"),
    "map of nothing": (DESCRIBED.replace("map.png", "no.png"), SMALL, "no such file"),
    "map with a resolution of 0": (DESCRIBED.replace("0.1\n", "0\n"), SMALL, "resolution"),
    "map with a resolution of nan": (DESCRIBED.replace("0.1\n", ".nan\n"), SMALL, "finite"),
    "map at the end of the world": (DESCRIBED.replace("[0.0", "[1.0e+300"), SMALL, "origin"),
    "map turned for ever": (DESCRIBED.replace("0.0]", "1.0e+300]"), SMALL, "origin"),
    "map with thresholds crossed": (DESCRIBED.replace("0.65", "0.1"), SMALL, "free_thresh"),
    "map without a wall": (DESCRIBED.replace("0.65", "1.0"), SMALL, "not one of its"),
    "map of one pixel": (DESCRIBED, png(1, 1, zlib.compress(b"\0\0")), "clearance_m"),
    "map that is all wall": (
        DESCRIBED,
        png(800, 800, zlib.compress((b"\0" + bytes(800)) * 800)),
        "clearance_m",
    ),
    "map of noise": (
        DESCRIBED,
        lambda: _packed(np.random.default_rng(1).integers(0, 2, (3000, 3000))),
        "this is noise",
    ),
    "map of a fine chessboard": (
        DESCRIBED,
        lambda: _packed(np.tile(np.eye(2), (3000, 3000))),
        "this is noise",
    ),
}
"""The description, its image, and words of the refusal."""


def hostile_images() -> Iterator[Hostile]:
    """All of them."""
    for number, (name, (data, words)) in enumerate(IMAGES.items()):
        if number % 6 == 0:
            fill = several(a__yaml=DESCRIBED, map__png=data)
            yield Hostile(name, "a.yaml", fill, doors.world, words, ("world",))
        else:
            yield Hostile(name, "map", one("map", data), doors.image, words)
    for number, (name, (text, data, words)) in enumerate(MAPS.items()):
        command = ("world",) if number % 4 == 0 else ()
        fill = several(a__yaml=text, map__png=data)
        yield Hostile(name, "a.yaml", fill, doors.world, words, command)
