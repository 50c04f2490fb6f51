"""The flat surfaces that beams meet: one side of a wall, of a barrel, the floor.

Triangles that share an edge and a plane are one surface; what hangs together by corners is one
body. Two walls in one line are two surfaces, and so are the two faces of one wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamsim.core.components import components
from slamsim.core.types import Float32Array, FloatArray, IntArray, TriangleMesh
from slamsim.io.parquet.file import Cells, Column, ParquetFile, split_axes
from slamsim.sensors.scene import plane_numbers, with_floor

NO_SURFACE = 0xFFFF
"""What beams that met nothing, or a surface beyond the first 65,535, have for a surface."""

_WELD_M = 1e-6
_UPRIGHT = 0.1
"""Largest vertical part of the normal of a side."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueSurfaces:
    """All surfaces of a world, the floor last.

    of_triangle: (t + 2,) surface of each triangle of the mesh and of the floor's two. bodies: (s,)
    which solid it belongs to, -1 the floor. normals: (s, 3) unit, outward. low_m, high_m: (s, 3)
    corners of its box. areas_m2: (s,).
    """

    of_triangle: IntArray
    bodies: IntArray
    normals: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    areas_m2: FloatArray

    def __len__(self) -> int:
        return int(self.areas_m2.size)

    def of_beams(self, triangles: NDArray[np.uint32]) -> IntArray:
        """The surface of each triangle that a beam met, -1 for none; same shape."""
        table = np.append(self.of_triangle, -1)
        return np.asarray(table[np.minimum(triangles, np.uint32(table.size - 1))])

    def met(self, triangles: NDArray[np.uint32]) -> NDArray[np.uint16]:
        """The surface of each triangle that a beam met, NO_SURFACE for none; same shape."""
        table = np.append(np.minimum(self.of_triangle, NO_SURFACE), NO_SURFACE).astype(np.uint16)
        return np.asarray(table[np.minimum(triangles, np.uint32(table.size - 1))])


def surfaces_of(mesh: TriangleMesh, floor_reach_m: float) -> TrueSurfaces:
    """The surfaces of a world as a lidar of this reach sees it."""
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    vertices, triangles = with_floor(mesh, low - floor_reach_m, high + floor_reach_m)
    welded = np.unique(np.rint(vertices / _WELD_M), axis=0, return_inverse=True)[1].ravel()
    corners = welded[triangles]
    sharing = _shared_edges(corners, plane_numbers(vertices, triangles))
    of_triangle = _renumbered(components(sharing, len(corners)))
    count = int(of_triangle.max()) + 1
    first = np.unique(of_triangle, return_index=True)[1]
    doubled_areas = _crosses(vertices, triangles)
    summed = np.stack([np.bincount(of_triangle, doubled_areas[:, i]) for i in range(3)], axis=1)
    lengths = np.linalg.norm(summed, axis=1, keepdims=True)
    bodies = _bodies(corners)[first]
    points, owners = vertices[triangles].reshape(-1, 3), np.repeat(of_triangle, 3)
    low_m, high_m = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low_m, owners, points)
    np.maximum.at(high_m, owners, points)
    bodies[-1] = -1
    return TrueSurfaces(
        of_triangle,
        bodies,
        np.divide(summed, lengths, out=np.zeros_like(summed), where=lengths > 0.0),
        low_m,
        high_m,
        np.asarray(0.5 * np.bincount(of_triangle, np.linalg.norm(doubled_areas, axis=1))),
    )


def write_surfaces(path: Path, surfaces: TrueSurfaces, sequence: int) -> None:
    """``surfaces.parquet``: row n describes surface n."""
    floor = surfaces.bodies < 0
    upright = np.abs(surfaces.normals[:, 2]) < _UPRIGHT
    kinds = np.where(floor, "floor", np.where(upright, "side", "top or underside"))
    cells: dict[str, Cells] = {
        "surface": np.arange(len(surfaces), dtype=np.uint32),
        "kind": kinds.tolist(),
        "body": surfaces.bodies.astype(np.int32),
        "area_m2": surfaces.areas_m2,
        **split_axes(
            {
                "normal_{}": surfaces.normals,
                "low_{}_m": surfaces.low_m,
                "high_{}_m": surfaces.high_m,
            }
        ),
    }
    columns = [
        Column("surface", "uint32"),
        Column("kind", "string", "side, top or underside, floor"),
        Column("body", "int32", "solids that touch are one body; -1 the floor"),
        *(Column(name, "float64") for name in cells if name.endswith(("_m2", "_m"))),
        *(Column(f"normal_{axis}", "float64", "outward") for axis in "xyz"),
    ]
    facts = {"table": "surfaces", "frame": "map"}
    with ParquetFile(path, columns, facts, sequence=sequence) as file:
        file.append(cells)


def _shared_edges(corners: IntArray, planes: IntArray) -> IntArray:
    """(p, 2) pairs of triangles of one plane that share an edge."""
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owners = np.repeat(np.arange(len(corners)), 3)
    keys = np.column_stack([edges, planes[owners]])
    order = np.lexsort(keys.T)
    same = np.all(keys[order][1:] == keys[order][:-1], axis=1)
    return np.column_stack([owners[order][1:][same], owners[order][:-1][same]])


def _renumbered(groups: IntArray) -> IntArray:
    """The same groups, numbered in the order of their first members."""
    _, first, numbers = np.unique(groups, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[numbers.ravel()])


def _bodies(corners: IntArray) -> IntArray:
    """(t,) number of the body of each triangle: those that share corners."""
    sides = np.concatenate([corners[:, :2], corners[:, 1:]])
    return _renumbered(components(sides, int(corners.max()) + 1)[corners[:, 0]])


def _crosses(vertices: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a))


def rounded(values: Float32Array, bits: int) -> Float32Array:
    """The nearest multiples of 2^-bits: float32 that compresses, for the rest of each is zero.

    Of any shape.
    """
    step = np.float32(2**bits)
    return np.asarray(np.rint(values * step) / step)
