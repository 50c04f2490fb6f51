"""Connected parts of a graph."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from slamsim.core.types import IntArray


def components(pairs: IntArray, count: int) -> IntArray:
    """(count,) number of the connected part of each of count nodes, of which pairs (p, 2) join."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
