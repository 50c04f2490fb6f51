"""Sparse symmetric systems of 3 x 3 blocks: factorised, solved, and inverted where it is cheap.

Only the entries of the inverse that lie on the pattern of the factor are computed (Takahashi,
Fagan & Chen 1973; Erisman & Tinney 1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from slamsim.jit import kernel
from slamsim.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BlockPattern:
    """Where the factor of a system of ``count`` block rows has entries.

    starts: (count + 1,) and rows: (entries,) of its columns, rows sorted, the diagonal first.
    place: (count + 1,) column of each unknown; the unknown ``count``, which is held fixed and no
    part of the system, maps to itself.
    """

    starts: IntArray
    rows: IntArray
    place: IntArray

    @property
    def count(self) -> int:
        return len(self.starts) - 1

    def zeros(self) -> FloatArray:
        """(entries, 3, 3) an empty lower half on this pattern."""
        return np.zeros((len(self.rows), 3, 3))


def block_pattern(pairs: IntArray, count: int) -> BlockPattern:
    """The pattern of the factor when (p, 2) pairs of unknowns meet; pairs may repeat.

    It is that of the factor of an M-matrix on the same graph, all of whose entries have one sign,
    so that none cancels.
    """
    inner = pairs[(pairs < count).all(axis=1)]
    degree = np.bincount(pairs.ravel(), minlength=count + 1)[:count] + 1.0
    rows = np.concatenate([inner[:, 0], inner[:, 1], np.arange(count)])
    columns = np.concatenate([inner[:, 1], inner[:, 0], np.arange(count)])
    values = np.concatenate([np.full(2 * len(inner), -1.0), degree])
    graph = coo_matrix((values, (rows, columns)), shape=(count, count)).tocsc()
    factor = splu(
        graph,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    lower = csc_matrix(factor.L)
    lower.sort_indices()
    place = np.append(np.asarray(factor.perm_c, dtype=np.int64), count)
    return BlockPattern(lower.indptr.astype(np.int64), lower.indices.astype(np.int64), place)


class BlockFactor:
    """L D L^T of a system given by its lower half, (entries, 3, 3), on a pattern.

    Raises numpy's LinAlgError for a system that is not positive definite.
    """

    def __init__(self, pattern: BlockPattern, values: FloatArray) -> None:
        self._pattern = pattern
        self._minus_l = np.zeros(values.shape)
        self._pivot = np.zeros((pattern.count, 3, 3))
        if not _factorise(pattern.starts, pattern.rows, values.copy(), self._minus_l, self._pivot):
            raise np.linalg.LinAlgError("the information matrix is not positive definite")

    def solve(self, right: FloatArray) -> FloatArray:
        """(count, 3) solution for a right-hand side (count, 3), both in the order of unknowns."""
        place = self._pattern.place[:-1]
        solution = np.empty_like(right)
        solution[place] = right
        _substitute(self._pattern.starts, self._pattern.rows, self._minus_l, self._pivot, solution)
        return np.asarray(solution[place])

    def inverse_diagonal(self) -> FloatArray:
        """(count, 3, 3) diagonal blocks of the inverse, in the order of unknowns."""
        values = np.empty_like(self._minus_l)
        starts = self._pattern.starts
        _invert(starts, self._pattern.rows, self._minus_l, self._pivot, values)
        return np.asarray(values[starts[self._pattern.place[:-1]]])


@kernel
def add_block(
    pattern: tuple[IntArray, IntArray, IntArray],
    values: FloatArray,
    a: int,
    b: int,
    block: FloatArray,
) -> None:
    """Add what unknown ``a`` (row) and ``b`` (column) share to the lower half of a system.

    pattern: starts, rows, place. Of a pair a != b, one of the two blocks, not both.
    """
    starts, rows, place = pattern
    row, column = place[a], place[b]
    if row >= column:
        at = _find(starts, rows, row, column)
        for i in range(3):
            for j in range(3):
                values[at, i, j] += block[i, j]
    else:
        at = _find(starts, rows, column, row)
        for i in range(3):
            for j in range(3):
                values[at, i, j] += block[j, i]


@kernel
def _find(starts: IntArray, rows: IntArray, row: int, column: int) -> int:
    """Where an entry is stored, by bisection."""
    low, high = starts[column], starts[column + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return int(low)


@kernel
def _inverse_3x3(m: FloatArray, out: FloatArray) -> bool:
    """Inverse of a symmetric positive definite matrix; False if it is not that."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    minor = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    if not (m[0, 0] > 0.0 and minor > 0.0 and determinant > 0.0):
        return False
    share = 1.0 / determinant
    out[0, 0], out[0, 1], out[0, 2] = share * c00, share * c01, share * c02
    out[1, 1] = share * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0])
    out[1, 2] = share * (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2])
    out[2, 2] = share * minor
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return True


