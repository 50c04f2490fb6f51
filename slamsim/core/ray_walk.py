"""Traverses the grid cells along a ray (Amanatides & Woo 1987), compiled, and what it tells of
them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slamsim.core.arrays import FloatArray
from slamsim.core.jit import kernel


class RayWalk(NamedTuple):
    """How far a ray has come: column and row of the cell that it is in.

    way: from its origin to where it came in. next_x, next_y: to where it enters the next column
    and the next row, ``inf`` if it never does. pitch_x, pitch_y: from one column, and one row, to
    the next. step_x, step_y: 1 or -1. Lengths are multiples of the ray's direction vector.
    """

    column: int
    row: int
    way: float
    next_x: float
    next_y: float
    pitch_x: float
    pitch_y: float
    step_x: int
    step_y: int


def evidence_weights(hit: float, miss: float, lowest: float, highest: float) -> FloatArray:
    """(4,) log odds, which add up over rays (Moravec & Elfes 1985), of these probabilities that a
    cell is occupied: after one ray that ends there, after one that passes, and of no cell less and
    more."""
    probabilities = np.array([hit, miss, lowest, highest])
    return np.asarray(np.log(probabilities / (1.0 - probabilities)))


@kernel
def begin_walk(x: float, y: float, dx: float, dy: float, cell: float) -> RayWalk:
    """A ray from (x, y) along (dx, dy), in the cell that it begins in.

    cell: side of a cell, in the unit of x and y; that of column 0 and row 0 begins at (0, 0).
    """
    px, py = x / cell, y / cell
    column, row = math.floor(px), math.floor(py)
    next_x, pitch_x, next_y, pitch_y = math.inf, math.inf, math.inf, math.inf
    if dx != 0.0:
        next_x, pitch_x = (column + (dx > 0.0) - px) * cell / dx, abs(cell / dx)
    if dy != 0.0:
        next_y, pitch_y = (row + (dy > 0.0) - py) * cell / dy, abs(cell / dy)
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    return RayWalk(column, row, 0.0, next_x, next_y, pitch_x, pitch_y, step_x, step_y)


@kernel
def next_cell(walk: RayWalk) -> RayWalk:
    """The walk in the next cell."""
    column, row, _, next_x, next_y, pitch_x, pitch_y, step_x, step_y = walk
    if next_x <= next_y:
        way, column, next_x = next_x, column + step_x, next_x + pitch_x
    else:
        way, row, next_y = next_y, row + step_y, next_y + pitch_y
    return RayWalk(column, row, way, next_x, next_y, pitch_x, pitch_y, step_x, step_y)


@kernel
def held_at(walk: RayWalk, column: int, row: int) -> RayWalk:
    """The walk, once in this column never to leave it, and likewise the row.

    A walk held after every step cannot miss the cell that its ray is known to end in.
    """
    return RayWalk(
        walk.column,
        walk.row,
        walk.way,
        math.inf if walk.column == column else walk.next_x,
        math.inf if walk.row == row else walk.next_y,
        walk.pitch_x,
        walk.pitch_y,
        walk.step_x,
        walk.step_y,
    )
