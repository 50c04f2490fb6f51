"""Flat surfaces of a mesh, and where sheets find room on walls: on one flat surface, beside free
floor, none over another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely import Polygon

from slamsim.core.types import FloatArray, Grid, IntArray, TriangleMesh
from slamsim.world.parts import WALL, Parts

_TRIES = 60
_CHOICE = 6
"""Of so many places that are free the one farthest from all others is taken, so that sheets of a
kind spread over the world (best candidate: Mitchell 1991)."""

_APART_M = 0.02
_UPRIGHT = 1e-6
_BEFORE_M = np.arange(0.1, 0.65, 0.05)
"""So far before a sheet the floor is free and in reach: a camera can look at it from there."""

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Place:
    """A rectangle on a plane: lower left corner and sides, in the plane's coordinates."""

    plane: int
    u_m: float
    v_m: float
    width_m: float
    height_m: float

    @property
    def box(self) -> Polygon:
        return shapely.box(self.u_m, self.v_m, self.u_m + self.width_m, self.v_m + self.height_m)

    @property
    def middle_m(self) -> tuple[float, float]:
        return self.u_m + 0.5 * self.width_m, self.v_m + 0.5 * self.height_m


class WallSpace:
    """The free space on upright walls; what is placed is taken from it."""

    def __init__(self, mesh: TriangleMesh, parts: Parts, surfaces: Surfaces, free: Grid) -> None:
        self._surfaces, self._free = surfaces, free
        corners = mesh.vertices_m[mesh.triangles]
        upright = np.abs(surfaces.normals[surfaces.of_triangle, 2]) < _UPRIGHT
        kept = np.flatnonzero((parts.owners == WALL) & upright)
        self._planes = surfaces.of_triangle[kept]
        self._flat = _flattened(corners[kept], self._planes, surfaces)
        areas = np.asarray(shapely.area(shapely.polygons(self._flat)))
        self._up_to = np.cumsum(areas) / max(float(areas.sum()), 1e-9)
        self._outlines: dict[int, Polygon] = {}
        self._taken: dict[int, list[Polygon]] = {}

    def hang(
        self, size_m: Range, heights_m: Range, others_m: FloatArray, rng: np.random.Generator
    ) -> Place | None:
        """A place for a sheet of (width, height), its middle within a range of heights above the
        floor, and far from (k, 3) others; None where none is found. It is taken from now on."""
        found: list[Place] = []
        for draw in rng.random((_TRIES, 4)) if len(self._planes) else ():
            place = self._drawn(draw, size_m, heights_m)
            if len(found) < _CHOICE and self._has_room(place):
                found.append(place)
        if not found:
            return None
        best = max(found, key=lambda place: _distance(self.middle_m(place), others_m))
        self._taken.setdefault(best.plane, []).append(best.box.buffer(_APART_M, join_style="mitre"))
        return best

    def middle_m(self, place: Place) -> FloatArray:
        """(3,) the middle of a place in the map frame."""
        at, plane = self._surfaces, place.plane
        u, v = place.middle_m
        on_plane = at.offsets_m[plane] * at.normals[plane]
        return np.asarray(on_plane + u * at.u_axes[plane] + v * at.v_axes[plane])

    def _drawn(self, draw: FloatArray, size_m: Range, heights_m: Range) -> Place:
        """By four shares: the triangle, a point in it, and the height."""
        at = min(int(np.searchsorted(self._up_to, draw[0])), len(self._planes) - 1)
        s, t = (draw[1], draw[2]) if draw[1] + draw[2] < 1.0 else (1.0 - draw[1], 1.0 - draw[2])
        a, b, c = self._flat[at]
        u = float((a + s * (b - a) + t * (c - a))[0])
        v = heights_m[0] + float(draw[3]) * (heights_m[1] - heights_m[0])
        corner = u - 0.5 * size_m[0], v - 0.5 * size_m[1]
        return Place(int(self._planes[at]), *corner, *size_m)

    def _has_room(self, place: Place) -> bool:
        box = place.box
        taken = self._taken.get(place.plane, ())
        return (
            not any(other.intersects(box) for other in taken)
            and bool(self._outline(place.plane).contains(box))
            and self._is_seen(place)
        )

    def _outline(self, plane: int) -> Polygon:
        if plane not in self._outlines:
            mine = shapely.polygons(self._flat[self._planes == plane])
            outline = shapely.union_all(mine, grid_size=1e-6)
            shapely.prepare(outline)
            self._outlines[plane] = outline
        return self._outlines[plane]

    def _is_seen(self, place: Place) -> bool:
        """Whether the floor before all of its width is free and in reach."""
        at, free = self._surfaces, self._free
        across = place.width_m * np.linspace(-0.5, 0.5, 2 + int(place.width_m / 0.05))
        middle, plane = self.middle_m(place), place.plane
        points = middle + across[:, None, None] * at.u_axes[plane]
        points = points + _BEFORE_M[:, None] * at.normals[plane]
        cells = np.floor((points[..., :2] - free.origin_m) / free.resolution_m).astype(int)
        column, row = cells[..., 0], cells[..., 1]
        rows, columns = free.occupancy.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return bool(inside.all() and (free.occupancy[row, column] == 0.0).all())


