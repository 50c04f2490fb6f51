"""An occupancy grid as a map to localise in: what a robot that looked round everywhere would have
seen in it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array, FloatArray, Grid
from slamsim.guard.errors import SlamsimError
from slamsim.models.line_bundle import principal_axis
from slamsim.slam.backend.views import PIECE_M
from slamsim.slam.frontend.keyframes import ABOUT_THERE, MAX_BEAMS, Keyframe
from slamsim.slam.mapping.saved_map import SavedMap
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

OCCUPIED = 0.65
MIN_CELLS = 2
"""A surface is fitted through so many occupied cells, or not at all."""

VIEWS_M = 1.5
"""There is a view in each square of this size that has any floor: three make a submap."""

CLEARANCE_M = 0.2
"""No lidar is nearer to a wall than this."""

NEXT_M = 3.0
"""Views that are farther apart make no submap together."""

REACH_M = 10.0
"""How far one sees in a view; what is farther is seen from the next."""


def map_of_grid(grid: Grid) -> SavedMap:
    """Key frames all over the floor of a grid, each with the surfaces in its line of sight.

    Surfaces are occupied cells beside free ones, fitted piece by piece. Raises SlamsimError for a
    grid in which nothing is seen from anywhere.
    """
    keyframes: list[Keyframe] = []
    surfaces = _surfaces(grid)
    tree = cKDTree(surfaces[:, [X, Y]])
    occupied, known = grid.occupancy > OCCUPIED, np.isfinite(grid.occupancy)
    for place_m in _in_a_row(_places(grid)):
        place = (place_m - np.array(grid.origin_m)) / grid.resolution_m
        beams = _look_round(occupied, known, place, REACH_M / grid.resolution_m, MAX_BEAMS)
        seen = _seen(surfaces, tree, place_m, beams * grid.resolution_m)
        if len(seen):
            beams_m = (beams * grid.resolution_m).astype(np.float32)
            before = keyframes[-1] if keyframes else None
            keyframes.append(_keyframe(before, place_m, seen, beams_m, 0.5 * grid.resolution_m))
    if not keyframes:
        raise SlamsimError("the map has no wall beside free floor: there is nothing to localise in")
    return SavedMap(keyframes, np.array([one.T_map_base for one in keyframes]), [])


def _surfaces(grid: Grid) -> FloatArray:
    """(m, PIECE_FIELDS) in the map frame.

    A fit takes the cells of one square of a quarter of a metre that face the same way.
    """
    occupied = grid.occupancy > OCCUPIED
    free = grid.occupancy < 1.0 - OCCUPIED
    pieces = []
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = np.zeros_like(free)
        rows, columns = free.shape
        to = np.s_[max(0, -dy) : rows - max(0, dy), max(0, -dx) : columns - max(0, dx)]
        of = np.s_[max(0, dy) : rows + min(0, dy), max(0, dx) : columns + min(0, dx)]
        beside[to] = free[of]
        cells = np.argwhere(occupied & beside)
        places_m = (cells[:, ::-1] + 0.5) * grid.resolution_m + np.array(grid.origin_m)
        pieces.append(_fitted(places_m, (dx, dy), grid.resolution_m))
    return np.concatenate(pieces)


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


def _places(grid: Grid) -> FloatArray:
    """(v, 2) of each square of the floor the place that is farthest from what is not free."""
    free = np.pad(grid.occupancy < 1.0 - OCCUPIED, 1)
    clear_m = distance_transform_edt(free)[1:-1, 1:-1] * grid.resolution_m
    cells = np.argwhere(clear_m >= CLEARANCE_M)
    square = np.floor(cells * grid.resolution_m / VIEWS_M).astype(np.int64)
    best = np.lexsort((-clear_m[*cells.T], square[:, 1], square[:, 0]))
    _, first = np.unique(square[best], axis=0, return_index=True)
    middles = cells[best[first], ::-1].astype(np.float64) + 0.5
    return np.asarray(middles * grid.resolution_m + np.array(grid.origin_m))


def _keyframe(
    before: Keyframe | None,
    place_m: FloatArray,
    seen: FloatArray,
    beams_m: Float32Array,
    noise_m: float,
) -> Keyframe:
    """A view from a place, heading along x, as a key frame; before: the one that it follows."""
    T_map_base = np.append(place_m, 0.0)
    step_m = 0.0 if before is None else float(np.hypot(*(place_m - before.T_map_base[:2])))
    return Keyframe(
        index=0 if before is None else before.index + 1,
        stamp_ns=0 if before is None else before.stamp_ns + 1,
        T_map_base=T_map_base,
        T_odom_base=T_map_base,
        information=np.zeros((3, 3)),
        pieces=seen,
        view=seen.astype(np.float32),
        T_base_view=np.zeros(3),
        origin_m=np.zeros(2),
        beams_m=beams_m,
        path_m=step_m if before is None else before.path_m + step_m,
        restart=None if step_m <= NEXT_M else ABOUT_THERE,
        noise_m=noise_m,
    )


def _in_a_row(places_m: FloatArray) -> Iterator[FloatArray]:
    """The places (v, 2), each followed by the nearest that is left."""
    left = np.ones(len(places_m), dtype=np.bool_)
    at = 0
    for _ in range(len(places_m)):
        left[at] = False
        yield places_m[at]
        squared = np.square(places_m - places_m[at]).sum(axis=1)
        at = int(np.argmin(np.where(left, squared, np.inf)))


@kernel
def _look_round(
    occupied: BoolArray, known: BoolArray, place: FloatArray, reach: float, beams: int
) -> FloatArray:
    """(b, 2) ends of those of so many beams that meet an occupied cell, from a place; in cells."""
    ends, count = np.empty((beams, 2)), 0
    rows, columns = occupied.shape
    for beam in range(beams):
        angle = 2.0 * np.pi * beam / beams
        dx, dy, length = np.cos(angle), np.sin(angle), 0.0
        while length < reach:
            length += 0.5
            column, row = (
                int(np.floor(place[0] + length * dx)),
                int(np.floor(place[1] + length * dy)),
            )
            if not (0 <= row < rows and 0 <= column < columns and known[row, column]):
                break
            if occupied[row, column]:
                ends[count, 0], ends[count, 1] = length * dx, length * dy
                count += 1
                break
    return ends[:count]


def _seen(
    pieces: FloatArray, tree: cKDTree, place_m: FloatArray, beams_m: FloatArray
) -> FloatArray:
    """(k, PIECE_FIELDS) those beside the ends of beams that face the place, as seen from it."""
    near: set[int] = set()
    for one in place_m + beams_m:
        near.update(tree.query_ball_point(one, PIECE_M))
    seen: FloatArray = pieces[sorted(near)]
    seen[:, [X, Y]] -= place_m
    facing = (seen[:, [X, Y]] * seen[:, [NORMAL_X, NORMAL_Y]]).sum(axis=1) < 0.0
    found: FloatArray = seen[facing]
    return found
