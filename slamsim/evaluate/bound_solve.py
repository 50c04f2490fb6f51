"""Draws from the inverse of a large sparse information matrix.

With the Cholesky factor A = L L', the solution of L' x = z for normal z has covariance A^-1. It is
the factor of SLAM's systems: SuperLU holds both halves of it, and copies both to show one.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array

from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.models.blocks import factorise
from slamsim.models.supernodes import add_blocks, empty_system, make_panels
from slamsim.process.children import return_freed_memory

DRAWN_AT_ONCE = 50
"""Draws that are solved for together: all 200 of a long run take 0.1 GB beside the factor."""

TILE = 3
"""Rows and columns of a block of these systems, whatever its unknowns."""


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
    size = information.shape[0]
    normal = np.zeros((size + -size % TILE, count))
    normal[:size] = rng.standard_normal((size, count))
    pairs, blocks = _tiles(information)
    unknowns = np.arange(len(normal) // TILE)
    panels = make_panels(pairs[pairs[:, 0] != pairs[:, 1]], len(unknowns))
    return_freed_memory()  # else the system, 0.3 GB of a long run, comes on top of it
    system = empty_system(panels)
    add_blocks(panels, system, pairs, blocks)
    del pairs, blocks
    try:
        factor = factorise(panels, system, unknowns)
    except NoSolution as refusal:
        raise NoSolution("the information matrix is not positive definite") from refusal
    for begin in range(0, count, DRAWN_AT_ONCE):
        some = slice(begin, begin + DRAWN_AT_ONCE)
        normal[:, some] = factor.inverse_root(normal[:, some])
    return normal[:size]


def _tiles(information: csc_array) -> tuple[IntArray, FloatArray]:
    """The lower half in blocks of 3 x 3, filled up with ones on the diagonal: (m, 2) row and
    column of each, and (m, 3, 3)."""
    size = information.shape[0]
    added = np.arange(size, size + -size % TILE)
    entries = information.tocoo()
    rows, columns = np.append(entries.row, added), np.append(entries.col, added)
    values = np.append(entries.data, np.ones(added.size))
    whole = (size + added.size,) * 2
    tiled = csr_array((values, (rows, columns)), shape=whole).tobsr((TILE, TILE))
    of_rows = np.repeat(np.arange(len(tiled.indptr) - 1), np.diff(tiled.indptr))
    lower = of_rows >= tiled.indices
    pairs = np.stack([of_rows[lower], tiled.indices[lower]], axis=1).astype(np.int64)
    return pairs, np.asarray(tiled.data[lower], np.float64)
