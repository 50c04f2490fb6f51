"""Flat surfaces of a mesh, and coordinates on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from slamsim.core.types import FloatArray, TriangleMesh

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
