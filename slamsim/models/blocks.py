"""Sparse symmetric systems of 3 x 3 blocks: factorised, solved, and inverted where it is cheap.

The factor is stored in dense panels, so that nearly all work is products of matrices. Of the
inverse only the entries on the pattern of the factor are computed (Takahashi, Fagan & Chen 1973;
Erisman & Tinney 1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.models.supernodes import Panels


@dataclass(frozen=True, slots=True, eq=False)
class BlockFactor:
    """L L^T of a system: in place of a panel's triangle its inverse, and what lies below it.

    keyframes: (count,) which key frame each unknown is. ``factorise`` makes it.
    """

    panels: Panels
    values: FloatArray
    keyframes: IntArray

    def solve(self, right: FloatArray) -> FloatArray:
        """(count, 3) solution for a right-hand side (count, 3), both in the order of unknowns."""
        place = self.panels.place[:-1]
        solution = np.empty(right.size)
        solution.reshape(-1, 3)[place] = right
        _substitute(self.panels, self.values, solution)
        return np.asarray(solution.reshape(-1, 3)[place])

    def inverse_diagonal(self) -> FloatArray:
        """(count, 3, 3) diagonal blocks of the inverse, in the order of unknowns.

        Raises NoSolution, naming the key frame, for a variance that is not positive.
        """
        diagonal = _inverse_diagonal(self.panels, self.values)[self.panels.place[:-1]]
        require_variances(diagonal, self.keyframes)
        return np.asarray(diagonal)


def require_variances(covariances: FloatArray, keyframes: IntArray) -> None:
    """Raise NoSolution, naming the key frame, unless all variances of (n, 3, 3) are positive."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    positive = (variances > 0.0).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    if not positive.all():
        bad = int(np.argmin(positive))
        at, found = int(keyframes[bad]), variances[bad].tolist()
        raise NoSolution(f"the variances {found} of key frame {at} are not positive", at)


def factorise(panels: Panels, system: FloatArray, keyframes: IntArray) -> BlockFactor:
    """The factor of a system; keyframes: (count,) which key frame each unknown is.

    Raises NoSolution, naming the key frame, if it is not finite or not positive definite.
    """
    values = system.copy()
    finite = np.isfinite(values)
    if not finite.all():
        panel = int(np.searchsorted(panels.offsets, np.argmin(finite), "right")) - 1
        column = int(panels.first[panel])
    else:
        column = _factorise(panels, values)
    if column >= 0:
        at = int(keyframes[np.flatnonzero(panels.place[:-1] == column)[0]])
        fault = "positive definite" if finite.all() else "finite"
        raise NoSolution(f"the information matrix is not {fault} at key frame {at}", at)
    return BlockFactor(panels, values, keyframes)


@kernel
def times(a: FloatArray, b: FloatArray) -> FloatArray:
    """a b. BLAS is no faster for these sizes, and on a busy machine its threads wait for cores."""
    out = np.zeros((a.shape[0], b.shape[1]))
    whole = a.shape[1] // 4 * 4
    for i in range(a.shape[0]):
        row = out[i]
        for k in range(0, whole, 4):
            p, q, r, s = a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3]
            if p != 0.0 or q != 0.0 or r != 0.0 or s != 0.0:
                for j in range(row.size):
                    row[j] += p * b[k, j] + q * b[k + 1, j] + r * b[k + 2, j] + s * b[k + 3, j]
        for k in range(whole, a.shape[1]):
            for j in range(row.size):
                row[j] += a[i, k] * b[k, j]
    return out


