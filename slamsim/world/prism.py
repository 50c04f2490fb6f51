"""Solids with a flat bottom and top, from which worlds are built, and all solids of a world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from slamsim.core.geometry import transform_points
from slamsim.core.types import FloatArray, TriangleMesh
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import BadNumbers, require_finite, require_number

_MIRRORS = tuple(
    np.array(turn)
    for turn in ([[1, 0], [0, 1]], [[-1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, 1], [1, 0]])
)


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """A footprint drawn up from ``z_min_m`` to ``z_max_m``.

    footprint: polygon in the map frame, in metres, holes allowed. lean_m: how far the top is
    shifted against the bottom in x and y; a leaning footprint must be convex.
    """

    footprint: Polygon
    z_min_m: float
    z_max_m: float
    lean_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        corners_m = shapely.get_coordinates(self.footprint)
        require_finite("the corners of a solid", corners_m, (None, 2))
        for value_m in (*self.lean_m, self.z_min_m, self.z_max_m):
            require_number("the height or lean of a solid in m", value_m)
        if not self.z_min_m < self.z_max_m:
            raise BadNumbers(f"a solid ends above {self.z_min_m:g} m, not at {self.z_max_m:g} m")

    def shift_m(self, height_m: float) -> tuple[float, float]:
        """How far the section at a height is shifted against the bottom."""
        fraction = (height_m - self.z_min_m) / (self.z_max_m - self.z_min_m)
        return fraction * self.lean_m[0], fraction * self.lean_m[1]

    def section(self, height_m: float) -> Polygon:
        """The cut at a height, empty outside ``[z_min_m, z_max_m)``."""
        if not self.z_min_m <= height_m < self.z_max_m:
            return Polygon()
        return _shifted(self.footprint, self.shift_m(height_m))

    def shadow(self, low_m: float, high_m: float) -> Polygon:
        """The ground covered by whatever lies between two heights, empty if nothing does."""
        low_m, high_m = max(low_m, self.z_min_m), min(high_m, self.z_max_m)
        if low_m >= high_m:
            return Polygon()
        if self.lean_m == (0.0, 0.0):
            return self.footprint
        ends = [_shifted(self.footprint, self.shift_m(height)) for height in (low_m, high_m)]
        return shapely.convex_hull(shapely.union_all(ends))


def moved(prism: Prism, pose: FloatArray) -> Prism:
    """The prism turned about the origin by a pose's yaw, then carried to its x and y.

    pose: (3,).
    """
    ground = shapely.transform(prism.footprint, lambda points: transform_points(pose, points))
    lean = transform_points(pose * (0.0, 0.0, 1.0), np.array(prism.lean_m))
    return Prism(ground, prism.z_min_m, prism.z_max_m, (float(lean[0]), float(lean[1])))


def circle(centre_m: tuple[float, float], radius_m: float, corners: int = 24) -> Polygon:
    """A regular polygon inscribed in a circle, a corner on the x axis."""
    for value_m in (*centre_m, radius_m):
        require_number("the place or size of a circle in m", value_m)
    angles = np.arange(corners) * (2.0 * np.pi / corners)
    points = np.column_stack([np.cos(angles), np.sin(angles)]) * radius_m
    return Polygon(points + np.asarray(centre_m))


def _shifted(polygon: Polygon, shift_m: tuple[float, float]) -> Polygon:
    if shift_m == (0.0, 0.0):
        return polygon
    return shapely.transform(polygon, lambda points: points + np.asarray(shift_m))


def oriented_rings(polygon: Polygon) -> list[FloatArray]:
    """(n, 2) corners of each ring, not closed, the solid always on the left when walking along."""
    if polygon.is_empty:
        return []
    polygon = shapely.orient_polygons(polygon)
    return [shapely.get_coordinates(ring)[:-1] for ring in (polygon.exterior, *polygon.interiors)]


def merge_prisms(prisms: Sequence[Prism]) -> list[Prism]:
    """The same solids with upright ones of equal heights united, so that no wall hides inside
    another; the order does not depend on that of the input's heights."""
    groups: dict[tuple[float, float], list[Polygon]] = {}
    merged = [prism for prism in prisms if prism.lean_m != (0.0, 0.0)]
    for prism in prisms:
        if prism.lean_m == (0.0, 0.0):
            groups.setdefault((prism.z_min_m, prism.z_max_m), []).append(prism.footprint)
    for (low, high), footprints in groups.items():
        merged += [Prism(part, low, high) for part in polygons_of(shapely.union_all(footprints))]
    return merged