def _flattened(
    corners_m: FloatArray, planes: NDArray[np.int32] | IntArray, surfaces: Surfaces
) -> FloatArray:
    """(t, 3, 2) corners of triangles in the coordinates of their planes."""
    u = np.einsum("tcx,tx->tc", corners_m, surfaces.u_axes[planes])
    v = np.einsum("tcx,tx->tc", corners_m, surfaces.v_axes[planes])
    return np.stack([u, v], axis=-1)


def _distance(point_m: FloatArray, others_m: FloatArray) -> float:
    return float(np.linalg.norm(others_m - point_m, axis=1).min()) if len(others_m) else 0.0


_SAME = 2e-5
"""Planes whose normals differ by less, and whose distances do in metres, are one plane: far above
rounding, far below what is built."""

_LEVEL = 0.9
"""Surfaces whose normal has such a part upward lie: their coordinates are x and y of the map."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """of_triangle: (t,) int32 number of the plane that a triangle lies in.

    normals: (p, 3) unit, outward. u_axes, v_axes: (p, 3) unit, in the plane, right and up to who
    looks at the surface; a point has the coordinates ``point @ u_axis, point @ v_axis`` in metres,
    which run on over all triangles of the plane. offsets_m: (p,) ``point @ normal``.
    """

    of_triangle: NDArray[np.int32]
    normals: FloatArray
    u_axes: FloatArray
    v_axes: FloatArray
    offsets_m: FloatArray


def surfaces_of(mesh: TriangleMesh) -> Surfaces:
    """The planes of a mesh, told apart by side; triangles without area get some plane."""
    normals, offsets_m = _planes(mesh)
    planes = np.column_stack([normals, offsets_m])
    first, numbers = _grouped(planes)
    kept = planes[first]
    u_axes, v_axes = _axes(kept[:, :3])
    return Surfaces(numbers.astype(np.int32), kept[:, :3], u_axes, v_axes, kept[:, 3])


def _planes(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0.0, normals / np.where(lengths > 0.0, lengths, 1.0), (0, 0, 1))
    return normals, np.sum(normals * a, axis=1)


def _grouped(planes: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first row of each group of like planes, and the number of each row's group.

    Rounded first, for a plane may have a million triangles; then what rounding tore is joined.
    """
    rounded = np.rint(planes / (0.5 * _SAME))
    _, first, numbers = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(planes[first]).query_pairs(_SAME, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(first), len(first)))
    labels = connected_components(graph, directed=False)[1]
    _, first_of = np.unique(labels, return_index=True)
    return first[first_of], labels[numbers.ravel()].astype(np.int64)


def _axes(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right and up to who looks against the normal; x and y where the surface lies."""
    right = np.column_stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))])
    lying = np.abs(normals[:, 2]) > _LEVEL
    right = np.where(lying[:, None], (1.0, 0.0, 0.0), right)
    right -= np.sum(right * normals, axis=1, keepdims=True) * normals
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(normals, right)
