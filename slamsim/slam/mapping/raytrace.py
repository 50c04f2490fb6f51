"""Beams through a grid of square cells, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.core.ray_walk import begin_walk, held_at, next_cell
from slamsim.core.types import BoolArray, Float32Array, FloatArray

CellArray = NDArray[np.int32]

SURFACE_CELLS = 3.0
"""Over so many cells the direction of a wall is known to a fraction of a cell, and a corner is
still one."""
JOINED_CELLS = 12.0
"""Ends of neighbouring beams that are farther apart lie on different things: 0.6 m of cells of 5
cm."""
MAX_BEAMS_BESIDE = 40
MIN_SINE = 0.05
"""Of the angle between beam and wall (3 degrees): flatter ones would free no cell at all."""


@kernel
def walk_beam(start: FloatArray, end: FloatArray, cells: CellArray) -> int:
    """Fill ``cells`` with the (column, row) that a beam passes, first to last; how many.

    start, end: (2,) in units of cells. cells: room for at least one more than the steps between
    both in x and y. The walk ends in the cell of ``end``, whatever is lost in rounding.
    """
    last_column, last_row = int(np.floor(end[0])), int(np.floor(end[1]))
    walk = begin_walk(start[0], start[1], end[0] - start[0], end[1] - start[1], 1.0)
    count = abs(last_column - walk.column) + abs(last_row - walk.row) + 1
    for i in range(count):
        cells[i, 0], cells[i, 1] = walk.column, walk.row
        walk = next_cell(held_at(walk, last_column, last_row))
    return count


@kernel
def clear_shares(origins: FloatArray, ends: FloatArray, hit: BoolArray) -> FloatArray:
    """(n,) share of each beam that shows free space: up to one cell from the surface it hit.

    A beam that grazes a wall runs through the cells of that wall before it ends in one, and the
    more so the flatter it comes; those cells are not free, and cleared by many such beams the
    wall would be worn away. The surface is the line through the ends of beams about
    SURFACE_CELLS to either side, or of the very next ones, unless they lie on something else.
    origins, ends: (n, 2) in units of cells, in beam order.
    """
    count = ends.shape[0]
    shares = np.ones(count)
    for i in range(count):
        if not hit[i]:
            continue
        left, right = _beside(ends, hit, i, -1), _beside(ends, hit, i, 1)
        dx, dy = ends[i, 0] - origins[i, 0], ends[i, 1] - origins[i, 1]
        tx, ty = ends[right, 0] - ends[left, 0], ends[right, 1] - ends[left, 1]
        length, along = max(np.hypot(dx, dy), 1e-9), np.hypot(tx, ty)
        sine = abs(dx * ty - dy * tx) / (length * along) if along > 1.0 else 1.0
        shares[i] = max(0.0, 1.0 - 1.0 / (max(sine, MIN_SINE) * length))
    return shares


@kernel
def _beside(ends: FloatArray, hit: BoolArray, i: int, step: int) -> int:
    """A beam to one side of a beam that hit the same surface, or the beam itself."""
    next_to = i + step
    if next_to < 0 or next_to >= ends.shape[0] or not hit[next_to]:
        return i
    gap = np.hypot(ends[next_to, 0] - ends[i, 0], ends[next_to, 1] - ends[i, 1])
    if gap > JOINED_CELLS:
        return i
    far = i + step * max(1, min(MAX_BEAMS_BESIDE, int(SURFACE_CELLS / max(gap, 1e-3))))
    if far < 0 or far >= ends.shape[0] or not hit[far]:
        return next_to
    away = np.hypot(ends[far, 0] - ends[i, 0], ends[far, 1] - ends[i, 1])
    return far if away <= 2.0 * max(SURFACE_CELLS, gap) else next_to


@kernel
def update_log_odds(
    log_odds: Float32Array,
    seen: NDArray[np.int32],
    mark: int,
    origins: FloatArray,
    ends: FloatArray,
    hit: BoolArray,
    weights: FloatArray,
) -> None:
    """Enter one scan into a grid, in place: each cell changes at most once, and hits win.

    One scan is one piece of evidence for a cell, however many of its beams pass there. log_odds,
    seen: (rows, cols); seen holds the mark of the last scan that changed a cell. origins, ends:
    (n, 2) as (x, y) in units of cells, all inside the grid, in beam order. weights: (hit, miss,
    lowest, highest) log odds.
    """
    for i in range(ends.shape[0]):
        if hit[i]:
            column, row = int(np.floor(ends[i, 0])), int(np.floor(ends[i, 1]))
            if seen[row, column] != mark:
                seen[row, column] = mark
                log_odds[row, column] = min(log_odds[row, column] + weights[0], weights[3])
    cells = np.empty((log_odds.shape[0] + log_odds.shape[1] + 1, 2), np.int32)
    shares = clear_shares(origins, ends, hit)
    for i in range(ends.shape[0]):
        free_end = origins[i] + shares[i] * (ends[i] - origins[i])
        for k in range(walk_beam(origins[i], free_end, cells)):
            column, row = cells[k, 0], cells[k, 1]
            if seen[row, column] != mark:
                seen[row, column] = mark
                log_odds[row, column] = max(log_odds[row, column] + weights[1], weights[2])
