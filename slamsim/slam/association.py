"""Which pieces of which views are one and the same surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, triu

from slamsim.jit import kernel
from slamsim.slam.estimate import Estimate
from slamsim.slam.matching.local_map import MERGE_COS, merge_into
from slamsim.slam.matching.surfaces import BEAMS, NORMAL_X, NORMAL_Y, PIECE_FIELDS, X, Y
from slamsim.slam.views import moved_pieces
from slamsim.types import BoolArray, Float32Array, FloatArray, IntArray

CELL_M = 0.5
"""Surfaces are sought within cells of this size: what is as long as this may still be straight."""

SURE_SIGMA_M = 0.05
"""Two views share no surface across which the graph is less sure than this how they lie."""


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
    views: Sequence[Float32Array], poses: FloatArray, gate_m: float, estimate: Estimate
) -> Shared:
    """What the views (n of (k, PIECE_FIELDS)) have in common, standing at ``poses`` (n, 3).

    gate_m: how far apart pieces of one surface may lie across it. The two faces of a wall are never
    one, for normals point to the lidar. Passes between which the estimate is not sure get a
    copy of the surface each.
    """
    view = np.repeat(np.arange(len(views)), [len(one) for one in views])
    moved = [
        moved_pieces(one.astype(np.float64), pose) for one, pose in zip(views, poses, strict=True)
    ]
    pieces = np.concatenate(moved)
    cells = np.floor(pieces[:, [X, Y]] / CELL_M).astype(np.int64)
    by_cell = np.lexsort((-pieces[:, BEAMS], cells[:, 1], cells[:, 0]))
    surface = _cluster(pieces, cells, by_cell, gate_m)
    order = np.lexsort((view, surface))
    parted = _parted(pieces[order], view[order], surface[order], estimate)
    surface = np.cumsum(parted) - 1
    new_view = parted | np.append(True, np.diff(view[order]) != 0)
    seen_by = np.bincount(surface, new_view)
    kept = seen_by[surface] >= 2
    starts = np.flatnonzero(np.append(np.diff(surface[kept], prepend=-1) != 0, True))
    return Shared(order[kept], view[order][kept], starts)


def _parted(pieces: FloatArray, view: IntArray, surface: IntArray, estimate: Estimate) -> BoolArray:
    """(k,) whether each of the sorted pieces begins another surface than the one before."""
    parted = np.append(True, np.diff(surface) != 0)
    after = np.flatnonzero(~parted & np.append(False, np.diff(view) != 0))
    covariances = estimate.covariances_in_map(view[after - 1], view[after])
    nx, ny = pieces[after, NORMAL_X], pieces[after, NORMAL_Y]
    lever = np.stack([nx, ny, ny * pieces[after, X] - nx * pieces[after, Y]], axis=1)
    variance = np.einsum("ki,kij,kj->k", lever, covariances, lever)
    parted[after] = variance > SURE_SIGMA_M**2
    return parted


@kernel
def _cluster(pieces: FloatArray, cells: IntArray, order: IntArray, gate_m: float) -> IntArray:
    """(k,) number of the surface of each piece; within a cell, those of most beams come first."""
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
            merged[used] = pieces[k]
            used += 1
        else:
            merge_into(pieces[k], merged, best)
        surface[k] = best
    return surface
