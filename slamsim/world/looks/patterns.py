"""The patterns of materials at a point of a surface, and the random fields that they are made of;
compiled.

Each pattern takes coordinates and the size of a pixel in metres, and gives (mix, tone): the colour
is ``tone * ((1 - mix) * main + mix * second)``. ``size`` is that of a brick, plank or tile. Fields
are known at every point, and filtered to the size of a pixel.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from slamsim.core.jit import kernel

Point = tuple[float, float, float]


class Pattern(IntEnum):
    """Number of a pattern in ``pattern_at``."""

    PLAIN = 0
    BRICKS = 1
    PLANKS = 2
    CONCRETE = 3
    TILES = 4
    SPECKLES = 5
    WEAVE = 6
    CARDBOARD = 7


_PORE_M = 0.02
_MEAN_PORES, _MEAN_CHIPS = 0.026, 0.199
"""What pores and chips cover on average: what a pixel that shows none of them is mixed with."""

_BRICKS, _PLANKS, _CONCRETE, _TILES = (int(Pattern(number)) for number in range(1, 5))
_SPECKLES, _WEAVE, _CARDBOARD = (int(Pattern(number)) for number in range(5, 8))


@kernel
def pattern_at(
    kind: int, u: float, v: float, seed: int, size: float, gap: float, contrast: float, px: float
) -> tuple[float, float]:
    """The pattern of a kind: see the module."""
    if kind == _BRICKS:
        return _bricks(u, v, seed, size, gap, contrast, px)
    if kind == _PLANKS:
        return _planks(u, v, seed, size, gap, contrast, px)
    if kind == _CONCRETE:
        return _concrete(u, v, seed, size, gap, contrast, px)
    if kind == _TILES:
        return _tiles(u, v, seed, size, gap, contrast, px)
    if kind == _SPECKLES:
        return _speckles(u, v, seed, size, contrast, px)
    if kind == _WEAVE:
        return _weave(u, v, seed, size, contrast, px)
    if kind == _CARDBOARD:
        return _cardboard(u, v, seed, size, contrast, px)
    return 0.0, 1.0 + contrast * rough_noise(u, v, seed, size, 5, px)


@kernel
def _bricks(
    u: float, v: float, seed: int, size: float, gap: float, contrast: float, px: float
) -> tuple[float, float]:
    """Stretcher bond: bricks three times as long as high, each row shifted by half a brick."""
    height = size / 3.0
    row = math.floor(v / height)
    along = u + 0.5 * size * (row % 2)
    joint = 1.0 - line_share(along, size, gap, px)
    joint = 1.0 - joint * (1.0 - line_share(v, height, gap, px))
    own = visible(height, px) * (random_at(math.floor(along / size), row, seed) - 0.5)
    grain = rough_noise(u, v, seed + 1, 0.1 * size, 4, px)
    return joint, 1.0 + contrast * (1.6 * own + 0.5 * grain)


@kernel
def _planks(
    u: float, v: float, seed: int, size: float, gap: float, contrast: float, px: float
) -> tuple[float, float]:
    """Boards along u, ten times as long as wide, with grain along them and dark joints."""
    row = math.floor(v / size)
    length = 10.0 * size
    along = u + length * random_at(row, 0, seed)
    board = math.floor(along / length)
    own = visible(size, px) * (random_at(row, board, seed + 1) - 0.5)
    across = v + 0.1 * size * rough_noise(0.15 * along, v, seed + 2, size, 2, px)
    start = 7.0 * board + 53.0 * row
    grain = rough_noise(0.08 * along + start, across + start, seed + 5, 0.15 * size, 4, px)
    joint = 1.0 - line_share(v, size, gap, px)
    joint = 1.0 - joint * (1.0 - line_share(along, length, gap, px))
    mix = min(max(0.35 + 0.45 * grain, 0.0), 1.0)
    return mix, (1.0 + contrast * 1.2 * own) * (1.0 - 0.7 * joint)


@kernel
def _concrete(
    u: float, v: float, seed: int, size: float, gap: float, contrast: float, px: float
) -> tuple[float, float]:
    """Cast concrete: clouds, small pores, and the seams of its formwork."""
    clouds = rough_noise(u, v, seed, 0.4 * size, 7, px)
    pore = rough_noise(u, v, seed + 20, _PORE_M, 2, min(px, 0.5 * _PORE_M))
    left = visible(_PORE_M, px)
    holes = left * min(max(3.0 * (pore - 0.75), 0.0), 1.0) + (1.0 - left) * _MEAN_PORES
    seam = 1.0 - line_share(u, 2.0 * size, gap, px)
    seam = 1.0 - seam * (1.0 - line_share(v, size, gap, px))
    return max(holes, 0.6 * seam), 1.0 + 0.8 * contrast * clouds


@kernel
def _tiles(
    u: float, v: float, seed: int, size: float, gap: float, contrast: float, px: float
) -> tuple[float, float]:
    """Square tiles, each of its own shade and with veins, and joints between."""
    joint = 1.0 - line_share(u, size, gap, px)
    joint = 1.0 - joint * (1.0 - line_share(v, size, gap, px))
    column, row = math.floor(u / size), math.floor(v / size)
    own = visible(size, px) * (random_at(column, row, seed) - 0.5)
    veins = rough_noise(u + 31.0 * own, v, seed + 1, 0.4 * size, 6, px)
    return joint, 1.0 + contrast * (own + 0.4 * veins)


@kernel
def _speckles(
    u: float, v: float, seed: int, size: float, contrast: float, px: float
) -> tuple[float, float]:
    """Linoleum or terrazzo: chips of the second colour in the main one."""
    chips = rough_noise(u, v, seed, size, 3, min(px, 0.5 * size))
    left = visible(size, px)
    mix = left * min(max(2.5 * (chips - 0.25), 0.0), 1.0) + (1.0 - left) * _MEAN_CHIPS
    return mix, 1.0 + 0.3 * contrast * rough_noise(u, v, seed + 9, 20.0 * size, 3, px)


@kernel
def _weave(
    u: float, v: float, seed: int, size: float, contrast: float, px: float
) -> tuple[float, float]:
    """Cloth: stripes of the second colour both ways, and threads."""
    stripe = 0.5 * (line_share(u, size, 0.3 * size, px) + line_share(v, size, 0.3 * size, px))
    threads = rough_noise(u, 4.0 * v, seed, 0.012, 2, px) + rough_noise(
        4.0 * u, v, seed + 5, 0.012, 2, px
    )
    folds = rough_noise(u, v, seed + 9, 0.3, 3, px)
    return stripe, 1.0 + contrast * (0.3 * threads + 0.3 * folds)


@kernel
def _cardboard(
    u: float, v: float, seed: int, size: float, contrast: float, px: float
) -> tuple[float, float]:
    """Packing board: flutes, a band of tape or print in places, stains."""
    flutes = visible(0.003, px) * (line_share(u, 0.008, 0.004, px) - 0.5)
    column, row = math.floor(u / size), math.floor(v / size)
    left, low = 0.5 * random_at(column, row, seed), 0.6 * random_at(column, row, seed + 1)
    wide, high = 0.45 * random_at(row, column, seed + 2), 0.3 * random_at(row, column, seed + 3)
    across = span_share(u - (column + left) * size, wide * size, px)
    print_ = across * span_share(v - (row + low) * size, high * size, px)
    marks = line_share(v, 0.03, 0.02, px)
    stains = rough_noise(u, v, seed + 4, 0.2, 6, px)
    return 0.8 * print_ * marks, 1.0 + contrast * (0.1 * flutes + 0.4 * stains)


_X, _Y, _MIX = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(27)
_MULTIPLY, _LAST = np.uint64(0xFF51AFD7ED558CCD), np.uint64(40)
"""Odd numbers of SplitMix64, xxHash and MurmurHash3's finaliser, which mix all bits."""