def polygons_of(geometry: shapely.Geometry) -> list[Polygon]:
    """The polygons of any geometry; points and lines, which have no inside, are left out."""
    parts = shapely.get_parts(geometry)
    return [part for part in parts if isinstance(part, Polygon) and not part.is_empty]


def prism_mesh(prisms: Sequence[Prism]) -> TriangleMesh:
    """All prisms as closed surfaces, every triangle counter-clockwise seen from outside."""
    vertices: list[FloatArray] = []
    triangles: list[FloatArray] = []
    count = 0
    for prism in prisms:
        corners, faces = _surface(prism)
        vertices.append(corners)
        triangles.append(faces + count)
        count += len(corners)
    if not vertices:
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    return TriangleMesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))


def _surface(prism: Prism) -> tuple[FloatArray, FloatArray]:
    """(2n, 3) corners, the bottom ones first, and triangles of one prism."""
    rings = oriented_rings(prism.footprint)
    flat = np.concatenate(rings)
    n = len(flat)
    bottom = np.column_stack([flat, np.full(n, prism.z_min_m)])
    top = np.column_stack([flat + np.asarray(prism.lean_m), np.full(n, prism.z_max_m)])
    first = np.arange(n)
    starts = np.cumsum([0, *(len(ring) for ring in rings[:-1])])
    following = np.concatenate(
        [
            start + np.roll(np.arange(len(ring)), -1)
            for ring, start in zip(rings, starts, strict=True)
        ]
    )
    sides = np.concatenate(
        [
            np.column_stack([first, following, following + n]),
            np.column_stack([first, following + n, first + n]),
        ]
    )
    lid = _triangulated(prism.footprint, flat)
    return np.concatenate([bottom, top]), np.concatenate([sides, lid[:, ::-1], lid + n])


def _triangulated(polygon: Polygon, corners: FloatArray) -> FloatArray:
    """(t, 3) counter-clockwise triangles that fill a polygon, as indices into its corners."""
    pieces = _pieces(polygon)
    points = shapely.get_coordinates(shapely.orient_polygons(pieces)).reshape(-1, 4, 2)[:, :3]
    index = {tuple(corner): at for at, corner in enumerate(corners.tolist())}
    return np.array([[index[tuple(p)] for p in piece] for piece in points.tolist()]).reshape(-1, 3)


def _mirrored(geometry: shapely.Geometry, mirror: FloatArray) -> shapely.Geometry:
    """Twice the same mirror image is the geometry itself."""
    return shapely.transform(geometry, lambda points: points @ mirror)


def _pieces(polygon: Polygon) -> NDArray[Any]:
    """Triangles whose corners are the polygon's.

    GEOS finds no ear in about one in 50,000 polygons with many holes, but does in their mirror
    images, for it takes the holes from left to right.
    """
    for turn in _MIRRORS:
        with suppress(shapely.GEOSException):
            pieces = shapely.constrained_delaunay_triangles(_mirrored(polygon, turn))
            return np.asarray(shapely.get_parts(_mirrored(pieces, turn)))
    corners = shapely.get_num_coordinates(polygon)
    raise SlamsimError(f"an outline of {corners} corners cannot be divided into triangles")


class Solids(Protocol):
    """Outlines are directed segments (n, 2, 2) in the map frame with the solid on the left."""

    def section(self, height_m: float) -> FloatArray:
        """The outline of what a horizontal plane cuts."""
        ...

    def shadow(self, low_m: float, high_m: float) -> FloatArray:
        """The outline of the ground below whatever lies between two heights."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PrismSolids:
    """Solids made of prisms; they may overlap."""

    prisms: Sequence[Prism]

    def section(self, height_m: float) -> FloatArray:
        return outline(prism.section(height_m) for prism in self.prisms)

    def shadow(self, low_m: float, high_m: float) -> FloatArray:
        return outline(prism.shadow(low_m, high_m) for prism in self.prisms)


def outline(polygons: Iterable[Polygon]) -> FloatArray:
    """(n, 2, 2) the borders of polygons as directed segments."""
    rings = [ring for polygon in polygons for ring in oriented_rings(polygon)]
    pieces = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return np.concatenate([np.zeros((0, 2, 2)), *pieces])
