"""Which pieces of which views are one and the same surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, triu
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from slamsim.core.components import components
from slamsim.core.jit import kernel
from slamsim.core.result import GraphEdge
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.slam.backend.views import moved_pieces
from slamsim.slam.matching.local_map import MERGE_COS, merge_into
from slamsim.slam.matching.small import put
from slamsim.slam.matching.surfaces import BEAMS, NORMAL_X, NORMAL_Y, PIECE_FIELDS, X, Y

CELL_M = 0.5
"""Surfaces are sought within cells of this size: what is as long as this may still be straight."""

BESIDE_M = 0.15
"""Surfaces of neighbouring cells whose middles are no farther apart may be one."""

SURE_SIGMA_M = 0.15
"""Two views between which the graph is less sure than this share no surface."""

LEVER_M = 5.0
"""How far away surfaces are, when a turn is taken for a distance."""

_SOURCES = 256

_ROOTS = 32
"""So many views are tried as a way from any view to any other, before ways are sought pair by pair:
in a map of many loops that decides nearly all pairs."""


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """Observations of surfaces that two views or more have seen, sorted by surface, then view.

    pieces: (k,) which of all pieces each observation is. views: (k,) the view it is from.
    starts: (m + 1,) first observation of each surface.
    """

    pieces: IntArray
    views: IntArray
    starts: IntArray

    @property
    def surfaces(self) -> IntArray:
        """(k,) number of the surface of each observation."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def pairs(self) -> IntArray:
        """(p, 2) views that share any surface, each pair once, the earlier first."""
        seen = csr_matrix((np.ones(len(self.views)), (self.views, self.surfaces)))
        together = triu(seen @ seen.T, k=1)
        return np.stack([together.row, together.col], axis=1).astype(np.int64)


def share_surfaces(
    views: Sequence[Float32Array], poses: FloatArray, gate_m: float, edges: Sequence[GraphEdge]
) -> Shared:
    """What the views (n of (k, PIECE_FIELDS)) have in common, standing at ``poses`` (n, 3).

    gate_m: how far apart pieces of one surface may lie across it. The two faces of a wall are never
    one, for normals point to the lidar. Passes that the believed edges do not hold together
    firmly get a copy of the surface each.
    """
    view = np.repeat(np.arange(len(views)), [len(one) for one in views])
    moved = [
        moved_pieces(one.astype(np.float64), pose) for one, pose in zip(views, poses, strict=True)
    ]
    pieces = np.concatenate(moved)
    if not len(pieces):
        nothing = np.zeros(0, dtype=np.int64)
        return Shared(nothing, nothing, np.zeros(1, dtype=np.int64))
    cells = np.floor(pieces[:, [X, Y]] / CELL_M).astype(np.int64)
    by_cell = np.lexsort((-pieces[:, BEAMS], cells[:, 1], cells[:, 0]))
    surface, found = _cluster(pieces, cells, by_cell, gate_m)
    surface = _across_cells(found, gate_m)[surface]
    order = np.lexsort((view, surface))
    parted = _parted(view[order], surface[order], edges)
    surface = np.cumsum(parted) - 1
    new_view = parted | np.append(True, np.diff(view[order]) != 0)
    seen_by = np.bincount(surface, new_view)
    kept = seen_by[surface] >= 2
    starts = np.flatnonzero(np.append(np.diff(surface[kept], prepend=-1) != 0, True))
    return Shared(order[kept], view[order][kept], starts)


def loose_closures(edges: Sequence[GraphEdge], held: int) -> list[GraphEdge]:
    """The believed closures between views that share no surface, for the edges do not hold them
    together firmly: what they say is in no surface. held: so many of the first poses stay."""
    closures = [e for e in edges if e.kind == "closure" and e.weight > 0.0]
    closures = [e for e in closures if max(e.source, e.target) >= held]
    pairs = np.array([(e.source, e.target) for e in closures], dtype=np.int64).reshape(-1, 2)
    firm = _firm(pairs, edges)
    return [edge for edge, holds in zip(closures, firm, strict=True) if not holds]


def _across_cells(found: FloatArray, gate_m: float) -> IntArray:
    """(s,) new numbers of surfaces: one for two that only the border of a cell runs between.

    Otherwise noise would sort what is seen of a wall on a border into a near and a far one.
    """
    middle, normal = found[:, [X, Y]], found[:, [NORMAL_X, NORMAL_Y]]
    a, b = cKDTree(middle).query_pairs(BESIDE_M, output_type="ndarray").T
    off = np.abs(((middle[a] - middle[b]) * normal[a]).sum(axis=1))
    one = ((normal[a] * normal[b]).sum(axis=1) > MERGE_COS) & (off < gate_m)
    return components(np.column_stack([a[one], b[one]]), len(found))


