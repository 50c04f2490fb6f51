"""The families of finishes: what walls, floor and things are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slamsim.config.layout import Family, Split
from slamsim.world.looks.finishes import Finish, FinishRange, MaterialId, Rgb
from slamsim.world.looks.patterns import Pattern

Ranges = tuple[FinishRange, ...]


@dataclass(frozen=True, slots=True)
class FamilyRanges:
    """wooden: tables, chairs and panels; packed: boxes; other: the remaining things."""

    wall: Ranges
    floor: Ranges
    wooden: Ranges
    packed: Ranges
    other: Ranges

    def of(self, part: str) -> Ranges:
        """Those of a kind of part, as ``world.parts`` names it."""
        by_part = {"wall": self.wall, "floor": self.floor, "box": self.packed}
        by_part |= dict.fromkeys(("table", "chair", "panel"), self.wooden)
        return by_part.get(part, self.other)


def _grey(low: float, high: float) -> tuple[Rgb, Rgb]:
    return (low, low, low), (high, high, 0.97 * high)


_PAINT = FinishRange(
    *(MaterialId.PAINT, Pattern.PLAIN, ((0.35, 0.45, 0.55), (0.80, 0.76, 0.66))),
    size_m=(0.3, 0.8),
    contrast=(0.02, 0.05),
)
_PLASTER = FinishRange(
    *(MaterialId.PLASTER, Pattern.PLAIN, _grey(0.5, 0.8)), size_m=(0.02, 0.06), contrast=(0.08, 0.2)
)
_CONCRETE = FinishRange(
    *(MaterialId.CONCRETE, Pattern.CONCRETE, _grey(0.22, 0.45), _grey(0.06, 0.12)),
    size_m=(0.6, 1.2),
    gap_m=(0.003, 0.008),
    contrast=(0.15, 0.35),
)
_BRICK = FinishRange(
    *(
        MaterialId.BRICK,
        Pattern.BRICKS,
        ((0.18, 0.06, 0.035), (0.45, 0.22, 0.12)),
        _grey(0.3, 0.55),
    ),
    size_m=(0.18, 0.28),
    gap_m=(0.008, 0.014),
    contrast=(0.3, 0.6),
)
_PALE_BRICK = FinishRange(
    *(MaterialId.BRICK, Pattern.BRICKS, ((0.45, 0.38, 0.25), (0.65, 0.60, 0.50)), _grey(0.2, 0.4)),
    size_m=(0.2, 0.4),
    gap_m=(0.006, 0.012),
    contrast=(0.2, 0.4),
)
_WOOD = FinishRange(
    *(MaterialId.WOOD, Pattern.PLANKS, ((0.45, 0.27, 0.12), (0.60, 0.42, 0.22))),
    second=((0.12, 0.06, 0.02), (0.28, 0.14, 0.06)),
    size_m=(0.08, 0.16),
    gap_m=(0.001, 0.003),
    contrast=(0.3, 0.6),
)
_PARQUET = FinishRange(
    *(MaterialId.WOOD, Pattern.PLANKS, ((0.25, 0.12, 0.05), (0.50, 0.32, 0.16))),
    second=((0.08, 0.04, 0.015), (0.2, 0.1, 0.04)),
    size_m=(0.06, 0.14),
    gap_m=(0.001, 0.003),
    contrast=(0.4, 0.8),
)
_TILES = FinishRange(
    *(MaterialId.TILE, Pattern.TILES, ((0.30, 0.28, 0.26), (0.70, 0.66, 0.60)), _grey(0.08, 0.3)),
    size_m=(0.15, 0.45),
    gap_m=(0.004, 0.008),
    contrast=(0.15, 0.4),
)
_LINOLEUM = FinishRange(
    *(
        MaterialId.LINOLEUM,
        Pattern.SPECKLES,
        ((0.15, 0.20, 0.26), (0.42, 0.40, 0.34)),
        _grey(0.05, 0.6),
    ),
    size_m=(0.008, 0.03),
    contrast=(0.3, 0.6),
)
_FABRIC = FinishRange(
    *(MaterialId.FABRIC, Pattern.WEAVE, ((0.06, 0.10, 0.25), (0.45, 0.12, 0.10))),
    second=((0.5, 0.45, 0.3), (0.7, 0.7, 0.6)),
    size_m=(0.05, 0.15),
    contrast=(0.3, 0.6),
)
_CARDBOARD = FinishRange(
    *(MaterialId.CARDBOARD, Pattern.CARDBOARD, ((0.33, 0.20, 0.10), (0.48, 0.34, 0.20))),
    second=((0.02, 0.02, 0.05), (0.25, 0.05, 0.03)),
    size_m=(0.2, 0.4),
    contrast=(0.2, 0.4),
)
_METAL_PAINT = FinishRange(
    *(MaterialId.PAINT, Pattern.PLAIN, ((0.50, 0.08, 0.04), (0.05, 0.25, 0.45))),
    size_m=(0.1, 0.4),
    contrast=(0.05, 0.15),
)

FAMILIES: Mapping[Family, FamilyRanges] = {
    "office": FamilyRanges(
        (_PAINT, _PLASTER, _PAINT), (_LINOLEUM,), (_WOOD, _METAL_PAINT), (_CARDBOARD,), (_FABRIC,)
    ),
    "workshop": FamilyRanges(
        (_CONCRETE, _CONCRETE, _PLASTER), (_CONCRETE,), (_METAL_PAINT, _WOOD), (_CARDBOARD,),
        (_METAL_PAINT, _CONCRETE),
    ),
    "bricks": FamilyRanges(
        (_BRICK, _PALE_BRICK), (_TILES,), (_WOOD,), (_CARDBOARD, _WOOD), (_FABRIC, _METAL_PAINT)
    ),
    "home": FamilyRanges(
        (_WOOD, _PAINT, _PLASTER), (_PARQUET,), (_WOOD,), (_CARDBOARD, _FABRIC), (_FABRIC,)
    ),
}  # fmt: skip
"""Colours are linear reflectances in red, green and blue."""


def draw_finish(family: Family, part: str, split: Split, rng: np.random.Generator) -> Finish:
    """A finish for a kind of part; of any family if it is ``mixed``."""
    names = sorted(FAMILIES)
    any_family = names[int(rng.integers(len(names)))]
    ranges = FAMILIES[any_family if family == "mixed" else family].of(part)
    return ranges[int(rng.integers(len(ranges)))].drawn(rng, split)
