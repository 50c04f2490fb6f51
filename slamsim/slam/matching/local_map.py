"""The surfaces around the robot: a torus of cells, each with a few merged surface pieces.

A cell of the plane lives in slot (ix mod SIDE, iy mod SIDE) of a fixed table and carries its true
index, so that looking up is one step, memory is bounded and what is far away is overwritten.
Merging keeps beams, mean and scatter exactly, as if all points had been fitted at once.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.line_bundle import principal_axis
from slamsim.slam.matching.surfaces import (
    BEAMS,
    HALF_LENGTH,
    MODEL_SIGMA_M,
    NORMAL_X,
    NORMAL_Y,
    PIECE_FIELDS,
    SCATTER_XX,
    SCATTER_XY,
    SCATTER_YY,
    VARIANCE,
    X,
    Y,
)

SIDE = 256
"""Cells along each edge of the torus; surfaces further than half of it are not inserted."""

PER_CELL = 4
LAST_SEEN = PIECE_FIELDS
"""Path length at which a surface was last inserted into, in metres."""

SEEN = PIECE_FIELDS + 1
"""Number of scans merged into a surface."""

MAP_FIELDS = PIECE_FIELDS + 2
MERGE_COS = np.cos(np.deg2rad(25.0))
MERGE_SIGMAS = 4.0
"""Pieces are of one surface if their normals differ by less than 25 degrees, so that rough walls
still merge and corners do not, and if they lie within MERGE_SIGMAS of range noise and a
centimetre."""
SAME_SIDE_COS = np.cos(np.deg2rad(40.0))
"""A piece may be matched to a surface seen at another angle, never to the other side of a thin
wall."""
OVERLAP_SLACK_M = 0.1
"""Beyond its ends a wall usually goes on for so much: pieces are cut by cells, not where walls
end."""


class LocalMap:
    """surfaces: (SIDE * SIDE * PER_CELL, MAP_FIELDS), unused where BEAMS is 0; keys: (.., 2) the
    true index of each cell."""

    def __init__(self, cell_m: float, window_m: float) -> None:
        self.cell_m, self.window_m = cell_m, window_m
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.surfaces = np.zeros((SIDE * SIDE * PER_CELL, MAP_FIELDS))
        self.keys = np.zeros((SIDE * SIDE, 2), dtype=np.int64)
        self.path_m = 0.0
        self.empty = True
        self._last_xy: FloatArray | None = None

    def insert(self, pieces: FloatArray, T_map_base: FloatArray, noise_m: float) -> None:
        """Merge the pieces of one scan, given in the base frame."""
        if self._last_xy is not None:
            self.path_m += float(np.hypot(*(T_map_base[:2] - self._last_xy)))
        self._last_xy = T_map_base[:2].copy()
        _insert(
            pieces,
            T_map_base,
            (self.cell_m, noise_m, self.path_m, self.path_m - self.window_m),
            self.surfaces,
            self.keys,
        )
        self.empty = self.empty and len(pieces) == 0


@kernel
def move_piece(
    piece: FloatArray, T_a_b: tuple[float, float, float, float], moved: FloatArray
) -> None:
    """Fill ``moved`` with a piece of frame b as seen in frame a; T_a_b: x, y, cosine and sine.

    Pieces are (PIECE_FIELDS,).
    """
    x, y, cos, sin = T_a_b
    px, py = piece[X], piece[Y]
    nx, ny = piece[NORMAL_X], piece[NORMAL_Y]
    xx, xy, yy = piece[SCATTER_XX], piece[SCATTER_XY], piece[SCATTER_YY]
    for field in range(PIECE_FIELDS):
        moved[field] = piece[field]
    moved[X], moved[Y] = x + cos * px - sin * py, y + sin * px + cos * py
    moved[NORMAL_X], moved[NORMAL_Y] = cos * nx - sin * ny, sin * nx + cos * ny
    moved[SCATTER_XX] = cos * cos * xx - 2.0 * cos * sin * xy + sin * sin * yy
    moved[SCATTER_XY] = cos * sin * (xx - yy) + (cos * cos - sin * sin) * xy
    moved[SCATTER_YY] = sin * sin * xx + 2.0 * cos * sin * xy + cos * cos * yy


@kernel
def merge_into(piece: FloatArray, surfaces: FloatArray, slot: int) -> None:
    """Pool beams, mean and scatter; the normal keeps its side.

    piece: (PIECE_FIELDS,). surfaces: (s, MAP_FIELDS).
    """
    surface = surfaces[slot]
    a, b = surface[BEAMS], piece[BEAMS]
    total = a + b
    dx, dy = piece[X] - surface[X], piece[Y] - surface[Y]
    share = a * b / total
    surface[SCATTER_XX] += piece[SCATTER_XX] + share * dx * dx
    surface[SCATTER_XY] += piece[SCATTER_XY] + share * dx * dy
    surface[SCATTER_YY] += piece[SCATTER_YY] + share * dy * dy
    surface[X] += dx * b / total
    surface[Y] += dy * b / total
    surface[BEAMS] = total
    nx, ny, least, most = principal_axis(
        surface[SCATTER_XX], surface[SCATTER_XY], surface[SCATTER_YY]
    )
    if nx * surface[NORMAL_X] + ny * surface[NORMAL_Y] < 0.0:
        nx, ny = -nx, -ny
    surface[NORMAL_X], surface[NORMAL_Y] = nx, ny
    surface[HALF_LENGTH] = np.sqrt(3.0 * most / total)
    surface[VARIANCE] = least / total / total + MODEL_SIGMA_M * MODEL_SIGMA_M


@kernel
def _insert(
    pieces: FloatArray,
    T_map_base: FloatArray,
    numbers: tuple[float, float, float, float],
    surfaces: FloatArray,
    keys: IntArray,
) -> None:
    cell_m, noise, now_m, oldest_m = numbers
    cos, sin = np.cos(T_map_base[2]), np.sin(T_map_base[2])
    piece = np.empty(PIECE_FIELDS)
    reach = (SIDE // 2 - 2) * cell_m
    for k in range(pieces.shape[0]):
        px, py = pieces[k, X], pieces[k, Y]
        if max(np.abs(px), np.abs(py)) > 0.7 * reach:
            continue
        move_piece(pieces[k], (T_map_base[0], T_map_base[1], cos, sin), piece)
        _insert_one(piece, (cell_m, noise, now_m, oldest_m), surfaces, keys)


@kernel
def _insert_one(
    piece: FloatArray,
    numbers: tuple[float, float, float, float],
    surfaces: FloatArray,
    keys: IntArray,
) -> None:
    cell_m, noise, now_m, oldest_m = numbers
    ix, iy = int(np.floor(piece[X] / cell_m)), int(np.floor(piece[Y] / cell_m))
    cell = (ix % SIDE) * SIDE + iy % SIDE
    base = cell * PER_CELL
    if keys[cell, 0] != ix or keys[cell, 1] != iy:
        keys[cell, 0], keys[cell, 1] = ix, iy
        for slot in range(base, base + PER_CELL):
            surfaces[slot, BEAMS] = 0.0
    chosen, chosen_off = -1, MERGE_SIGMAS * noise + 0.01
    spare, spare_seen = base, np.inf
    for slot in range(base, base + PER_CELL):
        used = surfaces[slot, BEAMS] > 0.0 and surfaces[slot, LAST_SEEN] >= oldest_m
        seen = surfaces[slot, LAST_SEEN] if used else -np.inf
        if seen < spare_seen:
            spare, spare_seen = slot, seen
        if not used:
            continue
        nx, ny = surfaces[slot, NORMAL_X], surfaces[slot, NORMAL_Y]
        if nx * piece[NORMAL_X] + ny * piece[NORMAL_Y] < MERGE_COS:
            continue
        off = np.abs(nx * (piece[X] - surfaces[slot, X]) + ny * (piece[Y] - surfaces[slot, Y]))
        if off < chosen_off:
            chosen, chosen_off = slot, off
    if chosen >= 0:
        merge_into(piece, surfaces, chosen)
    else:
        chosen = spare
        for field in range(PIECE_FIELDS):
            surfaces[chosen, field] = piece[field]
        surfaces[chosen, SEEN] = 0.0
    surfaces[chosen, LAST_SEEN] = now_m
    surfaces[chosen, SEEN] += 1.0


@kernel
def nearest_surface(
    at: tuple[float, float, float, float],
    half_length: float,
    gate_m: float,
    grid: tuple[FloatArray, IntArray, float, float],
) -> tuple[int, float, bool]:
    """Best partner of a piece at (x, y, normal_x, normal_y) in the map: slot or -1, its signed
    distance along the map's normal, and whether there is any surface nearby at all."""
    surfaces, keys, cell_m, oldest_m = grid
    px, py, nx, ny = at
    ix, iy = int(np.floor(px / cell_m)), int(np.floor(py / cell_m))
    best, best_off, best_cost = -1, 0.0, np.inf
    covered = False
    ring = int(np.ceil(gate_m / cell_m))
    for cx in range(ix - ring, ix + ring + 1):
        for cy in range(iy - ring, iy + ring + 1):
            cell = (cx % SIDE) * SIDE + cy % SIDE
            if keys[cell, 0] != cx or keys[cell, 1] != cy:
                continue
            for slot in range(cell * PER_CELL, (cell + 1) * PER_CELL):
                if surfaces[slot, BEAMS] <= 0.0 or surfaces[slot, LAST_SEEN] < oldest_m:
                    continue
                covered = True
                mx, my = surfaces[slot, NORMAL_X], surfaces[slot, NORMAL_Y]
                if mx * nx + my * ny < SAME_SIDE_COS:
                    continue
                dx, dy = px - surfaces[slot, X], py - surfaces[slot, Y]
                off = mx * dx + my * dy
                beside = np.abs(mx * dy - my * dx)
                beyond = max(0.0, beside - surfaces[slot, HALF_LENGTH] - half_length)
                if np.abs(off) > gate_m or beyond > OVERLAP_SLACK_M:
                    continue
                cost = off * off + 4.0 * beyond * beyond + 0.01 * beside * beside
                if cost < best_cost:
                    best, best_off, best_cost = slot, off, cost
    return best, best_off, covered
