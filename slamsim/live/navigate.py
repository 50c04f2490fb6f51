"""Routes on the map that the robot has made so far: to a place, or to where the map ends."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from slamsim.config.drive import DriveConfig
from slamsim.core.types import BoolArray, FloatArray, Grid
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite
from slamsim.sim.drive.route import Route, route_along
from slamsim.sim.drive.space import NoWay, Space, cheapest_way

_AROUND = np.ones((3, 3), dtype=np.bool_)


def route_to(
    grid: Grid,
    here: FloatArray,
    goal: FloatArray,
    yaw_rad: float | None,
    needed_m: float,
    config: DriveConfig,
) -> Route:
    """Through known free ground. here: (3,) T_map_base. goal: (2,). needed_m: the robot's radius
    with its clearance. Raises NoWay where none leads there, BadNumbers for what is not finite."""
    require_finite("the place to drive to", goal, (2,))
    space, free = _space(grid, here, needed_m)
    targets = np.zeros(free.shape, dtype=np.bool_)
    cell = np.rint((goal - space.origin_m) / space.resolution_m).astype(np.int64)[::-1]
    where = f"({goal[0]:.2f}, {goal[1]:.2f})"
    if (cell < 0).any() or (cell >= free.shape).any() or not free[tuple(cell)]:
        raise NoWay(f"the map does not show free ground at {where}")
    targets[tuple(cell)] = True
    targets = ndimage.binary_dilation(targets, _AROUND, round(needed_m / space.resolution_m))
    way = cheapest_way(space, here[:2], targets, config.route.preferred_clearance_m)
    if way is None:
        raise NoWay(f"no known free path leads to {where}")
    return route_along(way, space, config, yaw_rad)


def route_to_frontier(
    grid: Grid,
    here: FloatArray,
    given_up_m: FloatArray,
    needed_m: float,
    config: DriveConfig,
) -> Route | None:
    """To the nearest place, by the path, where free ground borders on the unknown (Yamauchi 1997);
    None where all that can be reached is known.

    given_up_m: (k, 2) places that showed nothing new when the robot was there.
    """
    try:
        space, _ = _space(grid, here, needed_m)
        targets = _frontiers(grid, space)
        for place in given_up_m:
            cells = np.argwhere(targets)
            near = np.linalg.norm(space.centres_m(cells) - place, axis=1) < needed_m
            targets[tuple(cells[near].T)] = False
        way = cheapest_way(space, here[:2], targets, config.route.preferred_clearance_m)
    except NoWay:
        return None
    return None if way is None else route_along(way, space, config)


def borders_on_unknown(grid: Grid, place_m: FloatArray, within_m: float) -> bool:
    """Whether anything about a place (2,) is still unknown."""
    centre = np.rint((place_m - np.array(grid.origin_m)) / grid.resolution_m - 0.5).astype(np.int64)
    reach = int(np.ceil(within_m / grid.resolution_m))
    padded = np.pad(np.isnan(grid.occupancy), reach, constant_values=True)
    column, row = np.clip(centre, 0, np.array(grid.occupancy.shape)[::-1] - 1).tolist()
    return bool(padded[row : row + 2 * reach + 1, column : column + 2 * reach + 1].any())


def route_end_m(route: Route) -> FloatArray:
    """(2,) where it leads."""
    return np.asarray(route.legs[-1].points_m[-1])


def _space(grid: Grid, here: FloatArray, needed_m: float) -> tuple[Space, BoolArray]:
    """Room about each known free cell, 0 on all others; and which are free."""
    occupied = np.pad(grid.occupancy > grid.OCCUPIED_ABOVE, 1)
    free = np.pad(grid.occupancy < grid.FREE_BELOW, 1)
    away_m = ndimage.distance_transform_edt(~occupied) * grid.resolution_m
    room_m = np.where(free, np.maximum(away_m - 0.5 * grid.resolution_m, 0.0), 0.0)
    origin_m = np.array(grid.origin_m) - 0.5 * grid.resolution_m
    space = Space(room_m, origin_m, grid.resolution_m, needed_m)
    _clear_under_robot(space, here, needed_m)
    return space, free


def _clear_under_robot(space: Space, here: FloatArray, needed_m: float) -> None:
    """Where it stands there is room for it, whatever the map shows: it has to get away."""
    rows, columns = np.indices(space.room_m.shape)
    x_m, y_m = (here[:2] - space.origin_m) / space.resolution_m
    under = np.hypot(columns - x_m, rows - y_m) * space.resolution_m <= needed_m
    space.room_m[under] = np.maximum(space.room_m[under], needed_m)


def _frontiers(grid: Grid, space: Space) -> BoolArray:
    """Cells with room for the robot beside unknown ones, in stretches as long as it is wide."""
    unknown = np.pad(np.isnan(grid.occupancy), 1, constant_values=True)
    edge = (space.room_m >= space.needed_m) & ndimage.binary_dilation(unknown, _AROUND)
    labels, count = ndimage.label(edge, structure=_AROUND)
    if count == 0:
        return np.asarray(edge)
    sizes = ndimage.sum_labels(edge, labels, np.arange(count + 1))
    long_enough = sizes * space.resolution_m >= 2.0 * space.needed_m
    return np.asarray(long_enough[labels] & edge)


def require_map(grid: Grid | None) -> Grid:
    """Raises SlamsimError while there is none."""
    if grid is None:
        raise SlamsimError("there is no map yet; SLAM gives one a second after its first scans")
    return grid
