"""Random fields on a plane, known at every point, and filtered to the size of a pixel; compiled."""

from __future__ import annotations

import math

import numpy as np

from slamsim.core.jit import kernel

_X, _Y, _MIX = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(27)
_MULTIPLY, _LAST = np.uint64(0xFF51AFD7ED558CCD), np.uint64(40)
"""Odd numbers of SplitMix64, xxHash and MurmurHash3's finaliser, which mix all bits."""

_UNIT = 2.0**-24


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