_UNIT = 2.0**-24
"""The upper 24 bits as a number below 1, exact in single precision."""


@kernel
def random_at(column: int, row: int, seed: int) -> float:
    """Evenly distributed from 0 up to 1, another number in each cell of an endless grid."""
    bits = (np.uint64(column) * _X) ^ (np.uint64(row) * _Y) ^ (np.uint64(seed) * _MULTIPLY)
    bits = (bits ^ (bits >> _MIX)) * _MULTIPLY
    bits = (bits ^ (bits >> _MIX)) * _X
    return float(bits >> _LAST) * _UNIT


@kernel
def smooth_noise(u: float, v: float, seed: int) -> float:
    """From -1 to 1, smooth, of wavelength 2; zero on average (value noise, cubic fade)."""
    column, row = math.floor(u), math.floor(v)
    s, t = u - column, v - row
    s, t = s * s * (3.0 - 2.0 * s), t * t * (3.0 - 2.0 * t)
    low = (1.0 - s) * random_at(column, row, seed) + s * random_at(column + 1, row, seed)
    high = (1.0 - s) * random_at(column, row + 1, seed) + s * random_at(column + 1, row + 1, seed)
    return 2.0 * ((1.0 - t) * low + t * high) - 1.0


@kernel
def visible(size: float, footprint: float) -> float:
    """How much of a detail of a size is left in a pixel: 0 from one pixel on down, 1 from two up.

    A pattern of wavelength two pixels is the finest that pixels show (Nyquist).
    """
    return min(max(size / footprint - 1.0, 0.0), 1.0)


@kernel
def rough_noise(
    u: float, v: float, seed: int, size: float, octaves: int, footprint: float
) -> float:
    """Octaves of smooth noise from a size of spots down, each half as large and as strong as the
    one before; those that a pixel does not show fade out. Within -2 to 2."""
    total, strength = 0.0, 1.0
    for octave in range(octaves):
        left = visible(size, footprint)
        if left == 0.0:
            break
        total += strength * left * smooth_noise(u / size, v / size, seed + octave)
        size, strength = 0.5 * size, 0.5 * strength
    return total


@kernel
def line_share(x: float, period: float, line: float, footprint: float) -> float:
    """Share of a pixel about x that lines cover, which are so wide and begin at each multiple of
    the period: the exact integral over the pixel."""
    width = max(footprint, 1e-6)
    return (
        _covered(x + 0.5 * width, period, line) - _covered(x - 0.5 * width, period, line)
    ) / width


@kernel
def span_share(x: float, length: float, footprint: float) -> float:
    """Share of a pixel about x that lies from 0 to a length."""
    width = max(footprint, 1e-6)
    return max(min(x + 0.5 * width, length) - max(x - 0.5 * width, 0.0), 0.0) / width


@kernel
def _covered(x: float, period: float, line: float) -> float:
    """Length of lines from 0 to x."""
    whole = math.floor(x / period)
    return whole * line + min(x - whole * period, line)
