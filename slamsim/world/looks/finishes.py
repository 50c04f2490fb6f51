"""Finishes of surfaces: a material, its pattern, and the pattern's numbers; by family and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamsim.config.looks import Split
from slamsim.core.types import FloatArray
from slamsim.world.looks.materials import MaterialId
from slamsim.world.looks.patterns import Pattern

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
