"""Beams through a grid of square cells, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.jit import kernel
from slamsim.types import BoolArray, Float32Array, FloatArray

CellArray = NDArray[np.int32]

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
    for i in range(ends.shape[0]):
        count = walk_beam(origins[i], ends[i], cells)
        for k in range(count - 1 if hit[i] else count):
            column, row = cells[k, 0], cells[k, 1]
            if seen[row, column] != mark:
                seen[row, column] = mark
                log_odds[row, column] = max(log_odds[row, column] + weights[1], weights[2])
