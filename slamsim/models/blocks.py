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
from slamsim.models.supernodes import Panels, blocks_at


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

    def inverse_root(self, right: FloatArray) -> FloatArray:
        """(3 count, k) product of a square root of the inverse, L^-T, with ``right`` (3 count, k),
        both in the order of unknowns: of independent numbers it makes draws with the inverse as
        their covariance."""
        rows = (3 * self.panels.place[:-1, None] + np.arange(3)).ravel()
        solved = np.empty_like(right)
        solved[rows] = right
        _substitute_back(self.panels, self.values, solved)
        return np.asarray(solved[rows])

    def inverse_diagonal(self) -> FloatArray:
        """(count, 3, 3) diagonal blocks of the inverse, in the order of unknowns.

        The inverse takes the place of the factor, which cannot be used again. Raises NoSolution,
        naming the key frame, for a variance that is not positive.
        """
        diagonal = self._inverted()
        self.values.fill(np.nan)
        return diagonal

    def inverse_blocks(self, pairs: IntArray) -> FloatArray:
        """(m, 3, 3) blocks of the inverse at (m, 2) pairs of unknowns that the system shares; as
        ``inverse_diagonal``."""
        self._inverted()
        found = blocks_at(self.panels, self.values, pairs)
        self.values.fill(np.nan)
        return found

    def _inverted(self) -> FloatArray:
        """The diagonal blocks of the inverse, which is in the place of the factor now."""
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
    """The factor of a system, which it takes the place of: there is one array of this size less.

    keyframes: (count,) which key frame each unknown is. Raises NoSolution, naming the key frame, if
    it is not finite or not positive definite.
    """
    finite = np.isfinite(system)
    if not finite.all():
        panel = int(np.searchsorted(panels.offsets, np.argmin(finite), "right")) - 1
        column = int(panels.first[panel])
    else:
        column = _factorise(panels, system)
    if column >= 0:
        at = int(keyframes[np.flatnonzero(panels.place[:-1] == column)[0]])
        fault = "positive definite" if finite.all() else "finite"
        raise NoSolution(f"the information matrix is not {fault} at key frame {at}", at)
    return BlockFactor(panels, system, keyframes)


@kernel
def times(a: FloatArray, b: FloatArray) -> FloatArray:
    """a b, by blocks of 4 x 4 of a: as fast as BLAS, whose bytes depend on its threads, and whose
    threads on a busy machine wait for cores."""
    out = np.zeros((a.shape[0], b.shape[1]))
    rows, columns = a.shape[0] // 4 * 4, a.shape[1] // 4 * 4
    for i in range(0, rows, 4):
        _add_four_rows(a[i : i + 4], b, out[i], out[i + 1], out[i + 2], out[i + 3])
    for i in range(a.shape[0]):
        for k in range(0 if i >= rows else columns, a.shape[1]):
            row, factor = out[i], a[i, k]
            for j in range(row.size):
                row[j] += factor * b[k, j]
    return out


@kernel
def _add_four_rows(
    a: FloatArray, b: FloatArray, w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray
) -> None:
    """Add (4, n) a times b to its four rows, but for the last columns of a up to a whole four."""
    for k in range(0, a.shape[1] // 4 * 4, 4):
        a0, a1, a2, a3 = a[0, k], a[0, k + 1], a[0, k + 2], a[0, k + 3]
        b0, b1, b2, b3 = a[1, k], a[1, k + 1], a[1, k + 2], a[1, k + 3]
        c0, c1, c2, c3 = a[2, k], a[2, k + 1], a[2, k + 2], a[2, k + 3]
        d0, d1, d2, d3 = a[3, k], a[3, k + 1], a[3, k + 2], a[3, k + 3]
        for j in range(b.shape[1]):
            p, q, r, s = b[k, j], b[k + 1, j], b[k + 2, j], b[k + 3, j]
            w[j] += a0 * p + a1 * q + a2 * r + a3 * s
            x[j] += b0 * p + b1 * q + b2 * r + b3 * s
            y[j] += c0 * p + c1 * q + c2 * r + c3 * s
            z[j] += d0 * p + d1 * q + d2 * r + d3 * s


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
            _put(reach, whole[width:], 1.0)
            _pass_on(panels, values, panel, reach)
    return -1


@kernel
def _put(values: FloatArray, to: FloatArray, sign: float) -> None:
    """Of two arrays of one shape, (n, m). Compiled, ``to[:] = values`` brings an error message with
    it that names both shapes, which takes two seconds."""
    for i in range(to.shape[0]):
        for j in range(to.shape[1]):
            to[i, j] = sign * values[i, j]


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
        for i in range(width):
            x[begin + i] = solved[i]
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
def _substitute_back(panels: Panels, values: FloatArray, x: FloatArray) -> None:
    """Solve L^T x = x in place for many columns at once; x: (3 count, k)."""
    for panel in range(panels.first.size - 2, -1, -1):
        begin, end = 3 * panels.first[panel], 3 * panels.first[panel + 1]
        width = end - begin
        whole = values[panels.offsets[panel] : panels.offsets[panel + 1]].reshape((-1, width))
        rows = panels.below[panels.starts[panel] : panels.starts[panel + 1]]
        own, under = x[begin:end].copy(), np.empty((3 * rows.size, x.shape[1]))
        for r in range(rows.size):
            _put(x[3 * rows[r] : 3 * rows[r] + 3], under[3 * r : 3 * r + 3], 1.0)
        if rows.size > 0:
            own -= times(whole[width:].T.copy(), under)
        _put(times(whole[:width].T.copy(), own), x[begin:end], 1.0)


@kernel
def _inverse_diagonal(panels: Panels, values: FloatArray) -> FloatArray:
    """(count, 3, 3) diagonal blocks of the inverse, by column; the inverse replaces the factor.

    Of the factor, a panel of the inverse needs no other than its own.
    """
    diagonal = np.empty((panels.owner.size, 3, 3))
    for panel in range(panels.first.size - 2, -1, -1):
        begin, end = panels.first[panel], panels.first[panel + 1]
        width = 3 * (end - begin)
        span = slice(panels.offsets[panel], panels.offsets[panel + 1])
        found = values[span].reshape((-1, width))
        reach = times(found[width:], found[:width])
        _put(times(found[:width].T.copy(), found[:width]), found[:width], 1.0)
        if reach.shape[0] > 0:
            _put(times(_gathered(panels, values, panel), reach), found[width:], -1.0)
            more = times(reach.T.copy(), found[width:])
            for i in range(width):
                for j in range(width):
                    found[i, j] -= more[i, j]
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
