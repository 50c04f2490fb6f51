"""Where a camera is while it reads an image, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import BoolArray, FloatArray, IntArray

_MOST_ROUNDS = 20
_WITHIN_PX = 1e-7
"""A row is solved for when the pixel moves by less: far below what a float32 image can show."""


@dataclass(frozen=True, slots=True, eq=False)
class RowPoses:
    """``T_map_optical`` of each row of an image, or one for all rows: a global shutter.

    instants_ns: (r,) middle of each row's exposure, true time. origins_m: (r, 3).
    R_map_optical: (r, 3, 3).
    """

    instants_ns: IntArray
    origins_m: FloatArray
    R_map_optical: FloatArray

    def in_view(self, points_m: FloatArray, rows: FloatArray) -> FloatArray:
        """(n, 3) points of the map in the optical frame at the instants of (n,) rows.

        Rows may lie between two, whose positions of a point are then blended; beyond the first
        and the last these count.
        """
        last = len(self.origins_m) - 1
        if last == 0:
            return self._seen_from(points_m, np.zeros(len(points_m), dtype=np.int64))
        inside = np.clip(np.nan_to_num(rows), 0.0, last)
        before = np.minimum(inside.astype(np.int64), last - 1)
        later = (inside - before)[:, None]
        return np.asarray(
            (1.0 - later) * self._seen_from(points_m, before)
            + later * self._seen_from(points_m, before + 1)
        )

    def _seen_from(self, points_m: FloatArray, rows: IntArray) -> FloatArray:
        away = points_m - self.origins_m[rows]
        if len(self.origins_m) == 1:
            return np.asarray(away @ self.R_map_optical[0])
        return np.asarray(np.einsum("ni,nij->nj", away, self.R_map_optical[rows]))


def projected(
    points_m: FloatArray, camera: CameraModel, poses: RowPoses, start_rows: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """(n, 2) pixels of (n, 3) points of the map in an image, and (n,) which have one.

    A row sees a point from where the camera is at its own instant: the row is found by repetition,
    from (n,) ``start_rows`` on. Away from the picture the first and the last row count.
    """
    rows = start_rows
    for _ in range(_MOST_ROUNDS if len(poses.origins_m) > 1 else 1):
        pixels, seen = camera.project(poses.in_view(points_m, rows))
        moved_px = np.abs(pixels[:, 1] - rows)[seen & np.isfinite(pixels[:, 1])]
        rows = pixels[:, 1]
        if moved_px.max(initial=0.0) < _WITHIN_PX:
            break
    return pixels, seen


def optical_flow(
    points_m: FloatArray, hit: BoolArray, camera: CameraModel, following: RowPoses
) -> FloatArray:
    """(h * w, 2) by how many pixels what each pixel sees moves to the following image.

    points_m: (h * w, 3) of the map, which stand still. hit: (h * w,) where there is any; elsewhere,
    and where a point has no image any more, nan. A point may move out of the picture, or behind
    something nearer.
    """
    rows, columns = np.divmod(np.arange(len(points_m)), camera.width)
    there = np.flatnonzero(hit)
    start_rows = rows[there].astype(np.float64)
    pixels, seen = projected(points_m[there], camera, following, start_rows)
    flow = np.full((len(points_m), 2), np.nan)
    here = np.column_stack([columns[there], rows[there]])
    flow[there] = np.where(seen[:, None], pixels - here, np.nan)
    return flow
