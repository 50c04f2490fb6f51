"""The looks of a world, asked where rays hit it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.guard.numbers import BadNumbers, require_array
from slamsim.world.looks.lamps import Lamps, lit_by, radiance_of, shadow_rays
from slamsim.world.looks.materials import MATERIALS, MaterialId
from slamsim.world.looks.paint import Painting, colours_at, decals_at
from slamsim.world.looks.tags import Tag
from slamsim.world.parts import NOTHING

LIFT_M = 1e-3
"""Rays to lamps begin so far above a surface, and end so far before the lamp: single precision
puts points within some 0.01 mm of the surface, and no wall is as thin."""


class Occluded(Protocol):
    """Whether anything lies between."""

    def __call__(
        self, origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
    ) -> BoolArray:
        """(n,) whether rays from (n, 3) points of the map frame along (n, 3) unit directions meet
        anything within (n,) distances."""
        ...


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
