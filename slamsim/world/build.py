"""From a configuration and a seed to a world."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from shapely import Point

from slamsim.config.world import (
    ImageLayout,
    MazeLayout,
    MeshLayout,
    PlanLayout,
    RoomsLayout,
    StartConfig,
    WorldConfig,
)
from slamsim.safe.errors import SlamsimError
from slamsim.types import FloatArray
from slamsim.world.clutter import place_clutter
from slamsim.world.floor_plan import FloorPlan, grow_maze, grow_rooms
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M, FloorPatch, World
from slamsim.world.panels import check_fit, lay_panels, reserve_ways
from slamsim.world.prism import Prism, merge_prisms, polygons_of, prism_mesh
from slamsim.world.solids import PrismSolids
from slamsim.world.walls import build_walls

__all__ = ["FloorPatch", "World", "build_world"]


def build_world(config: WorldConfig, seed: int) -> World:
    """The world that the configuration describes; ``seed`` counts unless it has its own.

    The same configuration and seed give the same world in every process. Raises SlamsimError
    with the numbers if the sizes do not fit each other or the robot cannot go everywhere, and
    InputRefused or NotFound for the files of an image or a mesh.
    """
    seed = seed if config.seed is None else config.seed
    layout = config.layout
    if isinstance(layout, MazeLayout):
        return _planned_world(grow_maze(layout, config.doors, seed), config, seed)
    if isinstance(layout, RoomsLayout):
        return _planned_world(grow_rooms(layout, seed), config, seed)
    raise NotImplementedError


def _planned_world(plan: FloorPlan, config: WorldConfig, seed: int) -> World:
    check_fit(plan, config)
    panels = lay_panels(plan, config, seed)
    ways = reserve_ways(plan, panels, config)
    walls = build_walls(plan, panels, config, seed)
    clutter = place_clutter(plan, ways, walls, config.clutter, seed)
    prisms = merge_prisms([*walls, *clutter])
    visits = np.array([plan.centre_m(int(cell)) for cell in np.flatnonzero(plan.present)])
    start = np.array([*plan.centre_m(plan.start), _first_way(plan)])
    if config.start is not None:
        _check_start(config.start, Point(start[:2]), prisms, config.clearance_m)
        start = given_start(config.start)
    return _world(config, seed, prisms, start, visits)


def _first_way(plan: FloorPlan) -> float:
    """Heading from the start cell through its first passage, 0 if it has none."""
    row, column = plan.grid.place(plan.start)
    for passage in plan.passages:
        if plan.start in passage:
            to_row, to_column = plan.grid.place(sum(passage) - plan.start)
            return math.atan2(to_row - row, to_column - column)
    return 0.0


def _check_start(
    start: StartConfig, way: Point, prisms: Sequence[Prism], clearance_m: float
) -> None:
    """Raise SlamsimError unless the robot can stand at the start and reach a point of its way."""
    place = Point(start.x_m, start.y_m)
    shadows = [prism.shadow(BODY_LOW_M, BODY_HIGH_M) for prism in prisms]
    room = shapely.distance(shadows, place).min()
    where = f"start x_m {start.x_m:g}, y_m {start.y_m:g}"
    if room < 0.5 * clearance_m:
        raise SlamsimError(
            f"{where}: {room:.3f} m to the nearest solid, clearance_m {clearance_m:g} needs "
            f"{0.5 * clearance_m:g} m"
        )
    blocked = shapely.union_all(shadows).buffer(0.5 * clearance_m - 1e-6)
    everywhere = shapely.box(*shapely.total_bounds([blocked, place])).buffer(1.0)
    free = polygons_of(everywhere.difference(blocked))
    if not any(part.intersects(place) and part.intersects(way) for part in free):
        raise SlamsimError(
            f"{where}: no way of clearance_m {clearance_m:g} leads from there into the world"
        )


def _world(
    config: WorldConfig,
    seed: int,
    prisms: Sequence[Prism],
    start_pose: FloatArray,
    visit_points_m: FloatArray,
) -> World:
    grounds = [prism.shadow(-math.inf, math.inf) for prism in prisms]
    x_min, y_min, x_max, y_max = shapely.total_bounds(grounds).tolist()
    patches = tuple(
        FloorPatch(p.x_m[0], p.y_m[0], p.x_m[1], p.y_m[1], p.friction) for p in config.floor.patches
    )
    return World(
        name=config.name,
        seed=seed,
        mesh=prism_mesh(prisms),
        solids=PrismSolids(prisms),
        floor_friction=config.floor.friction,
        floor_patches=patches,
        start_pose=start_pose,
        bounds_m=(x_min, y_min, x_max, y_max),
        visit_points_m=visit_points_m,
        clearance_m=config.clearance_m,
    )


def given_start(start: StartConfig) -> FloatArray:
    return np.array([start.x_m, start.y_m, math.radians(start.yaw_deg)])