@kernel
def _factorise(panels: Panels, values: FloatArray) -> int:
    """In place; the column at which the system is not definite, -1 without one."""
    for panel in range(panels.first.size - 1):
        width = 3 * (panels.first[panel + 1] - panels.first[panel])
        whole = values[panels.offsets[panel] : panels.offsets[panel + 1]].reshape((-1, width))
        failed = _invert_triangle(whole[:width])
        if failed >= 0:
            return int(panels.first[panel] + failed // 3)
        if whole.shape[0] > width:
            reach = times(whole[width:], whole[:width].T.copy())
            whole[width:] = reach
            _pass_on(panels, values, panel, reach)
    return -1


@kernel
def _invert_triangle(square: FloatArray) -> int:
    """Replace a symmetric matrix, given by its lower half, by the inverse of its Cholesky factor.

    The row at which it is not positive definite, -1 if it is.
    """
    size = square.shape[0]
    for i in range(size):
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= square[i, k] * square[j, k]
            if j < i:
                square[i, j] = total / square[j, j]
            elif 0.0 < total < np.inf:
                square[i, i] = np.sqrt(total)
            else:
                return i
    for j in range(size):
        for i in range(j):
            square[i, j] = 0.0
        square[j, j] = 1.0 / square[j, j]
        for i in range(j + 1, size):
            total = 0.0
            for k in range(j, i):
                total -= square[i, k] * square[k, j]
            square[i, j] = total / square[i, i]
    return -1


@kernel
def _below_in(panels: Panels, panel: int, first: int, other: int) -> tuple[int, IntArray]:
    """Of the rows below a panel, from the ``first`` on: how many are columns of ``other``, and
    which row of that panel each of them is. Raises IndexError if one is no row of it."""
    begin, end = panels.first[other], panels.first[other + 1]
    rows = panels.below[panels.starts[panel] + first : panels.starts[panel + 1]]
    there = panels.below[panels.starts[other] : panels.starts[other + 1]]
    at = np.empty(rows.size, np.int64)
    columns = k = 0
    for r in range(rows.size):
        if rows[r] < end:
            at[r] = rows[r] - begin
            columns += 1
        else:
            while k < there.size and there[k] < rows[r]:
                k += 1
            if k == there.size or there[k] != rows[r]:
                raise IndexError("the factor has no row for an entry that fills in")
            at[r] = end - begin + k
    return columns, at


@kernel
def _pass_on(panels: Panels, values: FloatArray, panel: int, reach: FloatArray) -> None:
    """Subtract what a finished panel's rows have in common from the panels that they belong to."""
    count = panels.starts[panel + 1] - panels.starts[panel]
    first = 0
    while first < count:
        other = panels.owner[panels.below[panels.starts[panel] + first]]
        width = 3 * (panels.first[other + 1] - panels.first[other])
        whole = values[panels.offsets[other] : panels.offsets[other + 1]].reshape((-1, width))
        columns, at = _below_in(panels, panel, first, other)
        product = times(reach[3 * first :], reach[3 * first : 3 * (first + columns)].T.copy())
        for r in range(at.size):
            for i in range(3):
                row, given = whole[3 * at[r] + i], product[3 * r + i]
                for c in range(min(columns, r + 1)):
                    to = 3 * at[c]
                    row[to] -= given[3 * c]
                    row[to + 1] -= given[3 * c + 1]
                    row[to + 2] -= given[3 * c + 2]
        first += columns


@kernel
def _substitute(panels: Panels, values: FloatArray, x: FloatArray) -> None:
    """Solve L L^T x = x in place; x: (3 count,)."""
    last = panels.first.size - 1
    for step in range(2 * last):
        back = step >= last
        panel = 2 * last - 1 - step if back else step
        begin, end = 3 * panels.first[panel], 3 * panels.first[panel + 1]
        width = end - begin
        whole = values[panels.offsets[panel] : panels.offsets[panel + 1]].reshape((-1, width))
        rows = panels.below[panels.starts[panel] : panels.starts[panel + 1]]
        if back:
            _subtract_below(whole[width:], rows, x, (begin, end), back)
        solved = np.zeros(width)
        for i in range(width):
            for k in range(i + 1):
                if back:
                    solved[k] += whole[i, k] * x[begin + i]
                else:
                    solved[i] += whole[i, k] * x[begin + k]
        x[begin:end] = solved
        if not back:
            _subtract_below(whole[width:], rows, x, (begin, end), back)


@kernel
def _subtract_below(
    reach: FloatArray, rows: IntArray, x: FloatArray, span: tuple[int, int], back: bool
) -> None:
    """Take from the rows below what a panel's own say, or, going back, the other way round."""
    begin, end = span
    for r in range(rows.size):
        for i in range(3):
            below = 3 * rows[r] + i
            for k in range(end - begin):
                if back:
                    x[begin + k] -= reach[3 * r + i, k] * x[below]
                else:
                    x[below] -= reach[3 * r + i, k] * x[begin + k]


@kernel
def _inverse_diagonal(panels: Panels, values: FloatArray) -> FloatArray:
    """(count, 3, 3) diagonal blocks of the inverse, by column."""
    inverse = np.empty_like(values)
    diagonal = np.empty((panels.owner.size, 3, 3))
    for panel in range(panels.first.size - 2, -1, -1):
        begin, end = panels.first[panel], panels.first[panel + 1]
        width = 3 * (end - begin)
        span = slice(panels.offsets[panel], panels.offsets[panel + 1])
        whole, found = values[span].reshape((-1, width)), inverse[span].reshape((-1, width))
        found[:width] = times(whole[:width].T.copy(), whole[:width])
        if whole.shape[0] > width:
            reach = times(whole[width:], whole[:width])
            found[width:] = -times(_gathered(panels, inverse, panel), reach)
            found[:width] -= times(reach.T.copy(), found[width:])
        for j in range(end - begin):
            for i in range(3):
                for k in range(3):
                    diagonal[begin + j, i, k] = found[3 * j + i, 3 * j + k]
    return diagonal


@kernel
def _gathered(panels: Panels, inverse: FloatArray, panel: int) -> FloatArray:
    """The inverse between all rows below a panel, taken from the panels that they belong to."""
    count = panels.starts[panel + 1] - panels.starts[panel]
    square = np.empty((3 * count, 3 * count))
    first = 0
    while first < count:
        other = panels.owner[panels.below[panels.starts[panel] + first]]
        width = 3 * (panels.first[other + 1] - panels.first[other])
        found = inverse[panels.offsets[other] : panels.offsets[other + 1]].reshape((-1, width))
        columns, at = _below_in(panels, panel, first, other)
        for r in range(at.size):
            for c in range(min(columns, r + 1)):
                for i in range(3):
                    for j in range(3):
                        value = found[3 * at[r] + i, 3 * at[c] + j]
                        square[3 * (first + r) + i, 3 * (first + c) + j] = value
                        square[3 * (first + c) + j, 3 * (first + r) + i] = value
        first += columns
    return square
