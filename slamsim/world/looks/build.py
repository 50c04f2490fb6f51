"""Makes the looks of a world from its configuration and seed; they are asked where rays hit it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.config.layout import LooksConfig
from slamsim.core.randomness import random_bits, random_stream
from slamsim.core.types import Float32Array, FloatArray, Grid, IntArray, Occluded, TriangleMesh
from slamsim.guard.numbers import BadNumbers, require_array
from slamsim.world.looks.decals import Decal, decal_table
from slamsim.world.looks.families import draw_finish
from slamsim.world.looks.finishes import MATERIALS, Finish, MaterialId, finish_table
from slamsim.world.looks.lamps import Lamps, hang_lamps, lit_by, radiance_of, shadow_rays
from slamsim.world.looks.paint import Painting, colours_at, decals_at
from slamsim.world.looks.places import Surfaces, WallSpace, surfaces_of
from slamsim.world.looks.posters import hang_panes, hang_posters
from slamsim.world.looks.tags import Tag, hang_tags
from slamsim.world.model import World
from slamsim.world.parts import FLOOR, NOTHING, WALL, Parts

_log = logging.getLogger(__name__)

_WALL_FINISHES = 6
"""As many different walls as a building may have."""

_GRID_M = 0.05
"""Of the grid of free floor beside which things are hung: finer than a robot is wide."""
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


LIFT_M = 1e-3
"""Rays to lamps begin so far above a surface, and end so far before the lamp: single precision
puts points within some 0.01 mm of the surface, and no wall is as thin."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """How the triangles of a world look, behind which come the two of the floor.

    All methods take hits as a caster tells them: triangles (n,), any number beyond the last one
    standing for no hit; points_m (n, 3) float64 in the map frame; normals (n, 3) float32, unit,
    towards who looks; footprint_m (n,) or a number, the side of a pixel on the surface. The same
    hits give the same bytes, however they are divided among calls. Raises BadNumbers.

    part_of, material_of: (t + 2,) for each triangle. kinds: of parts, as ``World.parts`` has them.
    background: (3,) linear radiance where a ray meets nothing.
    """

    painting: Painting
    lamps: Lamps
    tags: tuple[Tag, ...]
    part_of: NDArray[np.int32]
    material_of: NDArray[np.uint8]
    kinds: tuple[str, ...]
    background: Float32Array

    def albedo(
        self,
        points_m: FloatArray,
        triangles: NDArray[Any],
        footprint_m: FloatArray | float,
    ) -> Float32Array:
        """(n, 3) linear reflectance in red, green and blue, 0 to 1; 0 for no hit."""
        numbers = self._numbers(triangles)
        require_array("points that rays hit", points_m, (len(numbers), 3))
        sizes = np.broadcast_to(np.asarray(footprint_m, dtype=np.float64), numbers.shape)
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        return colours_at(self.painting, numbers, points, np.ascontiguousarray(sizes))

    def shade(
        self,
        points_m: FloatArray,
        normals: Float32Array,
        triangles: NDArray[Any],
        footprint_m: FloatArray | float,
        occluded: Occluded,
    ) -> Float32Array:
        """(n, 3) linear radiance of matt surfaces; that of the background for no hit.

        1 is a white surface in light of strength 1 (``lamps.brightness``). Mirrors and glass are
        dark but for what they show of the world before them (``mirroring``): that takes a ray more.
        """
        albedo = self.albedo(points_m, triangles, footprint_m)
        require_array("normals", normals, (len(albedo), 3))
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        upright = np.ascontiguousarray(normals, dtype=np.float32)
        hits = np.flatnonzero(self._numbers(triangles) < len(self.part_of))
        points, upright = points[hits], upright[hits]
        lit = lit_by(self.lamps, points, upright)
        hidden = occluded(*shadow_rays(self.lamps, lit, points, upright, LIFT_M))
        radiance = np.tile(self.background, (len(albedo), 1))
        radiance[hits] = radiance_of(self.lamps, lit, hidden, upright, albedo[hits])
        return radiance

    def materials(self, triangles: NDArray[Any], points_m: FloatArray) -> NDArray[np.uint8]:
        """(n,) numbers in ``MATERIALS``: of what hangs there, or else of the surface."""
        numbers = self._numbers(triangles)
        require_array("points that rays hit", points_m, (len(numbers), 3))
        found = self._of_each(self.material_of, numbers, int(MaterialId.NOTHING))
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        decals = decals_at(self.painting, numbers, points)
        hung = decals >= 0
        found[hung] = self.painting.decals.materials[decals[hung]]
        return found

    def instances(self, triangles: NDArray[Any]) -> NDArray[np.int32]:
        """(n,) numbers in ``kinds``: nothing, floor, wall, then each thing."""
        return self._of_each(self.part_of, self._numbers(triangles), NOTHING)

    @property
    def ir_reflectances(self) -> Float32Array:
        """(m,) share of infrared light that each of ``MATERIALS`` throws back."""
        return np.array([material.ir_reflectance for material in MATERIALS], dtype=np.float32)

    @property
    def roughnesses(self) -> Float32Array:
        """(m,) of each of ``MATERIALS``: 1 matt, 0 polished."""
        return np.array([material.roughness for material in MATERIALS], dtype=np.float32)

    @property
    def mirroring(self) -> Float32Array | None:
        """(m,) share of light that each of ``MATERIALS`` throws back as a mirror, that of glass
        being what its surface does; None where neither hangs."""
        shares = [each.ir_reflectance * (each.is_mirror or each.is_glass) for each in MATERIALS]
        found = np.array(shares, dtype=np.float32)
        return found if found[self.painting.decals.materials].any() else None

    def _numbers(self, triangles: NDArray[Any]) -> NDArray[np.int64]:
        require_array("numbers of triangles", triangles, (None,), "iu")
        if triangles.dtype.kind == "i" and triangles.size and triangles.min() < 0:
            raise BadNumbers(f"numbers of triangles begin at 0, not at {triangles.min()}")
        return triangles.astype(np.int64)

    @staticmethod
    def _of_each(table: NDArray[Any], numbers: NDArray[np.int64], none: int) -> NDArray[Any]:
        there = numbers < len(table)
        found = np.full(len(numbers), none, dtype=table.dtype)
        found[there] = table[numbers[there]]
        return found
