"""Algebra of three unknowns, and a median, in loops that compile in a moment.

numba's own ``linalg`` and ``median`` take seconds each to compile, longer than everything else
here together; these take tenths, and are tested against NumPy.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray

MAX_SWEEPS = 30


@kernel
def eigen(symmetric: FloatArray, values: FloatArray, axes: FloatArray) -> None:
    """Ascending eigenvalues (3,) and eigenvectors (3, 3: columns) by Jacobi's rotations (1846)."""
    a = symmetric.copy()
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(MAX_SWEEPS):
        off = a[0, 1] * a[0, 1] + a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2]
        size = a[0, 0] * a[0, 0] + a[1, 1] * a[1, 1] + a[2, 2] * a[2, 2]
        if off <= 1e-30 * size:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                _rotate(a, axes, p, q)
    for i in range(3):
        values[i] = a[i, i]
    for i in range(2):
        for j in range(2 - i):
            if values[j] > values[j + 1]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    axes[k, j], axes[k, j + 1] = axes[k, j + 1], axes[k, j]


@kernel
def _rotate(a: FloatArray, axes: FloatArray, p: int, q: int) -> None:
    """Turn the plane of axes p and q until their common element vanishes."""
    if a[p, q] == 0.0:
        return
    slope = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    tan = 1.0 / (np.abs(slope) + np.sqrt(1.0 + slope * slope))
    if slope < 0.0:
        tan = -tan
    cos = 1.0 / np.sqrt(1.0 + tan * tan)
    sin = tan * cos
    for k in range(3):
        left, right = a[k, p], a[k, q]
        a[k, p], a[k, q] = cos * left - sin * right, sin * left + cos * right
    for k in range(3):
        left, right = a[p, k], a[q, k]
        a[p, k], a[q, k] = cos * left - sin * right, sin * left + cos * right
    for k in range(3):
        left, right = axes[k, p], axes[k, q]
        axes[k, p], axes[k, q] = cos * left - sin * right, sin * left + cos * right


@kernel
def solve(matrix: FloatArray, right: FloatArray, out: FloatArray) -> None:
    """Three equations by Cholesky's decomposition; nan where the matrix is not positive.

    matrix: (3, 3). right, out: (3,).
    """
    m = matrix
    l00 = np.sqrt(m[0, 0])
    l10, l20 = m[1, 0] / l00, m[2, 0] / l00
    l11 = np.sqrt(m[1, 1] - l10 * l10)
    l21 = (m[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(m[2, 2] - l20 * l20 - l21 * l21)
    y0 = right[0] / l00
    y1 = (right[1] - l10 * y0) / l11
    y2 = (right[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00


@kernel
def invert(matrix: FloatArray, out: FloatArray) -> None:
    """out <- the inverse of a symmetric matrix, by its cofactors. Both (3, 3)."""
    m = matrix
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    share = 1.0 / (m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02)
    out[0, 0], out[0, 1], out[0, 2] = share * c00, share * c01, share * c02
    out[1, 0] = out[0, 1]
    out[1, 1] = share * (m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2])
    out[1, 2] = share * (m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2])
    out[2, 0], out[2, 1] = out[0, 2], out[1, 2]
    out[2, 2] = share * (m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1])


@kernel
def product(left: FloatArray, right: FloatArray, out: FloatArray) -> None:
    """out <- left @ right, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = (
                left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]
            )


@kernel
def sandwich(outer: FloatArray, inner: FloatArray) -> None:
    """inner <- outer @ inner @ outer, for a symmetric outer. Both (3, 3)."""
    half = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                half[i, j] += outer[i, k] * inner[k, j]
    for i in range(3):
        for j in range(3):
            inner[i, j] = 0.0
            for k in range(3):
                inner[i, j] += half[i, k] * outer[k, j]


@kernel
def times(matrix: FloatArray, vector: FloatArray, out: FloatArray) -> None:
    """out <- matrix @ vector: (3, 3) and (3,)."""
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@kernel
def put(row: FloatArray, to: FloatArray) -> None:
    """Copy (n,) numbers. Compiled, ``rows[k] = row`` brings an error message with it that names
    both shapes, which takes two seconds."""
    for i in range(row.size):
        to[i] = row[i]


@kernel
def median(values: FloatArray, count: int) -> float:
    """Of the first ``count``, which are reordered (Hoare's selection); the lower of two middles.

    values: (n,).
    """
    low, high, middle = 0, count - 1, (count - 1) // 2
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return float(values[middle])
