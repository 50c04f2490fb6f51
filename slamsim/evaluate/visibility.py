"""Surfaces and floor visible from a path, to which map scores are restricted."""

from __future__ import annotations

import math

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.ray_walk import begin_walk, next_cell
from slamsim.core.types import BoolArray, FloatArray, Grid
from slamsim.guard.numbers import BadNumbers, require_finite

LOOK_EVERY_M = 0.2
"""Spacing of the points of the path from which is looked around."""

LONGEST_PATH_M = 1e7
"""No robot drives so far, but a path with a pose that is off by as much as can be."""

DIRECTIONS = 720
"""Rays in all directions from each of them: 0.5 degrees apart."""


def seen_from(truth: Grid, path_m: FloatArray, range_m: float = math.inf) -> BoolArray:
    """The cells (the grid's shape) that a ray from a point of the path crosses, and the first solid
    one on it.

    truth: 1 solid; all else lets a ray through. path_m: (n, 2) in the grid's frame, in the order
    driven. range_m: rays end there. Looks in all directions, whatever the lidar's own are. Raises
    BadNumbers for a path or a range that is none.
    """
    require_finite("the path", path_m, (None, 2))
    require_range(range_m)
    solid = truth.occupancy == 1.0
    seen: BoolArray = np.zeros(solid.shape, dtype=np.bool_)
    origins = (_spread(path_m, LOOK_EVERY_M) - truth.origin_m) / truth.resolution_m
    angles_rad = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False, dtype=np.float64)
    reach = min(range_m / truth.resolution_m, float(sum(solid.shape)))
    _cast(solid, seen, origins, angles_rad, reach)
    return seen


def require_range(range_m: float) -> None:
    """Raise BadNumbers unless that is how far something may see; ``inf`` is without an end."""
    if not range_m > 0.0:
        raise BadNumbers(f"the range of sight is {range_m} m; it must be above zero")


def _spread(path_m: FloatArray, step_m: float) -> FloatArray:
    """The first point of the path, the last, and one for each step of the way between."""
    if len(path_m) == 0:
        return path_m
    driven_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path_m, axis=0), axis=1))])
    if driven_m[-1] > LONGEST_PATH_M:
        raise BadNumbers(f"the path is {driven_m[-1]:.3g} m long; one of its poses is far off")
    wanted_m = np.arange(0.0, driven_m[-1], step_m)
    pick = np.append(np.searchsorted(driven_m, wanted_m), len(path_m) - 1)
    return np.asarray(path_m[np.unique(pick)])


@kernel
def _cast(
    solid: BoolArray, seen: BoolArray, origins: FloatArray, angles_rad: FloatArray, reach: float
) -> None:
    """Mark in ``seen`` the cells of each ray as far as the first solid one, which ends it; all in
    cells."""
    rows, columns = solid.shape
    for i in range(origins.shape[0]):
        for k in range(angles_rad.shape[0]):
            dx, dy = math.cos(angles_rad[k]), math.sin(angles_rad[k])
            walk = begin_walk(origins[i, 0], origins[i, 1], dx, dy, 1.0)
            while walk.way <= reach and 0 <= walk.column < columns and 0 <= walk.row < rows:
                seen[walk.row, walk.column] = True
                if solid[walk.row, walk.column]:
                    break
                walk = next_cell(walk)
