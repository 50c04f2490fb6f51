"""Views: what all scans around a key frame have seen, merged into one.

The pieces of each scan are carried into the base frame of the key frame by the front end's own
relative poses, and those that lie on each other are pooled: beams, mean and scatter stay exact.
A view so holds the information of dozens of scans in about as many pieces as one has.

It stands where all its matches together say that the last of its scans was taken, each carried on
by the odometry: a single match jitters about that, and would shake what odometry says between two
views.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.geometry import between, compose
from slamsim.core.jit import kernel
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.slam.matching.local_map import MERGE_COS, merge_into, move_piece
from slamsim.slam.matching.small import put
from slamsim.slam.matching.surfaces import (
    BEAMS,
    HALF_LENGTH,
    NORMAL_X,
    NORMAL_Y,
    PIECE_FIELDS,
    X,
    Y,
)

PIECE_M = 0.25
"""Length of the surface pieces of a scan, and of the cells in which they are pooled."""

MAX_PIECES = 512
_BUCKETS = 2048
MERGE_SIGMAS = 4.0
MERGE_SLACK_M = 0.01
"""Pieces of one surface: within so many sigmas of the range noise, and what surfaces are uneven by,
as in ``matching/local_map.py``."""


class ViewMaker:
    """Collects the pieces of scan after scan, and gives the view from where the last one stood."""

    def __init__(self) -> None:
        self._pieces = np.zeros((MAX_PIECES, PIECE_FIELDS))
        self._keys = np.zeros((MAX_PIECES, 3), dtype=np.int64)
        self._buckets = np.zeros(_BUCKETS, dtype=np.int64)
        self._count = self._scans = 0
        self._T_map_first = self._T_map_view = np.zeros(3)

    def add(
        self, pieces: FloatArray, T_map_base: FloatArray, step: FloatArray | None, noise_m: float
    ) -> None:
        """One more scan: (k, PIECE_FIELDS) in its base frame. step: (3,) the odometry since the
        scan before, None if that is silent. noise_m: of a range."""
        self._stand(T_map_base, step)
        T_first_base = between(self._T_map_first, T_map_base)
        gate_m = MERGE_SIGMAS * noise_m + MERGE_SLACK_M
        tables = (self._pieces, self._keys, self._buckets)
        self._count = _gather(pieces, T_first_base, gate_m, tables, self._count)

    def take(self) -> tuple[Float32Array, FloatArray]:
        """(m, PIECE_FIELDS) everything since the last view, and (3,) T_map_view; empties."""
        T_view_first = between(self._T_map_view, self._T_map_first)
        view = moved_pieces(self._pieces[: self._count], T_view_first)
        self.clear()
        return view.astype(np.float32), self._T_map_view

    def clear(self) -> None:
        """Forget the scans since the last view."""
        self._buckets.fill(0)
        self._count = self._scans = 0

    def _stand(self, T_map_base: FloatArray, step: FloatArray | None) -> None:
        """The mean of where all matches so far, carried on by the odometry, put the last scan."""
        if self._scans == 0:
            self._T_map_first = T_map_base
        if self._scans == 0 or step is None:
            self._scans, carried = 0, T_map_base
        else:
            carried = compose(self._T_map_view, step)
        self._scans += 1
        self._T_map_view = compose(carried, between(carried, T_map_base) / self._scans)


@kernel
def moved_pieces(pieces: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """(k, PIECE_FIELDS) pieces of frame b as seen in frame a."""
    moved = np.empty_like(pieces)
    at = (T_a_b[0], T_a_b[1], np.cos(T_a_b[2]), np.sin(T_a_b[2]))
    for k in range(pieces.shape[0]):
        move_piece(pieces[k], at, moved[k])
    return moved


@kernel
def _level(half_length_m: float) -> int:
    """Long pieces, of beams far apart, meet in larger cells."""
    level = 0
    size_m = 1.5 * PIECE_M
    while size_m < 2.0 * half_length_m:
        size_m *= 2.0
        level += 1
    return level


@kernel
def _gather(
    pieces: FloatArray,
    T_view_base: FloatArray,
    gate_m: float,
    tables: tuple[FloatArray, IntArray, IntArray],
    count: int,
) -> int:
    """Merge pieces into those of the view, found by their cell in an open hash table."""
    merged, keys, buckets = tables
    at = (T_view_base[0], T_view_base[1], np.cos(T_view_base[2]), np.sin(T_view_base[2]))
    piece = np.empty(PIECE_FIELDS)
    for k in range(pieces.shape[0]):
        move_piece(pieces[k], at, piece)
        level = _level(piece[HALF_LENGTH])
        cell_m = PIECE_M * 2.0**level
        ix, iy = int(np.floor(piece[X] / cell_m)), int(np.floor(piece[Y] / cell_m))
        bucket = (ix * 73856093 ^ iy * 19349663 ^ level * 83492791) % _BUCKETS
        while True:
            slot = buckets[bucket] - 1
            if slot < 0:
                if count < MAX_PIECES:
                    put(piece, merged[count])
                    keys[count, 0], keys[count, 1], keys[count, 2] = ix, iy, level
                    buckets[bucket] = count + 1
                    count += 1
                break
            same = keys[slot, 0] == ix and keys[slot, 1] == iy and keys[slot, 2] == level
            if same and _one_surface(merged[slot], piece, gate_m):
                merge_into(piece, merged, slot)
                break
            bucket = (bucket + 1) % _BUCKETS
    return count


@kernel
def _one_surface(surface: FloatArray, piece: FloatArray, gate_m: float) -> bool:
    nx, ny = surface[NORMAL_X], surface[NORMAL_Y]
    if nx * piece[NORMAL_X] + ny * piece[NORMAL_Y] < MERGE_COS:
        return False
    off = nx * (piece[X] - surface[X]) + ny * (piece[Y] - surface[Y])
    return bool(np.abs(off) < gate_m and surface[BEAMS] > 0.0)
