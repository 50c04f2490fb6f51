"""Depth of one camera as it is seen by the pixels of another beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray


class DepthAlignment:
    """Depth images of one camera in the pixels of another, as librealsense's ``align`` does it.

    Each pixel is a square patch at its depth, which covers all pixels of the other camera from its
    upper left to its lower right corner; of several the nearest counts. T_other_camera: 4 x 4.
    """

    def __init__(self, camera: CameraModel, other: CameraModel, T_other_camera: FloatArray) -> None:
        self._other, self._T = other, T_other_camera
        x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        middles = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        self._corners = [_at_depth_one(camera, middles + off) for off in (-0.5, 0.5)]

    def aligned(self, depths_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(h, w) millimetres along the other's axis of (h, w) along the camera's; 0 for none."""
        there = np.flatnonzero(depths_mm)
        depths_m = depths_mm.ravel()[there] * 1e-3
        ends, far_m = [], np.zeros(there.size)
        for corners in self._corners:
            points_m = corners[there] * depths_m[:, None] @ self._T[:3, :3].T + self._T[:3, 3]
            pixels, seen = self._other.project(points_m)
            ends.append(np.where(seen[:, None], np.rint(pixels), 0.0).astype(np.int64))
            far_m += np.where(seen, 0.5 * points_m[:, 2], -np.inf)
        size = (self._other.height, self._other.width)
        aligned = np.zeros(size, dtype=np.uint16)
        told_mm = np.where(far_m > 0.0, np.rint(1e3 * far_m), 0.0).astype(np.int64)
        _fill(aligned, ends[0], ends[1], told_mm)
        return aligned


def _at_depth_one(camera: CameraModel, pixels: FloatArray) -> FloatArray:
    """(n, 3) where rays of (n, 2) pixels meet the plane at distance one; nan for no ray."""
    rays = camera.rays_at(pixels)
    return np.asarray(rays / rays[:, 2:])


@kernel
def _fill(
    aligned: NDArray[np.uint16], first: IntArray, last: IntArray, depths_mm: IntArray
) -> None:
    rows, columns = aligned.shape
    for patch in range(depths_mm.size):
        depth = depths_mm[patch]
        left, top = first[patch]
        right, bottom = last[patch]
        if not 0 < depth < 65536:
            continue
        for row in range(max(top, 0), min(bottom + 1, rows)):
            for column in range(max(left, 0), min(right + 1, columns)):
                if aligned[row, column] == 0 or depth < aligned[row, column]:
                    aligned[row, column] = depth
