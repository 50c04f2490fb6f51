"""Draws from the inverse of a large sparse information matrix.

With the Cholesky factor A = C C', the solution of A x = C z for normal z has covariance A^-1. The
factor is SuperLU's, without pivoting: A = L D L'.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution, solving


class Blocks:
    """Collects dense blocks of a symmetric matrix and adds them up."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._rows: list[IntArray] = []
        self._columns: list[IntArray] = []
        self._values: list[FloatArray] = []

    def add(self, row: IntArray, column: IntArray, blocks: FloatArray) -> None:
        """blocks: (n, a, b), first entries at row[i], column[i]; mirrored off the diagonal.

        Those of one place are added up at once: a wall is met by thousands of scans, and a row
        and a column for each number of each took 200 MB for the default labyrinth.
        """
        places, which = np.unique(row * self._size + column, return_inverse=True)
        row, column = np.divmod(places, self._size)
        _, a, b = blocks.shape
        one_each = np.ones(which.size), (which, np.arange(which.size))
        adding = csr_array(one_each, shape=(places.size, which.size))
        blocks = (adding @ blocks.reshape(-1, a * b)).reshape(-1, a, b)
        rows = np.broadcast_to(row[:, None, None] + np.arange(a)[:, None], blocks.shape)
        columns = np.broadcast_to(column[:, None, None] + np.arange(b), blocks.shape)
        self._keep(rows, columns, blocks)
        across = row != column
        self._keep(columns[across], rows[across], blocks[across])

    def _keep(self, rows: IntArray, columns: IntArray, values: FloatArray) -> None:
        self._rows.append(rows.ravel())
        self._columns.append(columns.ravel())
        self._values.append(values.ravel())

    def matrix(self) -> csc_array:
        """All blocks added up."""
        places = np.concatenate(self._rows), np.concatenate(self._columns)
        shape = self._size, self._size
        return coo_array((np.concatenate(self._values), places), shape=shape).tocsc()


def draws(information: csc_array, count: int, rng: np.random.Generator) -> FloatArray:
    """(n, count) independent normal vectors whose covariance is the inverse of ``information``.

    Raises NoSolution unless it is positive definite.
    """
    with solving("a bound"):
        factor = splu(
            information.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    diagonal = factor.U.diagonal()
    if not (np.array_equal(factor.perm_r, factor.perm_c) and np.all(diagonal > 0.0)):
        raise NoSolution("the information matrix is not positive definite")
    normal = np.sqrt(diagonal)[:, None] * rng.standard_normal((diagonal.size, count))
    return np.asarray(factor.solve(np.ascontiguousarray((factor.L @ normal)[factor.perm_r])))
