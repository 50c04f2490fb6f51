"""Connected parts: of a graph, and of a row of flags."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from slamsim.core.types import BoolArray, IntArray


def components(pairs: IntArray, count: int) -> IntArray:
    """(count,) number of the connected part of each of count nodes, of which pairs (p, 2) join."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def runs_of(flags: BoolArray) -> list[tuple[int, int]]:
    """(first, last) of each stretch of true in flags (n,)."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
