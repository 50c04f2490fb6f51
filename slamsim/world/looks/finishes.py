"""Materials of surfaces, as cameras and range finders need to know them, and finishes: a material,
its pattern, and the pattern's numbers; by family and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamsim.config.layout import Split
from slamsim.core.types import FloatArray
from slamsim.world.looks.patterns import Pattern


@dataclass(frozen=True, slots=True)
class Material:
    """ir_reflectance: share of light of 850 nm that comes back, 0 to 1, whatever the colour.

    roughness: 1 matt, 0 polished. is_glass: rays mostly pass. is_mirror: rays are thrown back.
    """

    name: str
    ir_reflectance: float
    roughness: float
    is_glass: bool = False
    is_mirror: bool = False


class MaterialId(IntEnum):
    """Number of a material, its place in ``MATERIALS``."""

    NOTHING = 0
    PAINT = 1
    PLASTER = 2
    BRICK = 3
    CONCRETE = 4
    WOOD = 5
    TILE = 6
    LINOLEUM = 7
    FABRIC = 8
    CARDBOARD = 9
    PAPER = 10
    TAG = 11
    GLASS = 12
    MIRROR = 13


MATERIALS: tuple[Material, ...] = (
    Material("nothing", 0.0, 1.0),
    Material("paint", 0.75, 0.8),
    Material("plaster", 0.80, 1.0),
    Material("brick", 0.40, 1.0),
    Material("concrete", 0.40, 0.9),
    Material("wood", 0.50, 0.6),
    Material("tile", 0.60, 0.2),
    Material("linoleum", 0.45, 0.4),
    Material("fabric", 0.55, 1.0),
    Material("cardboard", 0.45, 0.9),
    Material("paper", 0.80, 0.7),
    Material("tag", 0.60, 0.8),
    Material("glass", 0.08, 0.0, is_glass=True),
    Material("mirror", 0.90, 0.0, is_mirror=True),
)
"""By ``MaterialId``. Reflectances are typical ones: paper, wood and cardboard after the table of
remission in SICK's technical description of the LMS200 (paper 0.8, raw wood 0.4, grey cardboard
0.2 to 0.5); brick and concrete after the ECOSTRESS spectral library at 0.85 micrometres; glass 2
times 4 % of Fresnel's reflection; roughness is our own order of them."""


Rgb = tuple[float, float, float]
Span = tuple[float, float]

_BINS, _BELOW_ONE = 8, 1.0 - 1e-9
_SEEDS_APART = 64
"""A pattern takes some seeds behind its own, one for each field of noise."""


@dataclass(frozen=True, slots=True)
class Finish:
    """How one surface is finished: see ``patterns`` for size, gap and contrast; linear colours."""

    material: MaterialId
    pattern: Pattern
    main: Rgb
    second: Rgb
    size_m: float
    gap_m: float
    contrast: float
    noise_seed: int


@dataclass(frozen=True, slots=True)
class FinishRange:
    """Finishes from which one is drawn: each colour lies between two, each number in a span."""

    material: MaterialId
    pattern: Pattern
    main: tuple[Rgb, Rgb]
    second: tuple[Rgb, Rgb] = ((0.2, 0.2, 0.2), (0.3, 0.3, 0.3))
    size_m: Span = (0.2, 0.4)
    gap_m: Span = (0.0, 0.0)
    contrast: Span = (0.2, 0.4)

    def drawn(self, rng: np.random.Generator, split: Split) -> Finish:
        """One of them; none that the other split may draw."""
        shares = [split_share(share, split) for share in rng.random(5).tolist()]
        main, second = (
            _between(*ends, s) for ends, s in zip(self._colours(), shares, strict=False)
        )
        size, gap, contrast = (
            low + share * (high - low)
            for (low, high), share in zip(
                (self.size_m, self.gap_m, self.contrast), shares[2:], strict=True
            )
        )
        number = 2 * int(rng.integers(2**40)) + (split == "test")
        return Finish(
            self.material, self.pattern, main, second, size, gap, contrast, number * _SEEDS_APART
        )

    def _colours(self) -> tuple[tuple[Rgb, Rgb], tuple[Rgb, Rgb]]:
        return self.main, self.second


def split_share(share: float, split: Split) -> float:
    """A share of 0 to 1, moved into the part of that range which belongs to the split.

    The range is cut into eight: train has every other piece, and test those between, so that both
    cover it and have no number in common.
    """
    pieces = share * (_BINS // 2)
    piece = min(int(pieces), _BINS // 2 - 1)
    within = min(pieces - piece, _BELOW_ONE)
    return (2 * piece + (split == "test") + within) / _BINS


def _between(low: Rgb, high: Rgb, share: float) -> Rgb:
    r, g, b = (a + share * (z - a) for a, z in zip(low, high, strict=True))
    return r, g, b


class FinishTable(NamedTuple):
    """Finishes as kernels read them, (s,) each: numbers is (s, 9): size, gap, contrast, main and
    second colour."""

    patterns: NDArray[np.int64]
    seeds: NDArray[np.int64]
    numbers: FloatArray


def finish_table(finishes: Sequence[Finish]) -> FinishTable:
    """The table of finishes, in their order."""
    numbers = [(f.size_m, f.gap_m, f.contrast, *f.main, *f.second) for f in finishes]
    return FinishTable(
        np.array([f.pattern for f in finishes], dtype=np.int64),
        np.array([f.noise_seed for f in finishes], dtype=np.int64),
        np.array(numbers, dtype=np.float64).reshape(-1, 9),
    )
