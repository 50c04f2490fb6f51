"""Which part of a world each triangle of its mesh belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from slamsim.core.types import TriangleMesh
from slamsim.guard.numbers import require_array, require_indices
from slamsim.world.prism import Prism

NOTHING, FLOOR, WALL = range(3)
"""Numbers of parts that every world has; things follow."""

_KINDS = ("nothing", "floor", "wall")


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """One piece of clutter: its shape, such as ``table``, and the prisms that it is made of."""

    shape: str
    prisms: tuple[Prism, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """owners: (t,) int32 for each triangle of a mesh, a number in ``kinds``.

    kinds: ``nothing`` (where a ray meets none), ``floor`` (which is not in the mesh), ``wall``,
    then the shape of each thing.
    """

    owners: NDArray[np.int32]
    kinds: tuple[str, ...] = _KINDS

    def __post_init__(self) -> None:
        require_array("the owners of triangles", self.owners, (None,), "i")
        require_indices("the owner of a triangle", self.owners, len(self.kinds))

    @classmethod
    def all_wall(cls, mesh: TriangleMesh) -> Parts:
        """For a mesh of which nothing more is known."""
        return cls(np.full(len(mesh.triangles), WALL, dtype=np.int32))


def parts_of(mesh: TriangleMesh, prisms: Sequence[Prism], things: Sequence[Thing]) -> Parts:
    """The parts of the mesh that ``prism_mesh`` made of these prisms.

    prisms: merged; so what belongs to a thing is told by its heights and by where it stands, for
    things touch neither walls nor each other.
    """
    pieces: dict[tuple[float, float], list[tuple[int, Prism]]] = {}
    for number, thing in enumerate(things, start=len(_KINDS)):
        for prism in thing.prisms:
            pieces.setdefault((prism.z_min_m, prism.z_max_m), []).append((number, prism))
    owners = [_owner(prism, pieces) for prism in prisms]
    corners = [2 * _corners(prism) for prism in prisms]
    of_vertex = np.repeat(np.array(owners, dtype=np.int32), np.array(corners, dtype=np.int64))
    kinds = (*_KINDS, *(thing.shape for thing in things))
    return Parts(of_vertex[mesh.triangles[:, 0]], kinds)


def _owner(prism: Prism, pieces: dict[tuple[float, float], list[tuple[int, Prism]]]) -> int:
    inside = shapely.point_on_surface(prism.footprint)
    for number, piece in pieces.get((prism.z_min_m, prism.z_max_m), ()):
        if piece.footprint.intersects(inside):
            return number
    return WALL


def _corners(prism: Prism) -> int:
    """Of all rings of the footprint, none counted twice."""
    rings = 1 + shapely.get_num_interior_rings(prism.footprint)
    return int(shapely.get_num_coordinates(prism.footprint) - rings)
