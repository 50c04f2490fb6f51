"""Beams through a grid of square cells, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.jit import kernel
from slamsim.types import BoolArray, Float32Array, FloatArray

CellArray = NDArray[np.int32]

NEIGHBOUR_CELLS = 3.0
JOINED_CELLS = 12.0
MIN_SINE = 0.05

FLAT_CELLS = 10.0
TOUCHING_CELLS = 1.5
OFF_LINE_CELLS = 0.6


@kernel
def walk_beam(start: FloatArray, end: FloatArray, cells: CellArray) -> int:
    """Fill ``cells`` with the (column, row) that a beam passes, first to last; how many.

    start, end: (2,) in units of cells. cells: room for at least one more than the steps between
    both in x and y. Amanatides & Woo 1987; the number of steps is fixed beforehand, so the walk
    always ends in the cell of ``end``.
    """
    column, row = int(np.floor(start[0])), int(np.floor(start[1]))
    left_x, left_y = int(np.floor(end[0])) - column, int(np.floor(end[1])) - row
    step_x, step_y = (1 if left_x > 0 else -1), (1 if left_y > 0 else -1)
    dx, dy = end[0] - start[0], end[1] - start[1]
    delta_x = abs(1.0 / dx) if left_x else np.inf
    delta_y = abs(1.0 / dy) if left_y else np.inf
    next_x = (column + (step_x > 0) - start[0]) / dx if left_x else np.inf
    next_y = (row + (step_y > 0) - start[1]) / dy if left_y else np.inf
    left_x, left_y = abs(left_x), abs(left_y)
    count = left_x + left_y + 1
    for i in range(count):
        cells[i, 0], cells[i, 1] = column, row
        if left_y == 0 or (left_x > 0 and next_x <= next_y):
            column += step_x
            left_x -= 1
            next_x += delta_x
        else:
            row += step_y
            left_y -= 1
            next_y += delta_y
    return count


@kernel
def flat_to_next(ends: FloatArray, hit: BoolArray) -> BoolArray:
    """(n,) whether the surface seems to go on straight from the end of each beam to the next's.

    ends: (n, 2) in cells, in the order of the beams. Ends that touch each other are always taken
    for one surface; others if their distance is at most FLAT_CELLS, about that of a neighbouring
    pair, and the three ends lie on one line.
    """
    count = ends.shape[0]
    steps = np.zeros(count)
    for i in range(count - 1):
        if hit[i] and hit[i + 1]:
            steps[i] = np.hypot(ends[i + 1, 0] - ends[i, 0], ends[i + 1, 1] - ends[i, 1])
    flat = np.zeros(count, np.bool_)
    for i in range(count - 1):
        if steps[i] == 0.0 or steps[i] > FLAT_CELLS:
            continue
        flat[i] = steps[i] < TOUCHING_CELLS
        for j in (i - 1, i):
            if flat[i] or j < 0 or j + 2 >= count or steps[j] == 0.0 or steps[j + 1] == 0.0:
                continue
            other = steps[j] if j < i else steps[j + 1]
            flat[i] = steps[i] <= 2.0 * other and _off_line(ends, j) < OFF_LINE_CELLS
    return flat


@kernel
def _off_line(ends: FloatArray, first: int) -> float:
    """Distance of the middle one of three ends from the line through the outer ones."""
    a, b, c = ends[first], ends[first + 1], ends[first + 2]
    dx, dy = c[0] - a[0], c[1] - a[1]
    length = np.hypot(dx, dy)
    return abs(dx * (b[1] - a[1]) - dy * (b[0] - a[0])) / length if length > 0.0 else np.inf


@kernel
def clear_shares(origins: FloatArray, ends: FloatArray, hit: BoolArray) -> FloatArray:
    """(n,) share of each beam that shows free space: up to one cell from the surface it hit.

    A beam that grazes a wall runs through the cells of that wall before it ends in one, and the
    more so the flatter it comes; those cells are not free. The surface is the line through the
    ends of the neighbouring beams, NEIGHBOUR_CELLS to either side as far as they hang together.
    origins, ends: (n, 2) in units of cells, in beam order.
    """
    count = ends.shape[0]
    shares = np.ones(count)
    for i in range(count):
        if not hit[i]:
            continue
        dx, dy = ends[i, 0] - origins[i, 0], ends[i, 1] - origins[i, 1]
        length = np.hypot(dx, dy)
        left = _neighbour(ends, hit, i, -1)
        right = _neighbour(ends, hit, i, 1)
        tx, ty = ends[right, 0] - ends[left, 0], ends[right, 1] - ends[left, 1]
        along = np.hypot(tx, ty)
        sine = abs(dx * ty - dy * tx) / (length * along) if along > 1.0 and length > 0.0 else 1.0
        shares[i] = max(0.0, 1.0 - 1.0 / (max(sine, MIN_SINE) * max(length, 1e-9)))
    return shares


@kernel
def _neighbour(ends: FloatArray, hit: BoolArray, start: int, step: int) -> int:
    """The furthest beam to one side whose end still belongs to the same surface."""
    at = start
    while True:
        following = at + step
        if following < 0 or following >= ends.shape[0] or not hit[following]:
            return at
        gap = np.hypot(ends[following, 0] - ends[at, 0], ends[following, 1] - ends[at, 1])
        whole = np.hypot(ends[following, 0] - ends[start, 0], ends[following, 1] - ends[start, 1])
        if gap > JOINED_CELLS:
            return at
        at = following
        if whole >= NEIGHBOUR_CELLS:
            return at


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

    One scan is one piece of evidence for a cell, however many of its beams pass there, and what
    lies on a flat surface between two returns is not cleared: beams that graze a wall would wear
    it away where its face reaches but little into a cell. log_odds, seen: (rows, cols);
    seen holds the mark of the last scan that changed a cell. origins, ends: (n, 2) as (x, y) in
    units of cells, all inside the grid. weights: (hit, miss, lowest, highest) log odds.
    """
    for i in range(ends.shape[0]):
        if hit[i]:
            column, row = int(np.floor(ends[i, 0])), int(np.floor(ends[i, 1]))
            if seen[row, column] != mark:
                seen[row, column] = mark
                log_odds[row, column] = min(log_odds[row, column] + weights[0], weights[3])
    cells = np.empty((log_odds.shape[0] + log_odds.shape[1] + 1, 2), np.int32)
    flat = flat_to_next(ends, hit)
    for i in range(ends.shape[0]):
        if flat[i]:
            for k in range(walk_beam(ends[i], ends[i + 1], cells)):
                seen[cells[k, 1], cells[k, 0]] = mark
    shares = clear_shares(origins, ends, hit)
    for i in range(ends.shape[0]):
        free_end = origins[i] + shares[i] * (ends[i] - origins[i])
        for k in range(walk_beam(origins[i], free_end, cells)):
            column, row = cells[k, 0], cells[k, 1]
            if seen[row, column] != mark:
                seen[row, column] = mark
                log_odds[row, column] = max(log_odds[row, column] + weights[1], weights[2])
