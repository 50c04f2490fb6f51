"""Crispness of a map: the Renyi entropy of its surfaces.

Each piece of surface is a normal distribution, thin across the surface and long along it; the map
is their mixture. Its quadratic entropy after Renyi, the negative logarithm of the integral of the
squared density, has a closed form in pairs of pieces (Sheehan, Harrison & Newman, Self-calibration
for a 3D laser, IJRR 2012, there with round kernels for points). It is least where surfaces
that are seen again lie on themselves.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray

ACROSS_M, ALONG_M = 0.01, 0.07
"""Standard deviations of a piece; noise of its ranges is added across."""

REACH_M = 0.3
"""Pieces farther apart than this share nothing."""

FAR = 18.0
"""Squared Mahalanobis distance from which on the same holds."""


@kernel
def map_entropy(pieces: FloatArray, scan: IntArray) -> float:
    """Of placed pieces (k, 5), as those of a ``WindowView``, and the scan of each (k,).

    Pairs within one scan are left out, for they hardly depend on how scans are placed. Infinite
    if no two pieces of different scans come near each other.
    """
    count = len(pieces)
    column = np.floor(pieces[:, 0] / REACH_M).astype(np.int64)
    row = np.floor(pieces[:, 1] / REACH_M).astype(np.int64)
    low, rows = row.min(), row.max() - row.min() + 3
    cell = (column - column.min()) * rows + (row - low + 1)
    order = np.argsort(cell)
    ordered = cell[order]
    total = 0.0
    for a in range(count):
        i = order[a]
        for beside in range(2):
            # Of the cells of its own column only those after it, of the next column all three.
            first = cell[i] - 1 + rows if beside else cell[i]
            last = cell[i] + 1 + beside * rows
            b = np.searchsorted(ordered, first) if beside else a + 1
            while b < count and ordered[b] <= last:
                j = order[b]
                b += 1
                if scan[i] != scan[j]:
                    total += _shared(pieces[i], pieces[j])
    pairs = 0.5 * count * (count - 1)
    return float(-np.log(total / pairs)) if total > 0.0 else np.inf


@kernel
def _shared(one: FloatArray, other: FloatArray) -> float:
    """The integral of the product of two pieces' densities, 1/m^2."""
    dx, dy = one[0] - other[0], one[1] - other[1]
    xx = xy = yy = 0.0
    for piece in (one, other):
        nx, ny = piece[2], piece[3]
        across = ACROSS_M * ACROSS_M + piece[4]
        along = ALONG_M * ALONG_M
        xx += across * nx * nx + along * ny * ny
        xy += (across - along) * nx * ny
        yy += across * ny * ny + along * nx * nx
    determinant = xx * yy - xy * xy
    square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
    if square > FAR:
        return 0.0
    return float(np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(determinant)))


def placed(pieces: FloatArray, T_map_laser: FloatArray) -> FloatArray:
    """(k, 5) pieces as seen from poses (k, 3), in the frame of these."""
    cos, sin = np.cos(T_map_laser[:, 2]), np.sin(T_map_laser[:, 2])
    x, y, nx, ny, variance = pieces.T
    return np.column_stack(
        [
            T_map_laser[:, 0] + cos * x - sin * y,
            T_map_laser[:, 1] + sin * x + cos * y,
            cos * nx - sin * ny,
            sin * nx + cos * ny,
            variance,
        ]
    )
