"""Ray casting against the world's mesh and the floor, in Open3D (Embree)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array, FloatArray, TriangleMesh
from slamsim.guard.errors import SlamsimError
from slamsim.guard.mesh import check_mesh
from slamsim.guard.numbers import (
    BadNumbers,
    require_directions,
    require_finite,
    require_number,
)
from slamsim.sensors.motion import cosines_of_incidence

NOTHING = -1
NO_TRIANGLE = 0xFFFFFFFF


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What (n,) rays met first.

    ranges_m: ``inf`` for nothing. cos_incidence: 1 head-on, 0 grazing or nothing.
    surfaces: number of the flat surface, NOTHING for nothing. triangles: number in the mesh,
    behind which come the two of the floor; NO_TRIANGLE for nothing.
    """

    ranges_m: Float32Array
    cos_incidence: Float32Array
    surfaces: NDArray[np.int32]
    triangles: NDArray[np.uint32]


class Scene:
    """The world as rays see it: ``mesh`` and an endless-looking floor at z = 0.

    The floor is two more triangles, reaching ``floor_reach_m`` beyond the mesh on all sides, so
    that a tilted lidar sees it with the same rules (incidence, mixing) as every wall. Rays are
    given relative to ``origin_m``, the middle of the mesh. Raises InputRefused for a mesh that
    the caster would silently misread: no triangles, numbers not finite, indices out of range.
    """

    def __init__(self, mesh: TriangleMesh, floor_reach_m: float, threads: int = 1) -> None:
        require_number("how far the floor reaches in m", floor_reach_m, 0.0)
        check_mesh(mesh.vertices_m, mesh.triangles, Path("the mesh of the world"))
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        self.origin_m: FloatArray = 0.5 * (low + high)
        vertices, triangles = with_floor(mesh, low - floor_reach_m, high + floor_reach_m)
        self._surfaces = np.append(plane_numbers(vertices, triangles), NOTHING).astype(np.int32)
        self._open3d, self._threads = import_open3d(), threads
        tensor = self._open3d.core.Tensor.from_numpy
        self._caster = self._open3d.t.geometry.RaycastingScene(nthreads=threads)
        self._caster.add_triangles(
            tensor(np.ascontiguousarray(vertices - self.origin_m, dtype=np.float32)),
            tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
        )

    def cast(self, rays: Float32Array) -> Hits:
        """The first hit of (n, 6) rays: origin relative to ``origin_m``, unit direction.

        Raises BadNumbers: the caster takes what is no number for a miss.
        """
        require_finite("rays", rays, (None, 6))
        require_directions("the directions of rays", rays[:, 3:])
        if rays.dtype != np.float32:
            raise BadNumbers(f"rays of single precision are needed, not of {rays.dtype}")
        if len(rays) == 0:
            none = np.zeros(0, dtype=np.uint32)
            return Hits(rays[:, 0], rays[:, 0], none.view(np.int32), none)
        answer = self.answer(rays)
        triangles = answer["primitive_ids"].numpy()
        # The surface table ends with NOTHING: a miss looks up its last entry.
        entries = np.minimum(triangles, np.uint32(self._surfaces.size - 1))
        return Hits(
            answer["t_hit"].numpy(),
            cosines_of_incidence(rays, answer["primitive_normals"].numpy()),
            self._surfaces[entries],
            triangles,
        )

    def answer(self, rays: Float32Array) -> Any:
        """What Open3D says of (n, 6) rays, which are not checked."""
        tensor = self._open3d.core.Tensor.from_numpy(rays)
        return self._caster.cast_rays(tensor, nthreads=self._threads)

    def met(self, rays: Float32Array) -> tuple[Float32Array, Float32Array, NDArray[np.uint32]]:
        """(n,) ranges, (n, 3) normals of some length and (n,) triangles, as for ``cast``.

        For rays of our own making: only that they are finite is checked.
        """
        require_finite("rays", rays, (None, 6))
        answer = self.answer(rays)
        normals = answer["primitive_normals"].numpy()
        return answer["t_hit"].numpy(), normals, answer["primitive_ids"].numpy()

    def occluded(
        self, origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
    ) -> BoolArray:
        """(n,) whether rays from (n, 3) points of the map along (n, 3) unit directions meet
        anything within (n,) distances. Raises BadNumbers for what is not finite."""
        rays = np.empty((len(origins_m), 6), dtype=np.float32)
        _span(rays, origins_m, self.origin_m, directions, distances_m)
        require_finite("rays", rays, (None, 6))
        if len(rays) == 0:
            return np.zeros(0, dtype=np.bool_)
        answer = self._caster.test_occlusions(
            self._open3d.core.Tensor.from_numpy(rays), 0.0, 1.0, self._threads
        )
        return np.asarray(answer.numpy(), dtype=np.bool_)


@kernel
def _span(
    rays: Float32Array,
    origins_m: FloatArray,
    origin_m: FloatArray,
    directions: Float32Array,
    distances_m: Float32Array,
) -> None:
    """Fill (n, 6) rays whose directions are as long as the distances."""
    for ray in range(rays.shape[0]):
        for axis in range(3):
            rays[ray, axis] = origins_m[ray, axis] - origin_m[axis]
            rays[ray, 3 + axis] = directions[ray, axis] * distances_m[ray]


def import_open3d() -> Any:
    """Open3D, or a SlamsimError that names the system packages it lacks."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise SlamsimError(
            f"Open3D could not be loaded ({error}); on Debian and Ubuntu it needs the packages "
            "libegl1 libgl1 libx11-6 libusb-1.0-0"
        ) from error
    return open3d


def with_floor(
    mesh: TriangleMesh, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, NDArray[np.int32]]:
    """(v + 4, 3) vertices and (t + 2, 3) triangles of a mesh and a floor from low to high."""
    corners = np.array(
        [
            [low[0], low[1], 0.0],
            [high[0], low[1], 0.0],
            [high[0], high[1], 0.0],
            [low[0], high[1], 0.0],
        ]
    )
    floor = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32) + np.int32(len(mesh.vertices_m))
    return np.vstack([mesh.vertices_m, corners]), np.vstack([mesh.triangles, floor])


def plane_numbers(vertices: FloatArray, triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(t,) number of the plane of each triangle, as far as rounding lets it be seen."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)
    leading = np.take_along_axis(normals, np.abs(normals).argmax(axis=1)[:, None], axis=1)
    normals = normals * np.where(leading < 0.0, -1.0, 1.0)
    distances = np.sum(normals * a, axis=1, keepdims=True)
    planes = np.rint(np.hstack([normals, distances]) * 1e3).astype(np.int64)
    return np.unique(planes, axis=0, return_inverse=True)[1].ravel()
