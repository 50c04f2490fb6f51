"""What one view of a camera sees at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.appearance import Appearance
from slamsim.cameras.lens import CameraModel
from slamsim.cameras.poses import RowPoses
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.sensors.motion import Motion
from slamsim.sensors.scene import Scene

_LIFT_M = 1e-3
"""So far from a mirror begin the rays that it throws back, so as not to meet it again."""
_FLATTEST = 0.05
"""Cosine of the most grazing incidence by which a pixel's footprint still grows."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Where the (n,) rays of an image end.

    points_m: (n, 3) of the map, 0 for nothing. normals: (n, 3) towards the camera. footprint_m:
    side of a pixel on the surface.
    """

    points_m: FloatArray
    normals: Float32Array
    cos_incidence: Float32Array
    footprint_m: FloatArray


class Sight:
    """What the (n,) rays of an image met first, as the caster tells it.

    rays: (n, 6) with origins relative to origin_m (3,). directions: (n, 3) in the optical frame.
    ranges_m: inf for nothing. normals: (n, 3) of some length and side. triangles: of the mesh.
    """

    def __init__(
        self,
        rays: Float32Array,
        directions: Float32Array,
        origin_m: FloatArray,
        pixel_rad: float,
        met: tuple[Float32Array, Float32Array, NDArray[np.uint32]],
    ) -> None:
        self.rays, self._directions = rays, directions
        self._origin_m, self._pixel_rad = origin_m, pixel_rad
        self.ranges_m, self._normals, self.triangles = met

    @property
    def depths_m(self) -> Float32Array:
        """(n,) along the optical axis, inf for nothing."""
        return np.asarray(self.ranges_m * self._directions[:, 2])

    @property
    def hit(self) -> BoolArray:
        """(n,) whether a ray met anything."""
        return np.isfinite(self.ranges_m)

    @cached_property
    def surface(self) -> Surface:
        """Where the rays end; made when it is first asked for."""
        count = len(self.rays)
        points_m, facing = np.empty((count, 3)), np.empty((count, 3), dtype=np.float32)
        cosines, footprint_m = np.empty(count, dtype=np.float32), np.empty(count)
        _complete(
            *(self.rays, self.ranges_m, self._normals, self._origin_m, self._pixel_rad),
            *(points_m, facing, cosines, footprint_m),
        )
        return Surface(points_m, facing, cosines, footprint_m)


class View:
    """One lens at one place of the robot, with one shutter: what its rays meet.

    T_base_view: 4 x 4, the optical frame. readout_s: from the first row to the last, 0 for all at
    once.
    """

    def __init__(
        self, scene: Scene, camera: CameraModel, T_base_view: FloatArray, readout_s: float
    ) -> None:
        self.camera, self.readout_s = camera, readout_s
        self._scene, self._T_base_view = scene, T_base_view
        self._directions = camera.rays().astype(np.float32)
        rows = camera.height if readout_s > 0.0 else 1
        steps = np.arange(rows) / max(camera.height - 1, 1)
        self._row_ns: IntArray = np.rint(steps * readout_s * 1e9).astype(np.int64)
        self.pixel_rad = float(1.0 / camera.focal_px.mean())

    def poses(
        self,
        motion: Motion,
        instant_ns: int,
        earliest_ns: int,
        T_base_other: FloatArray | None = None,
    ) -> RowPoses:
        """Of each row, the first being taken at an instant; before ``earliest_ns`` the robot is
        where it is then. T_base_other: of what is mounted beside it instead."""
        T_base_view = self._T_base_view if T_base_other is None else T_base_other
        instants_ns = instant_ns + self._row_ns
        inside_ns = np.maximum(instants_ns, earliest_ns)
        R_map_base = matrix_from_xyzw(motion.quats_xyzw_at(inside_ns))
        off_m, turned = T_base_view[:3, 3], T_base_view[:3, :3]
        origins_m = motion.positions_at(inside_ns) + np.einsum("rij,j->ri", R_map_base, off_m)
        return RowPoses(instants_ns, origins_m, np.einsum("rij,jk->rik", R_map_base, turned))

    def aimed(self, poses: RowPoses) -> Float32Array:
        """(n, 6) rays from these poses, origins relative to that of the scene."""
        rays = np.empty((len(self._directions), 6), dtype=np.float32)
        origins_m = poses.origins_m - self._scene.origin_m
        _aim(rays, self._directions, origins_m, poses.R_map_optical, self.camera.width)
        return rays

    def sight(self, poses: RowPoses) -> Sight:
        """What is seen from these poses."""
        rays = self.aimed(poses)
        met = self._scene.met(rays)
        return Sight(rays, self._directions, self._scene.origin_m, self.pixel_rad, met)

    def radiance(self, sight: Sight, appearance: Appearance) -> Float32Array:
        """(n, 3) linear radiance in red, green and blue.

        Mirrors and panes show what is before them, once: a mirror in a mirror is dark.
        """
        radiance = self._radiance(sight, appearance)
        if (mirroring := appearance.mirroring) is None:
            return radiance
        at = sight.surface
        shares = mirroring[appearance.materials(sight.triangles, at.points_m)]
        mirrors = np.flatnonzero(shares > 0.0)
        if mirrors.size == 0:
            return radiance
        seen = self._radiance(self._mirrored(sight, mirrors), appearance)
        radiance[mirrors] += shares[mirrors, None] * seen
        return radiance

    def _mirrored(self, sight: Sight, mirrors: IntArray) -> Sight:
        """What the rays of some pixels meet when they are thrown back."""
        at = sight.surface
        normals, directions = at.normals[mirrors], sight.rays[mirrors, 3:]
        along = np.einsum("ni,ni->n", normals, directions)[:, None]
        rays = np.empty((mirrors.size, 6), dtype=np.float32)
        rays[:, :3] = at.points_m[mirrors] - self._scene.origin_m + _LIFT_M * normals
        rays[:, 3:] = directions - 2.0 * along * normals
        met = self._scene.met(rays)
        return Sight(rays, rays[:, 3:], self._scene.origin_m, self.pixel_rad, met)

    def _radiance(self, sight: Sight, appearance: Appearance) -> Float32Array:
        at = sight.surface
        occluded = self._scene.occluded
        return appearance.shade(at.points_m, at.normals, sight.triangles, at.footprint_m, occluded)


@kernel
def _aim(
    rays: Float32Array,
    directions: Float32Array,
    origins_m: FloatArray,
    rotations: FloatArray,
    width: int,
) -> None:
    rows = origins_m.shape[0]
    for line in range(directions.shape[0] // width):
        row = line if rows > 1 else 0
        turned = rotations[row].astype(np.float32)
        origin = origins_m[row].astype(np.float32)
        for pixel in range(line * width, (line + 1) * width):
            x, y, z = directions[pixel, 0], directions[pixel, 1], directions[pixel, 2]
            rays[pixel, 0] = origin[0]
            rays[pixel, 1] = origin[1]
            rays[pixel, 2] = origin[2]
            rays[pixel, 3] = turned[0, 0] * x + turned[0, 1] * y + turned[0, 2] * z
            rays[pixel, 4] = turned[1, 0] * x + turned[1, 1] * y + turned[1, 2] * z
            rays[pixel, 5] = turned[2, 0] * x + turned[2, 1] * y + turned[2, 2] * z


@kernel
def _complete(
    rays: Float32Array,
    ranges_m: Float32Array,
    normals: Float32Array,
    origin_m: FloatArray,
    pixel_rad: float,
    points_m: FloatArray,
    facing: Float32Array,
    cosines: Float32Array,
    footprint_m: FloatArray,
) -> None:
    for pixel in range(rays.shape[0]):
        far = float(ranges_m[pixel])
        x, y, z = normals[pixel, 0], normals[pixel, 1], normals[pixel, 2]
        squared = float(x * x + y * y + z * z)
        if far == np.inf or squared == 0.0:
            points_m[pixel, 0], points_m[pixel, 1], points_m[pixel, 2] = 0.0, 0.0, 0.0
            facing[pixel, 0], facing[pixel, 1], facing[pixel, 2] = 0.0, 0.0, 0.0
            cosines[pixel], footprint_m[pixel] = 0.0, 0.0
            continue
        scale = 1.0 / np.sqrt(squared)
        dot = scale * (x * rays[pixel, 3] + y * rays[pixel, 4] + z * rays[pixel, 5])
        if dot > 0.0:
            scale = -scale
        facing[pixel, 0], facing[pixel, 1], facing[pixel, 2] = x * scale, y * scale, z * scale
        for axis in range(3):
            along = far * float(rays[pixel, 3 + axis])
            points_m[pixel, axis] = rays[pixel, axis] + along + origin_m[axis]
        cosines[pixel] = abs(dot)
        footprint_m[pixel] = far * pixel_rad / max(abs(dot), _FLATTEST)
