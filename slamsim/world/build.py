"""Builds a world from a configuration and a seed."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np
import shapely
from shapely import Point

from slamsim.config.layout import ImageLayout, MazeLayout, MeshLayout, PlanLayout, RoomsLayout
from slamsim.config.world import StartConfig, WorldConfig
from slamsim.core.types import FloatArray, TriangleMesh
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.world.clutter import place_clutter
from slamsim.world.drawing import read_drawing
from slamsim.world.floor_plan import FloorPlan, grow_maze, grow_rooms, unreachable_cells
from slamsim.world.map_server import image_prisms
from slamsim.world.mesh_solids import MeshSolids, read_mesh
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M, Bounds, FloorPatch, World
from slamsim.world.parts import Parts, parts_of
from slamsim.world.prism import Prism, PrismSolids, Solids, merge_prisms, polygons_of, prism_mesh
from slamsim.world.reachable_space import coarsest_m, find_room, given_start
from slamsim.world.wall_segments import check_fit, lay_panels, reserve_ways
from slamsim.world.walls import build_walls

_log = logging.getLogger(__name__)

USUAL_WIDTHS = 400
"""Buildings of well-known 2-D SLAM recordings are 30 m (Intel lab) to 250 m (MIT Killian Court)
across, for robots that need ways of about 0.6 m: so many of these widths."""

USUAL_HEIGHT_M = 20.0
"""As high as the walls of our own worlds may be: ``walls.height_m``."""


def check_extent(
    layout: ImageLayout | MeshLayout, bounds_m: Bounds, height_m: float, clearance_m: float
) -> None:
    """Warn of a world that is far larger than buildings are, for a robot of this clearance.

    Raises InputRefused for one so large that ways of this clearance cannot be found in it.
    """
    x_m, y_m = bounds_m[2] - bounds_m[0], bounds_m[3] - bounds_m[1]
    told = f"is {x_m:.4g} x {y_m:.4g} m large and {height_m:.4g} m high"
    if coarsest_m(bounds_m) > 0.5 * clearance_m:
        reason = f"{told}: too large to find ways of clearance_m {clearance_m:g} in it"
        raise InputRefused(layout.file, f"{reason}; {_remedy(layout)}")
    if max(x_m, y_m) > USUAL_WIDTHS * clearance_m or height_m > USUAL_HEIGHT_M:
        _log.warning("%s %s, far larger than buildings are; %s", layout.file, told, _remedy(layout))


def _remedy(layout: ImageLayout | MeshLayout) -> str:
    if isinstance(layout, ImageLayout):
        return "check its resolution, which is in metres per pixel"
    return f"if its numbers are millimetres, --set world.mesh.scale={0.001 * layout.scale:g}"


def build_world(config: WorldConfig, seed: int) -> World:
    """The world that the configuration describes; ``seed`` counts unless it has its own.

    The same configuration and seed give the same world in every process. Raises SlamsimError
    with the numbers if the sizes do not fit each other or the robot cannot go everywhere, and
    InputRefused or NotFound for the files of an image or a mesh.
    """
    seed = seed if config.seed is None else config.seed
    layout = config.layout
    if isinstance(layout, ImageLayout):
        return _image_world(layout, config, seed)
    if isinstance(layout, MeshLayout):
        return _mesh_world(layout, config, seed)
    return _planned_world(_plan(layout, config, seed), config, seed)


def check_sizes(config: WorldConfig, seed: int) -> None:
    """Raise SlamsimError, as ``build_world`` would, if sizes do not fit each other.

    Far faster than building; images and meshes are not looked at.
    """
    layout = config.layout
    if not isinstance(layout, ImageLayout | MeshLayout):
        check_fit(_plan(layout, config, seed), config)


def _plan(
    layout: MazeLayout | RoomsLayout | PlanLayout, config: WorldConfig, seed: int
) -> FloorPlan:
    if isinstance(layout, MazeLayout):
        return grow_maze(layout, config.doors, seed)
    if isinstance(layout, RoomsLayout):
        return grow_rooms(layout, seed)
    return read_drawing(layout)


def _image_world(layout: ImageLayout, config: WorldConfig, seed: int) -> World:
    prisms, bounds = image_prisms(layout, config.walls.height_m)
    check_extent(layout, bounds, config.walls.height_m, config.clearance_m)
    return _reachable_world(
        prism_mesh(prisms), PrismSolids(prisms), bounds, layout.visit_spacing_m, config, seed
    )


def _mesh_world(layout: MeshLayout, config: WorldConfig, seed: int) -> World:
    mesh = read_mesh(layout)
    (x_min, y_min), (x_max, y_max) = (
        side.tolist() for side in (mesh.vertices_m[:, :2].min(0), mesh.vertices_m[:, :2].max(0))
    )
    bounds = (x_min, y_min, x_max, y_max)
    check_extent(layout, bounds, float(mesh.vertices_m[:, 2].max()), config.clearance_m)
    return _reachable_world(mesh, MeshSolids(mesh), bounds, layout.visit_spacing_m, config, seed)


def _reachable_world(
    mesh: TriangleMesh,
    solids: Solids,
    bounds: Bounds,
    spacing_m: float,
    config: WorldConfig,
    seed: int,
) -> World:
    """A world whose free space has to be found out."""
    start, visits = find_room(solids, bounds, config.clearance_m, spacing_m, config.start)
    parts = Parts.all_wall(mesh)
    return _world(config, seed, mesh, parts, solids, bounds, start, visits)


def _planned_world(plan: FloorPlan, config: WorldConfig, seed: int) -> World:
    _check_connected(plan)
    check_fit(plan, config)
    panels = lay_panels(plan, config, seed)
    ways = reserve_ways(plan, panels, config)
    walls = build_walls(plan, panels, config, seed)
    clutter = place_clutter(plan, ways, walls, config.clutter, seed)
    prisms = merge_prisms([*walls, *(prism for thing in clutter for prism in thing.prisms)])
    visits = np.array([plan.centre_m(int(cell)) for cell in np.flatnonzero(plan.present)])
    start = np.array([*plan.centre_m(plan.start), _first_way(plan)])
    if config.start is not None:
        _check_start(config.start, Point(start[:2]), prisms, config.clearance_m)
        start = given_start(config.start)
    grounds = [prism.shadow(-math.inf, math.inf) for prism in prisms]
    x_min, y_min, x_max, y_max = shapely.total_bounds(grounds).tolist()
    bounds = (x_min, y_min, x_max, y_max)
    mesh = prism_mesh(prisms)
    parts = parts_of(mesh, prisms, clutter)
    return _world(config, seed, mesh, parts, PrismSolids(prisms), bounds, start, visits)


def _check_connected(plan: FloorPlan) -> None:
    lost = unreachable_cells(plan)
    if lost:
        x, y = plan.centre_m(lost[0])
        raise SlamsimError(
            f"{len(lost)} of {int(plan.present.sum())} cells cannot be reached from the start, one "
            f"at x {x:g} m, y {y:g} m: open a way to them or make them solid (## in plan.drawing)"
        )


def _first_way(plan: FloorPlan) -> float:
    """Heading from the start cell into its first passage, doors last; 0 if it has none."""
    row, column = plan.grid.place(plan.start)
    for passage in sorted(plan.passages, key=lambda passage: passage in plan.doors):
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
    mesh: TriangleMesh,
    parts: Parts,
    solids: Solids,
    bounds: Bounds,
    start_pose: FloatArray,
    visit_points_m: FloatArray,
) -> World:
    patches = tuple(
        FloorPatch(p.x_m[0], p.y_m[0], p.x_m[1], p.y_m[1], p.friction) for p in config.floor.patches
    )
    return World(
        name=config.name,
        seed=seed,
        mesh=mesh,
        parts=parts,
        solids=solids,
        floor_friction=config.floor.friction,
        floor_patches=patches,
        start_pose=start_pose,
        bounds_m=bounds,
        visit_points_m=visit_points_m,
        clearance_m=config.clearance_m,
    )
