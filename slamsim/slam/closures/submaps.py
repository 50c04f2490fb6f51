"""Pieces of map: a few consecutive key frames joined rigidly, as the front end saw them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.config.back_end import SubmapConfig
from slamsim.core.geometry import between, transform_points, wrap_angle
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.views import PIECE_M
from slamsim.slam.closures.correlative import LikelihoodGrid, likelihood_grid
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.mapping.raytrace import walk_beam
from slamsim.slam.matching.local_map import LocalMap
from slamsim.slam.matching.surfaces import (
    BEAMS,
    HALF_LENGTH,
    NORMAL_X,
    NORMAL_Y,
    PIECE_FIELDS,
    X,
    Y,
)

SIGMA_M = 0.1
UNKNOWN, FREE, WALL = 0, 1, 2
WALL_MARGIN_M = 0.2
"""Nearer than this to a surface, nothing is called free."""

BEAM_MARGIN_M = 0.3
"""The last stretch of a beam says nothing about what is free."""

_NOWHERE = np.iinfo(np.int64).min // 2
_EVER_M = 1e12
"""A path longer than any: nothing in a submap is ever forgotten."""


@dataclass(frozen=True, slots=True, eq=False)
class Submap:
    """Surfaces in the frame of its anchor, one of its key frames, ``first`` to ``last``.

    surfaces: (m, PIECE_FIELDS), merged. middle_m: (2,) their mean. members: the key frames.
    T_anchor_members: (k, 3). from_path_m, to_path_m: travelled distance. What follows from these
    is made when asked for: a long drive keeps many submaps and looks at few.
    """

    anchor: int
    first: int
    last: int
    surfaces: FloatArray
    middle_m: FloatArray
    members: Sequence[Keyframe]
    T_anchor_members: FloatArray
    from_path_m: float
    to_path_m: float

    @property
    def points_m(self) -> FloatArray:
        """(p, 2) sampled along the surfaces."""
        return sample_surfaces(self.surfaces)

    def away_m(self, points_m: FloatArray) -> FloatArray:
        """(n,) how far points (n, 2) are from the nearest key frame."""
        path_m = self.T_anchor_members[:, :2]
        return np.asarray(np.hypot(*(points_m[:, None] - path_m).transpose(2, 0, 1)).min(axis=1))

    def beams(self) -> tuple[FloatArray, FloatArray]:
        """(b, 2) origins and (b, 2) ends of some beams of the key frames."""
        placed = list(zip(self.T_anchor_members, self.members, strict=True))
        origins = [
            np.broadcast_to(transform_points(T, k.origin_m), k.beams_m.shape) for T, k in placed
        ]
        ends = [transform_points(T, k.beams_m.astype(np.float64)) for T, k in placed]
        return np.concatenate(origins), np.concatenate(ends)


@dataclass(frozen=True, slots=True, eq=False)
class SpaceGrid:
    """state: (rows, cols) of UNKNOWN, FREE or WALL. origin_m: outer corner of cell (0, 0)."""

    state: NDArray[np.uint8]
    origin_m: FloatArray
    resolution_m: float

    def at(self, points_m: FloatArray) -> NDArray[np.uint8]:
        """(n,) the states at points, UNKNOWN outside."""
        cells = np.floor((points_m - self.origin_m) / self.resolution_m).astype(np.int64)
        rows, columns = self.state.shape
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < columns) & (cells[:, 1] < rows)
        found = np.full(len(points_m), UNKNOWN, dtype=np.uint8)
        found[inside] = self.state[cells[inside, 1], cells[inside, 0]]
        return found


class Surfaces:
    """A local map that is filled, read and emptied again and again."""

    def __init__(self) -> None:
        self._map = LocalMap(PIECE_M, _EVER_M)

    def fill(self, pieces: Sequence[tuple[FloatArray, FloatArray]], noise_m: float) -> None:
        """Merge (pieces, T_target_pieces) of several key frames, and nothing else."""
        self._map.keys.fill(_NOWHERE)
        for rows, T_target_pieces in pieces:
            self._map.insert(rows, T_target_pieces, noise_m)

    @property
    def grid(self) -> tuple[FloatArray, IntArray, float, float]:
        """What the matcher's ``align`` reads: as ``LocalMap`` has them, surfaces and keys, the size
        of a cell in metres, and the path from which surfaces count.
        """
        return self._map.surfaces, self._map.keys, self._map.cell_m, -_EVER_M

    def collected(self) -> FloatArray:
        """(m, PIECE_FIELDS) all merged surfaces."""
        return _collect(self._map.surfaces, self._map.keys)


def make_submap(
    keyframes: Sequence[Keyframe], anchor: int, scratch: Surfaces, noise_m: float
) -> Submap:
    """Join consecutive key frames by the front end's poses; anchor: index into the sequence."""
    T_anchor = [between(keyframes[anchor].T_map_base, k.T_map_base) for k in keyframes]
    scratch.fill([(k.pieces, T) for k, T in zip(keyframes, T_anchor, strict=True)], noise_m)
    surfaces = scratch.collected()
    return Submap(
        anchor=keyframes[anchor].index,
        first=keyframes[0].index,
        last=keyframes[-1].index,
        surfaces=surfaces,
        middle_m=surfaces[:, [X, Y]].mean(axis=0) if len(surfaces) else np.zeros(2),
        members=tuple(keyframes),
        T_anchor_members=np.array(T_anchor),
        from_path_m=keyframes[0].path_m,
        to_path_m=keyframes[-1].path_m,
    )


