"""True walls as straight faces, and which face each beam meets first.

A face is a maximal straight stretch of the outline of everything solid at the lidar's height. Its
position has two unknowns: how far it lies along its normal, and how it is turned about its middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.ray_walk import begin_walk, next_cell
from slamsim.core.types import FloatArray, IntArray

SAME_LINE_M = 1e-4
"""Stretches of outline whose ends lie this near to one line, and touch, are one face."""

SAME_DIRECTION_RAD = 1e-4
"""Segments of one wall differ by rounding alone: far less."""
_LEAST_LENGTH_M = 1e-6
"""Shorter edges of an outline have no direction."""
_CELLS_PER_STRETCH = 4.0
"""For speed alone: about one wall in four cells."""
_MOST_CELLS = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """normal: (f, 2), unit, out of the solid. middle_m: (f, 2). length_m: (f,)."""

    normal: FloatArray
    middle_m: FloatArray
    length_m: FloatArray

    def __len__(self) -> int:
        return len(self.length_m)

    @property
    def ends_m(self) -> FloatArray:
        """(f, 2, 2) start and end, the solid on the left."""
        along = np.column_stack([-self.normal[:, 1], self.normal[:, 0]])
        half = 0.5 * self.length_m[:, None] * along
        return np.stack([self.middle_m - half, self.middle_m + half], axis=1)


def wall_faces(outline_m: FloatArray) -> Faces:
    """Faces of an outline: directed segments (n, 2, 2) in the map frame, the solid on the left.

    Segments of one direction that lie on one line and touch or overlap are joined.
    """
    step = outline_m[:, 1] - outline_m[:, 0]
    length = np.hypot(step[:, 0], step[:, 1])
    kept = length > _LEAST_LENGTH_M
    along = step[kept] / length[kept, None]
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    outline_m = outline_m[kept]
    line = _lines(np.arctan2(along[:, 1], along[:, 0]), (normal * outline_m[:, 0]).sum(axis=1))
    first = np.einsum("ij,ij->i", outline_m[:, 0], along)
    last = np.einsum("ij,ij->i", outline_m[:, 1], along)
    order = np.lexsort((first, line))
    group = _joined(line[order], first[order], last[order])
    longest = _longest_of(group, (last - first)[order])
    begin = np.full(len(longest), np.inf)
    end = np.full(len(longest), -np.inf)
    np.minimum.at(begin, group, first[order])
    np.maximum.at(end, group, last[order])
    chosen = order[longest]
    across = (normal[chosen] * outline_m[chosen, 0]).sum(axis=1)
    middle = 0.5 * (begin + end)[:, None] * along[chosen] + across[:, None] * normal[chosen]
    return Faces(normal[chosen], middle, end - begin)


def _lines(angle_rad: FloatArray, across_m: FloatArray) -> IntArray:
    """(n,) number of the line that each directed segment lies on."""
    angle = np.mod(angle_rad + 0.5 * SAME_DIRECTION_RAD, 2.0 * np.pi)
    by_angle = np.argsort(angle, kind="stable")
    bundle = np.empty(angle.size, dtype=np.int64)
    bundle[by_angle] = np.cumsum(np.diff(angle[by_angle], prepend=0.0) > SAME_DIRECTION_RAD)
    order = np.lexsort((across_m, bundle))
    new = np.diff(across_m[order], prepend=-np.inf) > SAME_LINE_M
    new |= np.diff(bundle[order], prepend=-1) != 0
    line = np.empty(angle.size, dtype=np.int64)
    line[order] = np.cumsum(new) - 1
    return line


def _joined(line: IntArray, first_m: FloatArray, last_m: FloatArray) -> IntArray:
    """(n,) number of the face of each stretch; stretches sorted by line and beginning."""
    group = np.zeros(line.size, dtype=np.int64)
    number, reach = -1, -math.inf
    before = -1
    for at, (on, begin, end) in enumerate(
        zip(line.tolist(), first_m.tolist(), last_m.tolist(), strict=True)
    ):
        if on != before or begin > reach + SAME_LINE_M:
            number, reach = number + 1, -math.inf
        group[at], before, reach = number, on, max(reach, end)
    return group


def _longest_of(group: IntArray, length_m: FloatArray) -> IntArray:
    """(groups,) which member of each group is the longest."""
    order = np.lexsort((-length_m, group))
    return order[np.unique(group[order], return_index=True)[1]]


class FaceIndex(NamedTuple):
    """Faces, and which of them cross which square cells, as kernels take them.

    normal: (f, 2). middle_m: (f, 2). half_m: (f,) half their lengths. origin_m: (2,) outer corner
    of the first cell. members: of a cell, row by row, ``members[starts[cell]:starts[cell + 1]]``.
    """

    normal: FloatArray
    middle_m: FloatArray
    half_m: FloatArray
    origin_m: FloatArray
    cell_m: float
    columns: int
    rows: int
    starts: IntArray
    members: IntArray


def index_faces(faces: Faces) -> FaceIndex:
    """Cells about as large as faces are apart, so that a beam looks at few of either."""
    ends = faces.ends_m
    low, high = ends.min(axis=(0, 1)) - 0.01, ends.max(axis=(0, 1)) + 0.01
    size = high - low
    wanted = min(_CELLS_PER_STRETCH * len(faces), _MOST_CELLS)
    cell_m = float(math.sqrt(size[0] * size[1] / wanted))
    columns, rows = (np.floor(size / cell_m).astype(int) + 1).tolist()
    pairs = []
    for number, ((x0, y0), (x1, y1)) in enumerate(((ends - low) / cell_m).tolist()):
        for column in range(int(min(x0, x1)), int(max(x0, x1)) + 1):
            bottom, top = _span_in_column(x0, y0, x1, y1, column)
            pairs += [(row * columns + column, number) for row in range(int(bottom), int(top) + 1)]
    cells, members = np.array(pairs, dtype=np.int64).T
    order = np.argsort(cells, kind="stable")
    starts = np.searchsorted(cells[order], np.arange(rows * columns + 1)).astype(np.int64)
    half_m = 0.5 * faces.length_m
    return FaceIndex(
        faces.normal, faces.middle_m, half_m, low, cell_m, columns, rows, starts, members[order]
    )


def _span_in_column(x0: float, y0: float, x1: float, y1: float, column: int) -> tuple[float, float]:
    """Lowest and highest y of a segment within a column of cells, a little more than exact."""
    if abs(x1 - x0) < 1e-12:
        return max(min(y0, y1) - 1e-6, 0.0), max(y0, y1) + 1e-6
    rise = (y1 - y0) / (x1 - x0)
    left, right = max(min(x0, x1), column - 1e-6), min(max(x0, x1), column + 1.0 + 1e-6)
    a, b = y0 + rise * (left - x0), y0 + rise * (right - x0)
    return max(min(a, b) - 1e-6, 0.0), max(a, b) + 1e-6


@kernel
def first_face(
    x: float, y: float, dx: float, dy: float, reach_m: float, index: FaceIndex
) -> tuple[int, float]:
    """The face that a ray meets first from its outside, and how far away; -1 for none.

    (dx, dy) is a unit vector. The ray may begin outside of all cells.
    """
    best, face = reach_m, -1
    columns, rows = index.columns, index.rows
    walk = begin_walk(x - index.origin_m[0], y - index.origin_m[1], dx, dy, index.cell_m)
    while walk.way <= best:
        if (walk.column < 0 and dx <= 0.0) or (walk.column >= columns and dx >= 0.0):
            break
        if (walk.row < 0 and dy <= 0.0) or (walk.row >= rows and dy >= 0.0):
            break
        if 0 <= walk.column < columns and 0 <= walk.row < rows:
            cell = walk.row * columns + walk.column
            face, best = _nearer(x, y, dx, dy, face, best, cell, index)
        walk = next_cell(walk)
    return face, best


@kernel
def _nearer(
    x: float, y: float, dx: float, dy: float, face: int, best: float, cell: int, index: FaceIndex
) -> tuple[int, float]:
    """The nearest face by now, given those of one more cell."""
    for k in index.members[index.starts[cell] : index.starts[cell + 1]]:
        nx, ny = index.normal[k, 0], index.normal[k, 1]
        towards = nx * dx + ny * dy
        if towards >= -1e-9:
            continue
        cx, cy = index.middle_m[k, 0] - x, index.middle_m[k, 1] - y
        far = (nx * cx + ny * cy) / towards
        if 0.0 <= far < best:
            off = -ny * (far * dx - cx) + nx * (far * dy - cy)
            if abs(off) <= index.half_m[k]:
                best, face = far, k
    return face, best