@kernel
def _copy(out: FloatArray, a: FloatArray, factor: float) -> None:
    """out = factor a."""
    for i in range(3):
        for j in range(3):
            out[i, j] = factor * a[i, j]


@kernel
def _add(out: FloatArray, a: FloatArray, b: FloatArray, transpose_a: bool) -> None:
    """out += a b, or a^T b."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += (a[k, i] if transpose_a else a[i, k]) * b[k, j]


@kernel
def _add_transposed(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """out += a b^T."""
    for i in range(3):
        for j in range(3):
            out[i, j] += a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@kernel
def _factorise(
    starts: IntArray,
    rows: IntArray,
    values: FloatArray,
    minus_l: FloatArray,
    pivot: FloatArray,
) -> bool:
    """Fill minus_l and the inverse pivots of L D L^T, spoiling values; False if not definite."""
    negative = np.empty((3, 3))
    for j in range(starts.size - 1):
        begin, end = starts[j] + 1, starts[j + 1]
        if not _inverse_3x3(values[starts[j]], pivot[j]):
            return False
        _copy(negative, pivot[j], -1.0)
        for p in range(begin, end):
            _add(minus_l[p], values[p], negative, False)
        for p in range(begin, end):
            r = starts[rows[p]]
            for q in range(p, end):
                while rows[r] < rows[q]:
                    r += 1
                _add_transposed(values[r], minus_l[q], values[p])
    return True


@kernel
def _substitute(
    starts: IntArray, rows: IntArray, minus_l: FloatArray, pivot: FloatArray, x: FloatArray
) -> None:
    """Solve L D L^T x = x in place."""
    count = starts.size - 1
    for j in range(count):
        for p in range(starts[j] + 1, starts[j + 1]):
            for i in range(3):
                for k in range(3):
                    x[rows[p], i] += minus_l[p, i, k] * x[j, k]
    scaled = np.empty(3)
    for j in range(count - 1, -1, -1):
        for i in range(3):
            scaled[i] = 0.0
            for k in range(3):
                scaled[i] += pivot[j, i, k] * x[j, k]
        for p in range(starts[j] + 1, starts[j + 1]):
            for i in range(3):
                for k in range(3):
                    scaled[i] += minus_l[p, k, i] * x[rows[p], k]
        for i in range(3):
            x[j, i] = scaled[i]


@kernel
def _invert(
    starts: IntArray, rows: IntArray, minus_l: FloatArray, pivot: FloatArray, values: FloatArray
) -> None:
    """Fill values with the inverse, on the pattern of its factor."""
    for j in range(starts.size - 2, -1, -1):
        begin, end = starts[j] + 1, starts[j + 1]
        for p in range(begin, end):
            _copy(values[p], pivot[j], 0.0)
        for p in range(begin, end):
            r = starts[rows[p]]
            for q in range(p, end):
                while rows[r] < rows[q]:
                    r += 1
                _add(values[q], values[r], minus_l[p], False)
                if q != p:
                    _add(values[p], values[r], minus_l[q], True)
        _copy(values[starts[j]], pivot[j], 1.0)
        for p in range(begin, end):
            _add(values[starts[j]], values[p], minus_l[p], True)
