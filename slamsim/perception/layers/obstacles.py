"""What depth images show to stand in the way: evidence in cells and heights.

As Nav2's voxel layer: each ray clears what it passes and marks where it ends, at its own height, so
that a floor seen below a table does not clear the table top. One image is one piece of evidence for
a cell at a height, and hits win, as for scans (``slam.mapping.raytrace``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.config.slam import LayersConfig, MappingConfig
from slamsim.core.jit import kernel
from slamsim.core.layers import ObstacleLayer
from slamsim.core.ray_walk import begin_walk, evidence_weights, held_at, next_cell
from slamsim.core.types import BoolArray, Float32Array, FloatArray, Grid

RAYS_ACROSS = 106
"""Of an image so many columns are looked at: at 4 m and 87 degrees one for each 7 cm. Of rows twice
as many: the edge of a table top is 3 cm high."""
_SIGMAS = 3.0
"""Above the floor by so many standard deviations something is no noise."""


class ObstacleGrid:
    """Evidence in the cells of a map.

    grid: gives geometry alone. config: of the map, with its layers.
    """

    def __init__(self, grid: Grid, config: MappingConfig) -> None:
        layers = config.layers
        heights = max(int(np.ceil((layers.highest_m - layers.lowest_m) / layers.step_m)), 1)
        shape = (*grid.occupancy.shape, heights)
        self._grid, self._layers = grid, layers
        self._log_odds: Float32Array = np.zeros(shape, np.float32)
        self._seen: NDArray[np.int32] = np.zeros(shape, np.int32)
        self._images = 0
        self._weights = evidence_weights(
            config.hit_probability,
            config.miss_probability,
            config.min_probability,
            config.max_probability,
        )
        self._views: list[FloatArray] = []
        self._half_angle_rad = 0.0

    def draw(self, depth_m: Float32Array, K: FloatArray, T_map_camera: FloatArray) -> None:
        """Enter one image; depth_m: (h, w), nan for none. T_map_camera: (4, 4), optical, z up."""
        points, is_hit = hits_of(depth_m, K, T_map_camera, self._layers)
        self._images += 1
        self._half_angle_rad = float(np.arctan2(depth_m.shape[1] / 2.0, K[0, 0]))
        ahead = T_map_camera[:3, 2]
        self._views.append(np.array([*T_map_camera[:2, 3], np.arctan2(ahead[1], ahead[0])]))
        scale = 1.0 / self._grid.resolution_m
        origin = np.append((T_map_camera[:2, 3] - self._grid.origin_m) * scale, T_map_camera[2, 3])
        ends = np.column_stack([(points[:, :2] - self._grid.origin_m) * scale, points[:, 2]])
        heights_m = np.array([self._layers.lowest_m, self._layers.highest_m, self._layers.step_m])
        _enter(
            *(self._log_odds, self._seen, self._images, origin, ends, is_hit),
            *(heights_m, self._weights),
        )

    def layer(self) -> ObstacleLayer:
        """A cell is as sure to be occupied as the surest of its heights; free where no height is
        occupied and some are cleared."""
        worst = self._log_odds.max(axis=2)
        cleared = self._log_odds.min(axis=2)
        known = np.where(worst > 0.0, worst, cleared)
        occupancy = np.where(known == 0.0, np.nan, 1.0 / (1.0 + np.exp(-known)))
        grid = Grid(occupancy.astype(np.float32), self._grid.resolution_m, self._grid.origin_m)
        views = np.array(self._views).reshape(-1, 3)
        return ObstacleLayer(grid, views, self._half_angle_rad, self._layers.max_depth_m)


def hits_of(
    depth_m: Float32Array, K: FloatArray, T_map_camera: FloatArray, config: LayersConfig
) -> tuple[FloatArray, BoolArray]:
    """(n, 3) points of a thinned image in the map, and whether each stands in the way.

    A point of the floor lies above it by the error of its depth along the ray's slope, and by
    tilt times distance; only what rises above three standard deviations of these is a hit.
    """
    step = max(depth_m.shape[1] // RAYS_ACROSS, 1)
    down = max(step // 2, 1)
    v, u = np.mgrid[down // 2 : depth_m.shape[0] : down, step // 2 : depth_m.shape[1] : step]
    depths = depth_m[v, u].astype(np.float64)
    there = np.isfinite(depths) & (depths > 0.0) & (depths <= config.max_depth_m)
    there &= ~_beside_edge(depth_m, v, u, config)
    z = depths[there]
    rays = np.column_stack(
        [(u[there] - K[0, 2]) / K[0, 0], (v[there] - K[1, 2]) / K[1, 1], np.ones(z.size)]
    )
    directions = rays @ T_map_camera[:3, :3].T
    points = T_map_camera[:3, 3] + z[:, None] * directions
    noise_m = config.depth_noise_per_m * z * z * np.abs(directions[:, 2])
    tilt_m = np.radians(config.tilt_deg) * z
    floor_m = config.lowest_m + _SIGMAS * np.hypot(noise_m, tilt_m / 2.0)
    return points, (points[:, 2] > floor_m) & (points[:, 2] < config.highest_m)


def _beside_edge(
    depth_m: Float32Array,
    v: NDArray[np.int64],
    u: NDArray[np.int64],
    config: LayersConfig,
) -> BoolArray:
    """Pixels between near and far, which are on neither (flying pixels): the depths to both sides,
    or above and below, differ by far more than noise, and this one lies between them."""
    here, found = depth_m[v, u], np.zeros(v.shape, dtype=np.bool_)
    allowed_m = 10.0 * config.depth_noise_per_m * here * here + 0.02
    for dv, du in ((1, 0), (0, 1)):
        before = depth_m[np.maximum(v - dv, 0), np.maximum(u - du, 0)]
        after_v = np.minimum(v + dv, depth_m.shape[0] - 1)
        after = depth_m[after_v, np.minimum(u + du, depth_m.shape[1] - 1)]
        low, high = np.minimum(before, after), np.maximum(before, after)
        found |= (here - low > allowed_m) & (high - here > allowed_m)
    return found


@kernel
def _enter(
    log_odds: Float32Array,
    seen: NDArray[np.int32],
    mark: int,
    origin: FloatArray,
    ends: FloatArray,
    is_hit: BoolArray,
    heights_m: FloatArray,
    weights: FloatArray,
) -> None:
    """One image, in place. log_odds, seen: (rows, cols, heights). origin, ends: (x, y) in units of
    cells and z in metres. heights_m: lowest, highest, step. weights: hit, miss, lowest, highest."""
    rows, columns, levels = log_odds.shape
    lowest, highest, step = heights_m
    for i in range(ends.shape[0]):
        column, row = int(np.floor(ends[i, 0])), int(np.floor(ends[i, 1]))
        inside = 0 <= column < columns and 0 <= row < rows
        if is_hit[i] and inside:
            level = min(max(int((ends[i, 2] - lowest) / step), 0), levels - 1)
            if seen[row, column, level] != mark:
                seen[row, column, level] = mark
                raised = log_odds[row, column, level] + weights[0]
                log_odds[row, column, level] = min(raised, weights[3])
    for i in range(ends.shape[0]):
        dx, dy = ends[i, 0] - origin[0], ends[i, 1] - origin[1]
        last_column, last_row = int(np.floor(ends[i, 0])), int(np.floor(ends[i, 1]))
        walk = begin_walk(origin[0], origin[1], dx, dy, 1.0)
        count = abs(last_column - walk.column) + abs(last_row - walk.row)
        for _ in range(count):  # up to, and without, the cell in which the ray ends
            column, row, way = walk.column, walk.row, walk.way
            walk = next_cell(held_at(walk, last_column, last_row))
            z = origin[2] + 0.5 * (way + walk.way) * (ends[i, 2] - origin[2])
            if 0 <= column < columns and 0 <= row < rows and lowest <= z < highest:
                level = min(int((z - lowest) / step), levels - 1)
                if seen[row, column, level] != mark:
                    seen[row, column, level] = mark
                    lowered = log_odds[row, column, level] + weights[1]
                    log_odds[row, column, level] = max(lowered, weights[2])
