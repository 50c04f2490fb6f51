"""Printed sheets, and panes of glass and mirrors, on walls."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.config.layout import PanesConfig, PostersConfig, Split
from slamsim.core.randomness import random_stream
from slamsim.core.types import Float32Array
from slamsim.world.looks.decals import Decal
from slamsim.world.looks.finishes import MaterialId
from slamsim.world.looks.places import WallSpace

_PAGES = 32
"""As many different prints as a world may have: each takes a megabyte."""

_PRINTS = 1 << 30
_COLUMNS = 160
_FRAME, _DARK = (0.35, 0.35, 0.36), {MaterialId.GLASS: 0.04, MaterialId.MIRROR: 0.06}
"""Colours of a frame of aluminium, and of what glass and mirrors reflect of themselves."""
_LETTERS = np.array(list("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789&?!"))
_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX)

Canvas = NDArray[np.uint8]


def hang_posters(
    space: WallSpace, config: PostersConfig, count: int, split: Split, rng: np.random.Generator
) -> list[Decal]:
    """As many of so many posters as find room, each a print of the split."""
    pages: dict[tuple[int, int], Float32Array] = {}
    numbers = 2 * rng.integers(_PRINTS, size=_PAGES) + (split == "test")
    decals: list[Decal] = []
    for index in range(count):
        tall = (1.0, 1.4, 1.0 / 1.4)[int(rng.integers(3))]
        width_m = float(rng.uniform(*config.size_m))
        others_m = np.array([space.middle_m(decal.place) for decal in decals]).reshape(-1, 3)
        place = space.hang((width_m, tall * width_m), config.height_m, others_m, rng)
        if place is not None:
            key = int(numbers[index % _PAGES]), round(tall * _COLUMNS)
            if key not in pages:
                pages[key] = poster_pixels(*key)
            decals.append(Decal(place, MaterialId.PAPER, pages[key]))
    return decals


def hang_panes(space: WallSpace, config: PanesConfig, rng: np.random.Generator) -> list[Decal]:
    """As many panes of glass, then mirrors, as find room, each with a thin frame."""
    kinds = [MaterialId.GLASS] * config.glass + [MaterialId.MIRROR] * config.mirrors
    decals: list[Decal] = []
    for material in kinds:
        width_m, height_m = rng.uniform(*config.size_m, 2).tolist()
        middle_m = 0.5 * height_m + 0.02
        heights_m = (middle_m, middle_m + 0.5)
        place = space.hang((width_m, height_m), heights_m, np.zeros((0, 3)), rng)
        if place is not None:
            pixels = np.full((32, 32, 3), _DARK[material], dtype=np.float32)
            pixels[[0, -1]] = pixels[:, [0, -1]] = _FRAME
            decals.append(Decal(place, material, pixels, is_crisp=True))
    return decals


def poster_pixels(number: int, rows: int) -> Float32Array:
    """(rows, 160, 3) linear colours of the print with a number: even ones are those of training."""
    rng = random_stream(number, "looks", "poster")
    page = np.empty((rows, _COLUMNS, 3), dtype=np.uint8)
    page[:] = rng.integers(120, 256, 3)
    _picture(page, rng)
    for _ in range(int(rng.integers(3, 8))):
        _shape(page, rng)
    for _ in range(int(rng.integers(2, 6))):
        _words(page, rng)
    return _linear(page)


def _picture(page: Canvas, rng: np.random.Generator) -> None:
    """A photograph, as far as corners and gradients go: noise of several sizes in three colours."""
    rows, columns = rng.integers((len(page) // 3, 50), (len(page) - 8, _COLUMNS - 8)).tolist()
    top, left = (
        int(rng.integers(4, 5 + most)) for most in (len(page) - 8 - rows, _COLUMNS - 8 - columns)
    )
    picture = np.full((rows, columns, 3), 0.45, dtype=np.float32)
    for spots in (3, 8, 20, 50):
        light = rng.normal(0.0, 0.5 / spots**0.35, (spots, spots, 1))
        tint = rng.normal(0.0, 0.15 / spots**0.35, (spots, spots, 3))
        coarse = (light + tint).astype(np.float32)
        picture += cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
    page[top : top + rows, left : left + columns] = np.clip(255.0 * picture, 0, 255)


def _shape(page: Canvas, rng: np.random.Generator) -> None:
    """A disc, a bar or a triangle of one colour."""
    colour = rng.integers(0, 256, 3).tolist()
    corners = rng.integers((0, 0), (_COLUMNS, len(page)), (3, 2)).astype(np.int32)
    kind = int(rng.integers(3))
    if kind == 0:
        cv2.circle(page, corners[0].tolist(), int(rng.integers(5, 30)), colour, -1, cv2.LINE_AA)
    elif kind == 1:
        far = corners[0] + rng.integers(6, 60, 2)
        cv2.rectangle(page, corners[0].tolist(), far.tolist(), colour, -1)
    else:
        cv2.fillConvexPoly(page, corners, colour, cv2.LINE_AA)


def _words(page: Canvas, rng: np.random.Generator) -> None:
    """A line of letters."""
    text = "".join(rng.choice(_LETTERS, int(rng.integers(3, 10))))
    place = int(rng.integers(2, 60)), int(rng.integers(20, len(page)))
    scale, font = float(rng.uniform(0.5, 1.4)), _FONTS[int(rng.integers(len(_FONTS)))]
    cv2.putText(page, text, place, font, scale, rng.integers(0, 256, 3).tolist(), 2, cv2.LINE_AA)


def _linear(page: Canvas) -> Float32Array:
    """Linear colours of sRGB ones (IEC 61966-2-1), between the ink and the paper of print."""
    share = page / np.float32(255.0)
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return (0.04 + 0.81 * light).astype(np.float32)
