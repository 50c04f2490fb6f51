"""Exact rasterisation of solids given by their outlines.

An outline is a bag of directed segments ``(n, 2, 2)`` (start and end, each x and y in metres)
with the solid on the left. Outlines may overlap: what has a positive winding number is solid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.numbers import (
    BadNumbers,
    require_finite,
    require_number,
    require_size,
    require_whole,
)

# Overlaps thinner than this do not make a cell solid: rounding at cell borders stays below it.
TOUCH_M = 1e-7
_CROSSED_AT_ONCE = 1_000_000
MOST_CELLS = 400_000_000
MOST_CROSSED = 50_000_000
"""Cells along one segment: more do not fit into memory."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Square cells whose borders lie on whole multiples of ``resolution_m`` in the map frame.

    Cell (0, 0) covers x from ``first_column * resolution_m`` and y from ``first_row * ...``.
    """

    resolution_m: float
    first_column: int
    first_row: int
    columns: int
    rows: int

    @classmethod
    def covering(cls, bounds_m: tuple[float, float, float, float], resolution_m: float) -> Raster:
        """The smallest raster over (x_min, y_min, x_max, y_max). Raises BadNumbers."""
        for border_m in bounds_m:
            require_number("a border of a raster in m", border_m)
        require_size("the size of a cell in m", resolution_m)
        if bounds_m[0] > bounds_m[2] or bounds_m[1] > bounds_m[3]:
            raise BadNumbers(f"the smaller borders of a raster come first, not {bounds_m}")
        low = np.floor(np.array(bounds_m[:2]) / resolution_m + TOUCH_M).astype(int)
        high = np.ceil(np.array(bounds_m[2:]) / resolution_m - TOUCH_M).astype(int)
        columns, rows = np.maximum(high - low, 1).tolist()
        return cls(resolution_m, int(low[0]), int(low[1]), columns, rows)

    @property
    def origin_m(self) -> tuple[float, float]:
        """Outer corner of cell (0, 0)."""
        return self.first_column * self.resolution_m, self.first_row * self.resolution_m

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows, self.columns

    def cell_of(self, points_m: FloatArray) -> IntArray:
        """(n, 2) row and column of points (n, 2); they may lie outside the raster."""
        cells = np.floor(points_m / self.resolution_m).astype(np.int64)
        return np.asarray(cells[:, ::-1] - np.array([self.first_row, self.first_column]))

    def centres_m(self, cells: IntArray) -> FloatArray:
        """(n, 2) x and y of the middles of cells (n, 2) given as row and column."""
        first = np.array([self.first_column, self.first_row])
        return np.asarray((cells[:, ::-1] + first + 0.5) * self.resolution_m)


def rasterise(segments: FloatArray, raster: Raster) -> BoolArray:
    """(rows, columns): True where the cell and the solid share any area.

    A cell that the solid covers wholly is found by the winding number of its middle (Sunday
    2001), any other by walking along the outline (Amanatides and Woo 1987). Raises
    BadNumbers for what is no outline, or reaches over more cells than memory holds.
    """
    require_finite("an outline", segments, (None, 2, 2))
    require_whole("the cells of a raster", raster.rows * raster.columns, 1, MOST_CELLS)
    longest_m = float(np.abs(segments[:, 1] - segments[:, 0]).max(initial=0.0))
    crossed = longest_m / raster.resolution_m
    require_number("the cells along a segment of an outline", crossed, 0.0, MOST_CROSSED)
    touched = np.zeros(raster.shape, dtype=bool)
    steps = np.zeros((raster.rows, raster.columns + 1), dtype=np.int64)
    for some in _blocks(segments, raster):
        _add_winding(steps, some, raster)
        rows, columns = _outline_cells(some, raster).T
        touched[rows, columns] = True
    return touched | (np.cumsum(steps, axis=1)[:, :-1] > 0)


def _blocks(segments: FloatArray, raster: Raster) -> Iterator[FloatArray]:
    """The segments by as many as cross a million borders of cells: what one step holds at once."""
    crossed = np.abs(segments[:, 1] - segments[:, 0]).sum(axis=1) / raster.resolution_m + 2.0
    before = np.concatenate([[0.0], np.cumsum(crossed)])
    first = 0
    while first < len(segments):
        after = np.searchsorted(before, before[first] + _CROSSED_AT_ONCE, side="right") - 1
        last = max(int(after), first + 1)
        yield segments[first:last]
        first = last


def _add_winding(steps: IntArray, segments: FloatArray, raster: Raster) -> None:
    """Enters into (rows, columns + 1) how the winding number of the middles of cells changes from
    each cell to the next, in place."""
    scaled = segments / raster.resolution_m - (raster.first_column, raster.first_row)
    upward = scaled[:, 0, 1] < scaled[:, 1, 1]
    low = np.where(upward[:, None], scaled[:, 0], scaled[:, 1])
    high = np.where(upward[:, None], scaled[:, 1], scaled[:, 0])
    first = np.clip(np.ceil(low[:, 1] - 0.5), 0, raster.rows).astype(np.int64)
    count = np.clip(np.ceil(high[:, 1] - 0.5), 0, raster.rows).astype(np.int64) - first
    which = np.repeat(np.arange(len(segments)), count)
    row = first[which] + _ramps(count)
    rise = high[which, 1] - low[which, 1]
    fraction = (row + 0.5 - low[which, 1]) / rise
    x = low[which, 0] + fraction * (high[which, 0] - low[which, 0])
    column = np.clip(np.ceil(x - 0.5), 0, raster.columns).astype(np.int64)
    np.add.at(steps, (row, column), np.where(upward[which], -1, 1))


def _ramps(counts: IntArray) -> IntArray:
    """0, 1, ... up to each count, one after the other."""
    starts = np.cumsum(counts) - counts
    return np.arange(int(counts.sum())) - np.repeat(starts, counts)


def _outline_cells(segments: FloatArray, raster: Raster) -> IntArray:
    """(k, 2) row and column of the cells just inside the outlines, repetitions included."""
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.hypot(step[:, 0], step[:, 1])
    keep = length > TOUCH_M
    start, step, length = start[keep], step[keep], length[keep]
    which, at = _cuts(start, step, raster.resolution_m)
    same = which[1:] == which[:-1]
    piece = which[:-1][same]
    begin, end = at[:-1][same], at[1:][same]
    real = (end - begin) * length[piece] > TOUCH_M
    piece, middle = piece[real], 0.5 * (begin[real] + end[real])
    inward = np.column_stack([-step[:, 1], step[:, 0]]) / length[:, None] * TOUCH_M
    points = start[piece] + middle[:, None] * step[piece] + inward[piece]
    cells = raster.cell_of(points)
    inside = np.all((cells >= 0) & (cells < np.array(raster.shape)), axis=1)
    return cells[inside]


def _cuts(start: FloatArray, step: FloatArray, resolution_m: float) -> tuple[IntArray, FloatArray]:
    """Where segments cross cell borders: segment and fraction along it, ends included, sorted."""
    number = np.arange(len(start))
    which, at = [number, number], [np.zeros(len(start)), np.ones(len(start))]
    for axis in (0, 1):
        ends = np.stack([start[:, axis], start[:, axis] + step[:, axis]]) / resolution_m
        first = np.floor(ends.min(axis=0)).astype(np.int64) + 1
        count = np.maximum(np.ceil(ends.max(axis=0)).astype(np.int64) - first, 0)
        owner = np.repeat(number, count)
        border = (first[owner] + _ramps(count)) * resolution_m
        which.append(owner)
        at.append((border - start[owner, axis]) / step[owner, axis])
    segment, fraction = np.concatenate(which), np.clip(np.concatenate(at), 0.0, 1.0)
    order = np.lexsort((fraction, segment))
    return segment[order], fraction[order]