def submap_is_full(keyframes: Sequence[Keyframe], config: SubmapConfig) -> bool:
    """Whether these key frames make a submap of the configured size."""
    travel_m = keyframes[-1].path_m - keyframes[0].path_m
    turns = wrap_angle(np.diff([k.T_map_base[2] for k in keyframes]))
    turned = float(np.abs(turns).sum())
    return (
        travel_m >= config.travel_m
        or turned >= np.deg2rad(config.turn_deg)
        or len(keyframes) >= config.max_keyframes
    )


def sample_surfaces(surfaces: FloatArray) -> FloatArray:
    """(p, 2) three points along each surface."""
    along = np.stack([-surfaces[:, NORMAL_Y], surfaces[:, NORMAL_X]], axis=1)
    half = surfaces[:, HALF_LENGTH, None] * along * (2.0 / 3.0)
    middle = surfaces[:, [X, Y]]
    return np.concatenate([middle - half, middle, middle + half])


def space_grid(submap: Submap, resolution_m: float, radius_m: float) -> SpaceGrid:
    """What the submap's beams found free and where its surfaces are."""
    origins, ends = submap.beams()
    points = submap.points_m
    points = points[np.abs(points).max(axis=1) <= 2.0 * radius_m]
    return space_between(origins, ends, points, resolution_m, radius_m)


def space_between(
    origins: FloatArray,
    ends: FloatArray,
    points: FloatArray,
    resolution_m: float,
    reach_m: float = np.inf,
) -> SpaceGrid:
    """What beams from origins (b, 2) to ends (b, 2) found free, but beside surfaces with points
    (p, 2). reach_m: how far a beam is followed."""
    rays = ends - origins
    length = np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    reach = np.clip(length - BEAM_MARGIN_M, 0.0, reach_m)
    ends = origins + rays * (reach / length)[:, None]
    everything = np.concatenate([ends, origins, points, np.zeros((1, 2))])
    margin = int(np.ceil(WALL_MARGIN_M / resolution_m)) + 1
    first = np.floor(everything.min(axis=0) / resolution_m) - margin
    columns, rows = (np.floor(everything.max(axis=0) / resolution_m) - first + margin + 1).astype(
        np.int64
    )
    state = np.zeros((rows, columns), dtype=np.uint8)
    scale = 1.0 / resolution_m
    _mark_free(state, origins * scale - first, ends * scale - first)
    _mark_walls(state, points * scale - first, WALL_MARGIN_M * scale)
    return SpaceGrid(state, first * resolution_m, resolution_m)


class GridCache:
    """The grids of the submaps used last."""

    def __init__(self, config: SubmapConfig) -> None:
        self._config = config
        self._kept: OrderedDict[tuple[int, int], tuple[LikelihoodGrid, SpaceGrid]] = OrderedDict()

    def of(self, submap: Submap) -> tuple[LikelihoodGrid, SpaceGrid]:
        """The grids of a submap, built if they are not there."""
        members = submap.first, submap.last
        if members in self._kept:
            self._kept.move_to_end(members)
            return self._kept[members]
        size = self._config
        grids = (
            likelihood_grid(submap.points_m, size.resolution_m, SIGMA_M, size.radius_m),
            space_grid(submap, size.resolution_m, size.radius_m),
        )
        self._kept[members] = grids
        if len(self._kept) > size.cached_grids:
            self._kept.popitem(last=False)
        return grids


@kernel
def _collect(surfaces: FloatArray, keys: IntArray) -> FloatArray:
    per_cell = surfaces.shape[0] // keys.shape[0]
    count = 0
    out = np.empty((0, PIECE_FIELDS))
    for fill in range(2):
        if fill == 1:
            out = np.empty((count, PIECE_FIELDS))
            count = 0
        for cell in range(keys.shape[0]):
            if keys[cell, 0] == _NOWHERE:
                continue
            for slot in range(cell * per_cell, (cell + 1) * per_cell):
                if surfaces[slot, BEAMS] > 0.0:
                    for field in range(PIECE_FIELDS if fill == 1 else 0):
                        out[count, field] = surfaces[slot, field]
                    count += 1
    return out


@kernel
def _mark_free(state: NDArray[np.uint8], origins: FloatArray, ends: FloatArray) -> None:
    cells = np.empty((state.shape[0] + state.shape[1] + 1, 2), np.int32)
    for i in range(ends.shape[0]):
        count = walk_beam(origins[i], ends[i], cells)
        for k in range(count):
            state[cells[k, 1], cells[k, 0]] = FREE


@kernel
def _mark_walls(state: NDArray[np.uint8], points: FloatArray, radius: float) -> None:
    reach = int(np.ceil(radius))
    for k in range(points.shape[0]):
        column, row = int(points[k, 0]), int(points[k, 1])
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                dx, dy = c + 0.5 - points[k, 0], r + 0.5 - points[k, 1]
                if dx * dx + dy * dy <= radius * radius:
                    state[r, c] = WALL
