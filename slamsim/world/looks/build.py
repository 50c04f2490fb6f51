"""Makes the looks of a world from its configuration and seed."""

from __future__ import annotations

import logging

import numpy as np

from slamsim.config.looks import LooksConfig
from slamsim.core.randomness import random_bits, random_stream
from slamsim.core.types import Grid, IntArray, TriangleMesh
from slamsim.world.looks.decals import Decal, decal_table
from slamsim.world.looks.families import draw_finish
from slamsim.world.looks.finishes import Finish, finish_table
from slamsim.world.looks.lamps import hang_lamps
from slamsim.world.looks.looks import Looks
from slamsim.world.looks.paint import Painting
from slamsim.world.looks.places import WallSpace
from slamsim.world.looks.posters import hang_panes, hang_posters
from slamsim.world.looks.surfaces import Surfaces, surfaces_of
from slamsim.world.looks.tags import Tag, hang_tags
from slamsim.world.model import World
from slamsim.world.parts import FLOOR, WALL, Parts

_log = logging.getLogger(__name__)

_WALL_FINISHES = 6
"""As many different walls as a building may have."""

_GRID_M = 0.05
_MOST_CELLS_ACROSS = 4000


def build_looks(world: World, config: LooksConfig) -> Looks:
    """How the world looks; its seed counts unless the looks have their own.

    The triangles are those of ``world.mesh``, then the two of the floor, as casters append it.
    """
    seed = world.seed if config.seed is None else config.seed
    mesh, parts = _with_floor(world)
    surfaces = surfaces_of(mesh)
    finishes, finish_of = _finishes(surfaces, parts, config, seed)
    materials = np.array([finish.material for finish in finishes], dtype=np.uint8)
    free = _free(world)
    tags, decals = _hung(WallSpace(mesh, parts, surfaces, free), surfaces, config, seed)
    painting = Painting(
        *(finish_of, surfaces.of_triangle.astype(np.int64), surfaces.u_axes, surfaces.v_axes),
        *(finish_table(finishes), decal_table(decals, len(surfaces.normals)), config.texture),
    )
    lamps = hang_lamps(free, config.lamps, random_stream(seed, "looks", "lamps"))
    background = np.full(3, 0.6 * config.lamps.ambient, dtype=np.float32)
    owners = parts.owners.astype(np.int32)
    return Looks(
        painting, lamps, tuple(tags), owners, materials[finish_of], parts.kinds, background
    )


def _with_floor(world: World) -> tuple[TriangleMesh, Parts]:
    """With two triangles of floor; how far it reaches is of no account."""
    x_min, y_min, x_max, y_max = world.bounds_m
    corners = np.array([[x, y, 0.0] for x in (x_min, x_max) for y in (y_min, y_max)])
    floor = np.array([[0, 2, 3], [0, 3, 1]]) + len(world.mesh.vertices_m)
    mesh = TriangleMesh(
        np.vstack([world.mesh.vertices_m, corners]),
        np.vstack([world.mesh.triangles, floor]).astype(np.int32),
    )
    owners = np.append(world.parts.owners, [FLOOR, FLOOR]).astype(np.int32)
    return mesh, Parts(owners, world.parts.kinds)


def _finishes(
    surfaces: Surfaces, parts: Parts, config: LooksConfig, seed: int
) -> tuple[list[Finish], IntArray]:
    """All finishes, and the number of each triangle's: that of its thing, or of its plane of wall.

    A plane of wall has one of a few finishes, by chance that depends on where the plane is alone.
    """
    own = [
        draw_finish(config.family, kind, config.split, random_stream(seed, "looks", kind, str(at)))
        for at, kind in enumerate(parts.kinds)
    ]
    walls = [
        draw_finish(
            config.family, "wall", config.split, random_stream(seed, "looks", "walls", str(at))
        )
        for at in range(_WALL_FINISHES)
    ]
    planes = np.rint(1e3 * np.column_stack([surfaces.normals, surfaces.offsets_m])).astype(int)
    chosen = [
        random_bits(seed, "looks", "plane", str(plane)) % _WALL_FINISHES
        for plane in planes.tolist()
    ]
    of_wall = len(own) + np.array(chosen, dtype=np.int64)[surfaces.of_triangle]
    finish_of = np.where(parts.owners == WALL, of_wall, parts.owners)
    return [*own, *walls], finish_of


def _hung(
    space: WallSpace, surfaces: Surfaces, config: LooksConfig, seed: int
) -> tuple[list[Tag], list[Decal]]:
    """Tags first, so that nothing else moves them; then panes, then posters."""
    posters = round(config.texture * config.posters.count)
    tags, sheets = hang_tags(space, surfaces, config.tags, random_stream(seed, "looks", "tags"))
    if len(tags) < config.tags.count:
        _log.warning(
            "only %d of %d tags find room on walls beside free floor: looks.tags.size_m or "
            "height_m do not fit these walls",
            *(len(tags), config.tags.count),
        )
    panes = hang_panes(space, config.panes, random_stream(seed, "looks", "panes"))
    rng = random_stream(seed, "looks", "posters")
    return tags, [*sheets, *panes, *hang_posters(space, config.posters, posters, config.split, rng)]


def _free(world: World) -> Grid:
    """Free floor that the robot can reach, in cells of 5 cm or of what a large world allows."""
    x_min, y_min, x_max, y_max = world.bounds_m
    across = max(x_max - x_min, y_max - y_min)
    return world.obstacle_grid(max(_GRID_M, across / _MOST_CELLS_ACROSS))