def _parted(view: IntArray, surface: IntArray, edges: Sequence[GraphEdge]) -> BoolArray:
    """(k,) whether each of the sorted observations begins another surface than the one before."""
    parted = np.append(True, np.diff(surface) != 0)
    after = np.flatnonzero(~parted & np.append(False, np.diff(view) != 0))
    parted[after] = ~_firm(np.stack([view[after - 1], view[after]], axis=1), edges)
    return parted


def _firm(pairs: IntArray, edges: Sequence[GraphEdge]) -> BoolArray:
    """(p,) whether the surest way along the edges from one view to the other is sure enough.

    Variances add along it: more than the graph as a whole leaves between the two.
    """
    if not len(pairs):
        return np.zeros(0, dtype=np.bool_)
    count = 1 + max(edge.target for edge in edges)
    used = [edge for edge in edges if edge.weight > 0.0]
    turn = np.array([1.0, 1.0, LEVER_M**2])
    variance = np.array([np.diag(edge.covariance) @ turn for edge in used])
    ends = np.array([(edge.source, edge.target) for edge in used])
    # Of several edges between two views the surest: a matrix would add them up.
    surest = np.argsort(variance, kind="stable")
    between = ends.min(axis=1) * count + ends.max(axis=1)
    one = surest[np.unique(between[surest], return_index=True)[1]]
    graph = csr_matrix((variance[one], ends[one].T), shape=(count, count))
    firm = _firm_by_roots(pairs, graph)
    left = np.flatnonzero(~firm)
    firm[left] = _firm_by_pairs(pairs[left], graph)
    return firm


def _firm_by_roots(pairs: IntArray, graph: csr_matrix) -> BoolArray:
    """(p,) pairs that a way over one of some views tells to be firm; a surer one there may be."""
    views = np.unique(pairs)
    roots = views[np.linspace(0, len(views) - 1, min(_ROOTS, len(views))).astype(np.int64)]
    reach = dijkstra(graph, directed=False, indices=roots, limit=SURE_SIGMA_M**2)
    firm = np.zeros(len(pairs), dtype=np.bool_)
    for away in reach:
        firm |= away[pairs[:, 0]] + away[pairs[:, 1]] <= SURE_SIGMA_M**2
    return firm


def _firm_by_pairs(pairs: IntArray, graph: csr_matrix) -> BoolArray:
    """(p,) by the surest way of each pair."""
    firm = np.zeros(len(pairs), dtype=np.bool_)
    order = np.argsort(pairs[:, 0], kind="stable")
    sources = np.unique(pairs[:, 0])
    for begin in range(0, len(sources), _SOURCES):
        some = sources[begin : begin + _SOURCES]
        between = np.searchsorted(pairs[order, 0], [some[0], some[-1] + 1])
        here = order[between[0] : between[1]]
        reach = dijkstra(graph, directed=False, indices=some, limit=SURE_SIGMA_M**2)
        firm[here] = np.isfinite(reach[np.searchsorted(some, pairs[here, 0]), pairs[here, 1]])
    return firm


@kernel
def _cluster(
    pieces: FloatArray, cells: IntArray, order: IntArray, gate_m: float
) -> tuple[IntArray, FloatArray]:
    """(k,) number of the surface of each piece, and the surfaces (s, PIECE_FIELDS).

    order: by cell, those of most beams first.
    """
    surface = np.empty(order.size, np.int64)
    merged = np.empty((order.size, PIECE_FIELDS))
    first = used = 0
    for n in range(order.size):
        k = order[n]
        if n > 0:
            before = order[n - 1]
            if cells[k, 0] != cells[before, 0] or cells[k, 1] != cells[before, 1]:
                first = used
        best, best_off = -1, gate_m
        for s in range(first, used):
            nx, ny = merged[s, NORMAL_X], merged[s, NORMAL_Y]
            if nx * pieces[k, NORMAL_X] + ny * pieces[k, NORMAL_Y] < MERGE_COS:
                continue
            off = np.abs(nx * (pieces[k, X] - merged[s, X]) + ny * (pieces[k, Y] - merged[s, Y]))
            if off < best_off:
                best, best_off = s, off
        if best < 0:
            best = used
            put(pieces[k], merged[used])
            used += 1
        else:
            merge_into(pieces[k], merged, best)
        surface[k] = best
    return surface, merged[:used].copy()
