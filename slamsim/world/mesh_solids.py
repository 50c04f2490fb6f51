"""Solids from a triangle mesh file, closed or open: its sections and shadows."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import shapely

from slamsim.config.layout import MeshLayout
from slamsim.core.components import components
from slamsim.core.types import BoolArray, FloatArray, IntArray, TriangleMesh
from slamsim.guard.errors import InputRefused
from slamsim.guard.mesh import check_mesh
from slamsim.guard.mesh_file import check_mesh_file
from slamsim.world.prism import outline, polygons_of
from slamsim.world.raster import TOUCH_M

_STRIP_M = 3.0 * TOUCH_M
"""Width of what is added to an edge so that two solids that touch overlap."""


class MeshSolids:
    """A surface that is solid wherever its sections close, and a thin sheet where they do not.

    A closed line with the solid on its left counts as it is, so that cavities stay free and a
    shell that faces inwards is a room; one whose triangles disagree about what is outside is
    filled; an open line has no thickness, and cells that it passes through are solid.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        # Formats such as STL repeat each corner for every triangle.
        points, merged = np.unique(mesh.vertices_m, axis=0, return_inverse=True)
        self._points: FloatArray = points
        triangles = merged.reshape(-1)[mesh.triangles]
        whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        self._triangles: IntArray = triangles[whole]

    def section(self, height_m: float) -> FloatArray:
        segments, edges = self._cut(height_m)
        if len(segments) == 0:
            return segments
        balanced, even = _closed(edges)
        torn = segments[~even]
        filled = polygons_of(
            shapely.polygonize(list(shapely.linestrings(segments[even & ~balanced])))
        )
        return np.concatenate([segments[balanced], torn, torn[:, ::-1], outline(filled)])

    def shadow(self, low_m: float, high_m: float) -> FloatArray:
        """Between two heights there is something above a point if the lower section covers it, or
        else if a part of the surface between them lies above it.

        Polygons as segments (n, 2, 2).
        """
        return np.concatenate([self.section(low_m), self._projection(low_m, high_m)])

    def _cut(self, height_m: float) -> tuple[FloatArray, IntArray]:
        """Segments (n, 2, 2) where a plane cuts triangles, the inside on the left, and the ends of
        each as the two edges of the mesh that they lie on, (n, 2).

        A corner at just the plane's height counts as above it, so that every line closes.
        """
        above = self._points[:, 2] >= height_m
        count = above[self._triangles].sum(axis=1)
        cut = self._triangles[(count == 1) | (count == 2)]
        flags = above[cut]
        is_single = flags == (flags.sum(axis=1) == 1)[:, None]
        single = np.argmax(is_single, axis=1)
        number = np.arange(len(cut))
        a, b, c = (cut[number, (single + step) % 3] for step in range(3))
        ends = np.stack([self._crossing(a, b, height_m), self._crossing(a, c, height_m)], axis=1)
        edges = np.column_stack([_edge_key(a, b), _edge_key(a, c)])
        # Seen from outside a, b, c turn left: from ab to ac the inside is left if a is above.
        turned = ~above[a]
        ends[turned], edges[turned] = ends[turned, ::-1], edges[turned, ::-1]
        return ends, edges

    def _crossing(self, a: IntArray, b: IntArray, height_m: float) -> FloatArray:
        """(n, 2) where the edges cross the plane, the same whichever end comes first."""
        low, high = self._points[np.minimum(a, b)], self._points[np.maximum(a, b)]
        fraction = (height_m - low[:, 2]) / (high[:, 2] - low[:, 2])
        return np.asarray(low[:, :2] + fraction[:, None] * (high[:, :2] - low[:, :2]))

    def _projection(self, low_m: float, high_m: float) -> FloatArray:
        """The outline of the ground below each triangle's part between two heights."""
        heights = self._points[self._triangles, 2]
        near = (heights.max(axis=1) >= low_m) & (heights.min(axis=1) <= high_m)
        corners = self._points[self._triangles[near]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # Triangles whose corners lie on one line cover nothing that their neighbours do not.
        wide = np.linalg.norm(normal, axis=1) > 0.0
        corners, normal = corners[wide], normal[wide]
        owner, points = _clipped(corners, low_m, high_m)
        upright = np.abs(normal[:, 2]) <= 1e-9 * np.linalg.norm(normal, axis=1)
        walls = _wall_strips(normal[:, :2], upright, owner, points)
        flat = ~upright[owner]
        if not flat.any():
            return walls
        number = np.unique(owner[flat], return_inverse=True)[1]
        order = np.argsort(number, kind="stable")
        bags = shapely.multipoints(points[flat][order], indices=number[order])
        # Triangles that only touch the slab leave points and lines, which polygons_of drops.
        return np.concatenate([walls, outline(polygons_of(shapely.convex_hull(bags)))])


def _edge_key(a: IntArray, b: IntArray) -> IntArray:
    """One number for each edge of the mesh."""
    return np.minimum(a, b) * (1 << 32) + np.maximum(a, b)


def _closed(edges: IntArray) -> tuple[BoolArray, BoolArray]:
    """For each segment whether its line closes with all segments running the same way round, and
    whether it closes at all; edges (n, 2) are the nodes that segments lead from and to."""
    nodes, ends = np.unique(edges, return_inverse=True)
    begin, end = ends.reshape(-1, 2).T
    size = len(nodes)
    line_of_node = components(ends.reshape(-1, 2), size)
    leaving, arriving = np.bincount(begin, minlength=size), np.bincount(end, minlength=size)
    lines = int(line_of_node.max()) + 1
    unbalanced = np.bincount(line_of_node, leaving != arriving, lines)
    odd = np.bincount(line_of_node, (leaving + arriving) % 2 == 1, lines)
    line = line_of_node[begin]
    return unbalanced[line] == 0, odd[line] == 0


def _wall_strips(
    normal: FloatArray, upright: BoolArray, owner: IntArray, points: FloatArray
) -> FloatArray:
    """Below an upright triangle lies a line: here a strip just inside it, so that the cell that
    it only touches from outside stays free."""
    is_wall = upright[owner]
    triangles, index = np.unique(owner[is_wall], return_inverse=True)
    if len(triangles) == 0:
        return np.zeros((0, 2, 2))
    outward = normal[triangles] / np.linalg.norm(normal[triangles], axis=1, keepdims=True)
    along = np.column_stack([-outward[:, 1], outward[:, 0]])
    distance = np.einsum("ij,ij->i", points[is_wall], along[index])
    first, last = np.full(len(triangles), np.inf), np.full(len(triangles), -np.inf)
    np.minimum.at(first, index, distance)
    np.maximum.at(last, index, distance)
    away = np.zeros(len(triangles))
    away[index] = np.einsum("ij,ij->i", points[is_wall], outward[index])
    p = first[:, None] * along + away[:, None] * outward
    q = last[:, None] * along + away[:, None] * outward
    inside = -_STRIP_M * outward
    return np.concatenate(
        [
            np.stack(ends, axis=1)
            for ends in ((p, q), (q, q + inside), (q + inside, p + inside), (p + inside, p))
        ]
    )


def _clipped(corners: FloatArray, low_m: float, high_m: float) -> tuple[IntArray, FloatArray]:
    """Which triangle (n, 3, 3) each corner of its part between two heights belongs to, and the
    corner's x and y; the parts are convex, so their corners are enough."""
    heights = corners[:, :, 2]
    kept = (heights >= low_m) & (heights <= high_m)
    owners, points = [np.nonzero(kept)[0]], [corners[kept][:, :2]]
    for height in (low_m, high_m):
        for first, second in ((0, 1), (1, 2), (2, 0)):
            a, b = corners[:, first], corners[:, second]
            crossing = np.flatnonzero((a[:, 2] < height) != (b[:, 2] < height))
            a, b = a[crossing], b[crossing]
            fraction = (height - a[:, 2]) / (b[:, 2] - a[:, 2])
            owners.append(crossing)
            points.append(a[:, :2] + fraction[:, None] * (b[:, :2] - a[:, :2]))
    return np.concatenate(owners), np.concatenate(points)


def read_mesh(layout: MeshLayout) -> TriangleMesh:
    """The file's triangles in metres, z up, the floor at z = 0.

    Raises NotFound, or InputRefused for a file that is damaged, empty or lies under the floor.
    """
    path = Path(layout.file)
    check_mesh_file(path)
    import trimesh

    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numbers that are not finite, which are refused
            loaded = trimesh.load_scene(path, process=False, skip_materials=True).to_mesh()
    except Exception as error:  # trimesh raises whatever a damaged file makes its parsers raise
        raise InputRefused(path, f"cannot be read as a mesh ({error!r:.200})") from None
    vertices = np.array(loaded.vertices, dtype=np.float64) * layout.scale
    triangles = np.array(loaded.faces, dtype=np.int64)
    check_mesh(vertices, triangles, path)
    if layout.up == "y" or (layout.up == "auto" and path.suffix.lower() == ".glb"):
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
    vertices[:, 2] -= layout.floor_m
    if vertices[:, 2].max() <= 0.0:
        top = vertices[:, 2].max()
        raise InputRefused(path, f"ends {-top:g} m below the floor (mesh.floor_m, mesh.up)")
    return TriangleMesh(vertices, triangles.astype(np.int32))
