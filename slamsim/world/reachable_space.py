"""Space that a disc can reach among solids: start and goals for imported worlds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from slamsim.config.world import StartConfig
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M, Bounds
from slamsim.world.prism import Solids
from slamsim.world.raster import Raster, rasterise

_MAX_CELLS = 8_000_000


def given_start(start: StartConfig) -> FloatArray:
    """The configured ``T_map_base`` (3,) as x_m, y_m, yaw_rad."""
    return np.array([start.x_m, start.y_m, math.radians(start.yaw_deg)])


def find_room(
    solids: Solids,
    bounds_m: Bounds,
    clearance_m: float,
    spacing_m: float,
    start: StartConfig | None,
) -> tuple[FloatArray, FloatArray]:
    """A start pose (3,) and (k, 2) places about ``spacing_m`` apart that can be reached from it.

    Reachable is where the middle of a disc of diameter ``clearance_m`` can go within the bounds,
    its distance to solids between 0.01 m and 0.5 m height taken on cells and rounded down. Without
    a given start it is the roomiest spot of the largest connected part, heading along x. Raises
    SlamsimError with the numbers if there is no room, or none at the given start.
    """
    raster = Raster.covering(bounds_m, _resolution(bounds_m, clearance_m))
    solid = rasterise(solids.shadow(BODY_LOW_M, BODY_HIGH_M), raster)
    room = _room(solid, raster.resolution_m)
    labels, _ = ndimage.label(room >= 0.5 * clearance_m)
    if start is not None:
        pose = given_start(start)
        part = _part_of(pose, room, labels, raster, clearance_m)
    else:
        sizes = np.bincount(labels.ravel())
        if len(sizes) < 2:
            raise SlamsimError(
                f"clearance_m {clearance_m:g}: nowhere is there so much room, the widest spot has "
                f"{2.0 * room.max():.3g} m"
            )
        part = labels == 1 + int(np.argmax(sizes[1:]))
        spot = np.argmax(np.where(part, room, -1.0))
        cell = np.array(np.unravel_index(spot, part.shape))[None]
        pose = np.append(raster.centres_m(cell)[0], 0.0)
    return pose, _spread(part, room, raster, spacing_m)


def _resolution(bounds_m: Bounds, clearance_m: float) -> float:
    """Fine enough for the clearance, coarse enough for the memory."""
    return max(min(0.025, clearance_m / 20.0), coarsest_m(bounds_m))


def coarsest_m(bounds_m: Bounds) -> float:
    """The side of the smallest cells that memory suffices for within these bounds."""
    area = (bounds_m[2] - bounds_m[0]) * (bounds_m[3] - bounds_m[1])
    return math.sqrt(area / _MAX_CELLS)


def _room(solid: BoolArray, resolution_m: float) -> FloatArray:
    """A lower bound, in metres, of the distance from the middle of each cell to any solid; what
    lies outside the raster counts as solid."""
    cells = _cells_to_nearest(np.pad(~solid, 1))[1:-1, 1:-1]
    return np.asarray((cells - math.sqrt(0.5)) * resolution_m)


def _cells_to_nearest(free: BoolArray) -> FloatArray:
    """The distance of each cell to the nearest that is not free: bit for bit as by
    ``ndimage.distance_transform_edt(free)``, which holds three times as much at once."""
    away = ndimage.distance_transform_edt(free, return_distances=False, return_indices=True)
    for axis, side in enumerate(free.shape):
        away[axis] -= np.expand_dims(np.arange(side, dtype=away.dtype), 1 - axis)
    squares = np.einsum("kij,kij->ij", away, away, dtype=np.float64)
    return np.asarray(np.sqrt(squares, out=squares))


def _part_of(
    pose: FloatArray,
    room: FloatArray,
    labels: NDArray[np.integer],
    raster: Raster,
    clearance_m: float,
) -> BoolArray:
    row, column = raster.cell_of(pose[None, :2])[0].tolist()
    inside = 0 <= row < raster.rows and 0 <= column < raster.columns
    label = labels[row, column] if inside else 0
    if label == 0:
        have = f"{max(room[row, column], 0.0):.3g} m" if inside else "out of the world, no way"
        raise SlamsimError(
            f"start x_m {pose[0]:g}, y_m {pose[1]:g}: {have} to the nearest solid or border, "
            f"clearance_m {clearance_m:g} needs {0.5 * clearance_m:g} m"
        )
    return np.asarray(labels == label)


def _spread(part: BoolArray, room: FloatArray, raster: Raster, spacing_m: float) -> FloatArray:
    """The roomiest spot of each square block of side ``spacing_m`` that the part reaches into."""
    cells = np.argwhere(part)
    blocks = cells * raster.resolution_m // spacing_m
    order = np.lexsort((-room[part], blocks[:, 1], blocks[:, 0]))
    ordered = blocks[order]
    first = np.append(True, np.any(ordered[1:] != ordered[:-1], axis=1))
    return raster.centres_m(cells[order[first]])
