"""Where the factor of a sparse symmetric system of 3 x 3 blocks has its entries, and in what order.

Neighbouring columns of the factor that reach the same rows are kept as one dense panel
(supernodes: Ng & Peyton 1993).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from slamsim.types import IntArray

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
    """Storage for ``count`` unknowns of which (p, 2) pairs meet; pairs may repeat.

    Its pattern is that of the factor of an M-matrix on the same graph, all of whose entries have
    one sign, so that none cancels.
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
    return _panels(place, lower.indptr.astype(np.int64), lower.indices.astype(np.int64))


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
