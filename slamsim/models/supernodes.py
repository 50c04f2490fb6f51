"""Where the factor of a sparse symmetric system of 3 x 3 blocks has its entries, and in what order.

The order is SuperLU's minimum degree; the entries are those of the elimination tree (Liu 1990),
found without a single floating-point operation. Neighbouring columns of the factor that reach the
same rows are kept as one dense panel (supernodes: Ng & Peyton 1993).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import spilu

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray

LOOSE_COLUMNS = 8
"""A panel this narrow may take in the next column even if it holds rows that it does not reach."""

LOOSE_SHARE = 0.15
"""As may a wider one, if its empty share stays below this."""

MAX_COLUMNS = 32
"""Panels are cut at this width: their own triangles are not products of matrices."""


class Panels(NamedTuple):
    """Where the blocks of a system, and of its factor, are stored in one flat array.

    place: (count + 1,) column of each unknown; the unknown ``count`` is held fixed, no part of the
    system, and maps to itself. owner: (count,) panel of each column. first: (panels + 1,) first
    column of each. starts: (panels + 1,) into below: the rows that each panel reaches beneath its
    own. offsets: (panels + 1,) of each panel's (3 rows, 3 columns) in the flat array.
    """

    place: IntArray
    owner: IntArray
    first: IntArray
    starts: IntArray
    below: IntArray
    offsets: IntArray


def make_panels(pairs: IntArray, count: int) -> Panels:
    """Storage for ``count`` unknowns of which (p, 2) pairs meet; pairs may repeat."""
    inner = pairs[(pairs < count).all(axis=1)]
    order = _order(inner, count)
    later, earlier = np.sort(order[inner], axis=1).T[::-1]
    meeting = csr_matrix((np.ones(len(inner), np.int8), (later, earlier)), shape=(count, count))
    meeting.sum_duplicates()
    rows_of = meeting.indptr.astype(np.int64), meeting.indices.astype(np.int64)
    parent, sizes = _elimination_tree(*rows_of)
    starts = np.append(0, np.cumsum(sizes))
    rows = _fill(*rows_of, parent, starts)
    return _panels(np.append(order, count), starts, rows)


def one_panel(count: int) -> Panels:
    """Storage for ``count`` unknowns that all meet: as a dense matrix, row by row."""
    none = np.zeros(0, np.int64)
    return Panels(
        place=np.arange(count + 1),
        owner=np.zeros(count, np.int64),
        first=np.array([0, count]),
        starts=np.zeros(2, np.int64),
        below=none,
        offsets=np.array([0, 9 * count * count]),
    )


def empty_system(panels: Panels) -> FloatArray:
    """The flat array of a system without an equation; ``add_block`` fills it."""
    return np.zeros(int(panels.offsets[-1]))


@kernel
def add_block(panels: Panels, system: FloatArray, a: int, b: int, block: FloatArray) -> None:
    """Add what unknown ``a`` (row) and ``b`` (column) share to a system.

    Of a pair a != b, one of the two blocks, not both. Raises IndexError if the panels were made
    without this pair. system: (k,) flat. block: (3, 3).
    """
    corner, width, flipped = _corner(panels, a, b)
    for i in range(3):
        for j in range(3):
            system[corner + 3 * i * width + j] += block[j, i] if flipped else block[i, j]


@kernel
def add_blocks(panels: Panels, system: FloatArray, pairs: IntArray, blocks: FloatArray) -> None:
    """Add what (m, 2) pairs of unknowns share, (m, 3, 3), but for pairs with what is held fixed."""
    fixed = panels.place.size - 1
    for m in range(pairs.shape[0]):
        if pairs[m, 0] != fixed and pairs[m, 1] != fixed:
            add_block(panels, system, pairs[m, 0], pairs[m, 1], blocks[m])


@kernel
def blocks_at(panels: Panels, system: FloatArray, pairs: IntArray) -> FloatArray:
    """(m, 3, 3) what (m, 2) pairs of unknowns, none of them held fixed, share in a system."""
    blocks = np.empty((pairs.shape[0], 3, 3))
    for m in range(pairs.shape[0]):
        corner, width, flipped = _corner(panels, pairs[m, 0], pairs[m, 1])
        for i in range(3):
            for j in range(3):
                value = system[corner + 3 * i * width + j]
                if flipped:
                    blocks[m, j, i] = value
                else:
                    blocks[m, i, j] = value
    return blocks


@kernel
def _corner(panels: Panels, a: int, b: int) -> tuple[int, int, bool]:
    """Where the block of row a and column b begins, how wide its panel is, and whether it is kept
    transposed. Raises IndexError if the panels were made without this pair."""
    row, column = panels.place[a], panels.place[b]
    flipped = row < column
    if flipped:
        row, column = column, row
    panel = panels.owner[column]
    begin, end = panels.first[panel], panels.first[panel + 1]
    width = end - begin
    if row < end:
        at = row - begin
    else:
        at = width + _find(panels.below, panels.starts[panel], panels.starts[panel + 1], row)
    return panels.offsets[panel] + 9 * at * width + 3 * (column - begin), width, flipped


@kernel
def _find(values: IntArray, begin: int, end: int, wanted: int) -> int:
    """Index after ``begin`` of a number, by bisection. Raises IndexError if it is not there."""
    low, high = begin, end
    while low < high:
        middle = (low + high) // 2
        if values[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    if low == end or values[low] != wanted:
        raise IndexError("the factor has no entry for two unknowns that meet")
    return int(low - begin)


def _order(inner: IntArray, count: int) -> IntArray:
    """(count,) column of each unknown, so that the factor has few entries.

    It is chosen by the pattern alone; an incomplete factorisation that drops everything costs no
    more than that.
    """
    ends = np.concatenate([inner, inner[:, ::-1], np.arange(count)[:, None].repeat(2, axis=1)])
    pattern = csc_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    pattern.data[:] = -1.0
    pattern.setdiag(1.0 + count)
    factor = spilu(
        pattern,
        permc_spec="MMD_AT_PLUS_A",
        drop_tol=1.0,
        fill_factor=1.0,
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return np.asarray(factor.perm_c, dtype=np.int64)


@kernel
def _elimination_tree(starts: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
    """(n,) parent of each column, -1 without one, and how many rows each column of the factor
    has, its diagonal included, of a matrix given by the rows of its lower half.

    Row i of the factor holds the columns on the paths from its own entries up to i (Liu 1990).
    """
    count = starts.size - 1
    parent, seen_in = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    sizes = np.ones(count, np.int64)
    for i in range(count):
        seen_in[i] = i
        for entry in range(starts[i], starts[i + 1]):
            k = columns[entry]
            while seen_in[k] != i:
                if parent[k] < 0:
                    parent[k] = i
                sizes[k] += 1
                seen_in[k] = i
                k = parent[k]
    return parent, sizes


@kernel
def _fill(starts: IntArray, columns: IntArray, parent: IntArray, begins: IntArray) -> IntArray:
    """Rows of the columns of the factor, which begin where ``begins`` says: sorted, the diagonal
    first."""
    count = starts.size - 1
    seen_in = np.full(count, -1, np.int64)
    rows, free = np.empty(begins[count], np.int64), begins[:-1].copy()
    for i in range(count):
        seen_in[i] = i
        rows[free[i]] = i  # rows are entered from the top: the diagonal is the first
        free[i] += 1
        for entry in range(starts[i], starts[i + 1]):
            k = columns[entry]
            while seen_in[k] != i:
                rows[free[k]] = i
                free[k] += 1
                seen_in[k] = i
                k = parent[k]
    return rows


def _panels(place: IntArray, starts: IntArray, rows: IntArray) -> Panels:
    """Join columns of a factor given by its pattern; rows sorted, the diagonal first."""
    first = _first_columns(starts, rows)
    last = first[1:] - 1
    owner = np.repeat(np.arange(len(last)), np.diff(first))
    reached = [rows[starts[j] + 1 : starts[j + 1]] for j in last]
    sizes = np.array([len(one) for one in reached], dtype=np.int64)
    widths = np.diff(first)
    return Panels(
        place=place,
        owner=owner,
        first=first,
        starts=np.append(0, np.cumsum(sizes)),
        below=np.concatenate(reached) if reached else np.zeros(0, dtype=np.int64),
        offsets=np.append(0, np.cumsum(9 * (widths + sizes) * widths)),
    )


def _first_columns(starts: IntArray, rows: IntArray) -> IntArray:
    """(panels + 1,) where panels begin, and the number of columns."""
    sizes = np.diff(starts)
    first = [0]
    filled = int(sizes[0])
    for j in range(1, len(sizes)):
        width = j - first[-1]
        joined = sizes[j - 1] > 1 and rows[starts[j - 1] + 1] == j
        whole = (width + 1) * (width + sizes[j]) - width * (width + 1) // 2
        filled += int(sizes[j])
        loose = width < LOOSE_COLUMNS or whole - filled <= LOOSE_SHARE * whole
        if not (joined and loose and width < MAX_COLUMNS):
            first.append(j)
            filled = int(sizes[j])
    return np.array([*first, len(sizes)], dtype=np.int64)
