"""A finished map as what a robot can find itself in: surfaces, each once, in one frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.geometry import compose
from slamsim.slam.keyframes import Keyframe
from slamsim.slam.matching.runs import principal_axis
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
from slamsim.slam.submaps import Surfaces, sample_surfaces
from slamsim.slam.views import PIECE_M
from slamsim.types import FloatArray, Grid, IntArray

TILE_M = 8.0
OCCUPIED = 0.65
MIN_CELLS = 2
"""A surface is fitted through so many occupied cells, or not at all."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """surfaces: (m, PIECE_FIELDS) in the map frame. points_m: (n, 2) along all of them. noise_m:
    how far they may be off."""

    surfaces: FloatArray
    points_m: FloatArray
    noise_m: float


def map_of_keyframes(keyframes: Sequence[Keyframe], poses: FloatArray) -> KnownMap:
    """The surfaces that key frames saw, from where the solution has them: poses (n, 3)."""
    noise_m = keyframes[-1].noise_m
    at = compose(poses, np.array([keyframe.T_base_view for keyframe in keyframes]))
    placed = [(one.view.astype(np.float64), T) for one, T in zip(keyframes, at, strict=True)]
    surfaces = merged_surfaces(placed, noise_m)
    return KnownMap(surfaces, sample_surfaces(surfaces), noise_m)


def merged_surfaces(placed: Sequence[tuple[FloatArray, FloatArray]], noise_m: float) -> FloatArray:
    """(m, PIECE_FIELDS) of many (pieces, T_map_pieces), what was seen often only once.

    Merged around one tile of the floor after another, for a table holds so much only; a place that
    was seen from several tiles is taken from the nearest.
    """
    tiles: defaultdict[tuple[int, int], list[tuple[FloatArray, FloatArray]]] = defaultdict(list)
    for pieces, T in placed:
        column, row = np.floor(T[:2] / TILE_M).astype(int).tolist()
        tiles[column, row].append((pieces, T))
    scratch, found, distances = Surfaces(), [np.zeros((0, PIECE_FIELDS))], [np.zeros(0)]
    for (column, row), members in tiles.items():
        scratch.fill(members, noise_m)
        surfaces = scratch.collected()
        middle_m = (np.array([column, row]) + 0.5) * TILE_M
        cells_m = (np.floor(surfaces[:, [X, Y]] / PIECE_M) + 0.5) * PIECE_M
        found.append(surfaces)
        distances.append(np.hypot(*(cells_m - middle_m).T))
    everything = np.concatenate(found)
    return everything[_nearest_of_each_cell(everything[:, [X, Y]], np.concatenate(distances))]


def _nearest_of_each_cell(places_m: FloatArray, distances_m: FloatArray) -> IntArray:
    """Numbers of those in whose cell nothing has a smaller distance."""
    if not len(places_m):
        return np.zeros(0, dtype=np.int64)
    cells = np.floor(places_m / PIECE_M).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    least = np.full(int(cell.max()) + 1, np.inf)
    np.minimum.at(least, cell.ravel(), distances_m)
    return np.flatnonzero(distances_m <= least[cell.ravel()] + 1e-9)


def map_of_grid(grid: Grid) -> KnownMap:
    """The surfaces of an occupancy grid: occupied cells beside free ones, fitted piece by piece.

    A fit takes the cells of one square of a quarter of a metre that face the same way.
    """
    occupied = grid.occupancy > OCCUPIED
    free = grid.occupancy < 1.0 - OCCUPIED
    pieces, points_m = [], []
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = np.zeros_like(free)
        rows, columns = free.shape
        to = np.s_[max(0, -dy) : rows - max(0, dy), max(0, -dx) : columns - max(0, dx)]
        of = np.s_[max(0, dy) : rows + min(0, dy), max(0, dx) : columns + min(0, dx)]
        beside[to] = free[of]
        cells = np.argwhere(occupied & beside)
        places_m = (cells[:, ::-1] + 0.5) * grid.resolution_m + np.array(grid.origin_m)
        pieces.append(_fitted(places_m, (dx, dy), grid.resolution_m))
        points_m.append(places_m)
    return KnownMap(np.concatenate(pieces), np.concatenate(points_m), 0.5 * grid.resolution_m)


def _fitted(places_m: FloatArray, facing: tuple[int, int], resolution_m: float) -> FloatArray:
    """(k, PIECE_FIELDS) through the middles (n, 2) of cells that face free space one way."""
    if not len(places_m):
        return np.zeros((0, PIECE_FIELDS))
    squares = np.floor(places_m / PIECE_M).astype(np.int64)
    _, group = np.unique(squares, axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    bounds = np.flatnonzero(np.diff(group.ravel()[order])) + 1
    fitted = [
        _piece(members, facing, resolution_m)
        for members in np.split(places_m[order], bounds)
        if len(members) >= MIN_CELLS
    ]
    return np.array(fitted).reshape(-1, PIECE_FIELDS)


def _piece(places_m: FloatArray, facing: tuple[int, int], resolution_m: float) -> FloatArray:
    middle = places_m.mean(axis=0)
    off = places_m - middle
    xx, xy, yy = (off[:, 0] ** 2).sum(), (off[:, 0] * off[:, 1]).sum(), (off[:, 1] ** 2).sum()
    nx, ny, least, most = principal_axis(xx, xy, yy)
    side = -1.0 if nx * facing[0] + ny * facing[1] < 0.0 else 1.0
    piece = np.zeros(PIECE_FIELDS)
    piece[[X, Y]], piece[[NORMAL_X, NORMAL_Y]] = middle, (side * nx, side * ny)
    piece[[SCATTER_XX, SCATTER_XY, SCATTER_YY]] = xx, xy, yy
    piece[BEAMS] = len(places_m)
    piece[HALF_LENGTH] = np.sqrt(3.0 * most / len(places_m))
    spread = least / len(places_m) + resolution_m**2 / 12.0
    piece[VARIANCE] = spread / len(places_m) + MODEL_SIGMA_M**2
    return piece
