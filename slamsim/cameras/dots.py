"""The dot pattern that an active stereo camera projects in infrared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.randomness import random_bits
from slamsim.core.types import Float32Array, FloatArray

DOTS = 5000
"""In the view of the D435's projector, about (its data sheet)."""
_FIELD_RAD = (np.radians(90.0), np.radians(63.0))
"""Across and up of that projector (data sheet)."""
CELL = float(np.sqrt(4.0 * np.tan(_FIELD_RAD[0] / 2) * np.tan(_FIELD_RAD[1] / 2) / DOTS))
"""Side of the square of the image plane at distance one in which one dot lies: 0.022."""
_DOT_SIGMA = 0.0015
"""Of a dot's Gaussian profile, radians: a dot is some 3.5 mm wide at 1 m."""


@dataclass(frozen=True, slots=True)
class DotPattern:
    """A pattern that is the same for the same seed: one dot at a random place of each square cell
    of the plane at distance one. sigma: of a dot's profile in that plane."""

    seed: int
    cell: float = CELL
    sigma: float = _DOT_SIGMA

    def intensity(self, directions: FloatArray, footprint: FloatArray) -> Float32Array:
        """(n,) from 0 between dots to 1 in the middle of one.

        directions: (n, 3) from the projector in its frame, z forward, of any length; behind it and
        outside of its field there is nothing. footprint: (n,) side of the pixel as the projector
        sees it, in radians: dots are as much wider and fainter, so that the light of a dot
        does not depend on how it is sampled.
        """
        ahead = directions[:, 2] > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.where(ahead[:, None], directions[:, :2] / directions[:, 2:], np.inf)
        reach = np.tan(0.5 * np.array(_FIELD_RAD))
        lit = (np.abs(plane) <= reach).all(axis=1)
        found = np.zeros(len(directions), dtype=np.float32)
        key = np.uint64(random_bits(self.seed, "infrared", "dots"))
        spread = np.broadcast_to(np.asarray(footprint, dtype=np.float64), len(directions))
        found[lit] = _intensities(plane[lit], spread[lit], self.cell, self.sigma, key)
        return found

    @property
    def mean(self) -> float:
        """Of the intensity over the field: what is left of it far away, where dots are blurred."""
        return 2.0 * float(np.pi) * self.sigma**2 / self.cell**2


@kernel
def _mixed(value: np.uint64) -> np.uint64:
    """The finaliser of SplitMix64 (S. Vigna): neighbouring numbers become unlike."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@kernel
def _intensities(
    plane: FloatArray, footprint: FloatArray, cell: float, sigma: float, key: np.uint64
) -> Float32Array:
    """(n,) at (n, 2) places of the plane: the dots of the nine cells around each."""
    found = np.zeros(len(plane), dtype=np.float32)
    share = 2.0**-32
    for k in range(len(plane)):
        x, y = plane[k, 0] / cell, plane[k, 1] / cell
        # A square pixel of side a blurs like a Gaussian of variance a^2 / 12.
        variance = (sigma * sigma + footprint[k] * footprint[k] / 12.0) / (cell * cell)
        peak = sigma * sigma / (cell * cell) / variance
        column, row = int(np.floor(x)), int(np.floor(y))
        reach = 1 if variance < 0.04 else 2
        total = 0.0
        for i in range(column - reach, column + reach + 1):
            for j in range(row - reach, row + reach + 1):
                bits = _mixed(_mixed(key ^ np.uint64(i + 2**31)) ^ np.uint64(j + 2**31))
                dx = x - (i + float(bits >> np.uint64(32)) * share)
                dy = y - (j + float(bits & np.uint64(0xFFFFFFFF)) * share)
                total += peak * np.exp(-0.5 * (dx * dx + dy * dy) / variance)
        found[k] = min(total, 1.0)
    return found
