"""The occupancy grid: where the beams of all scans passed and where they ended."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from slamsim.config.slam import MappingConfig
from slamsim.core.geometry import transform_points, wrap_angle
from slamsim.core.progress import Progress, silent
from slamsim.core.ray_walk import evidence_weights
from slamsim.core.types import (
    BoolArray,
    Cloud,
    Float32Array,
    FloatArray,
    Grid,
    IntArray,
    PlanarTrajectory,
    ScanSource,
)
from slamsim.guard.errors import SlamsimError
from slamsim.slam.backend.correction import densify
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.mapping.raytrace import update_log_odds


def build_grid(
    scans: ScanSource,
    trajectory: PlanarTrajectory,
    T_base_laser: FloatArray,
    config: MappingConfig,
    motion: PlanarTrajectory | None = None,
    progress: Progress = silent,
    earlier: Iterable[tuple[Cloud, FloatArray]] = (),
) -> Grid:
    """Log-odds occupancy grid of the scans whose stamps are in the trajectory.

    trajectory: ``T_map_base`` at scan stamps. T_base_laser: (4, 4). motion: ``T_odom_base`` with
    the motion between the scans; without it they are joined by straight lines. Beams are placed
    by their own instants. earlier: clouds and where they were seen from, of other drives. Memory is
    that of the map. Raises SlamsimError if the map would be
    larger than ``config.max_cells`` or if there is nothing to draw.
    """
    if not len(trajectory):
        raise SlamsimError("there is nothing to map: no scan has a pose")
    fine = trajectory if motion is None else densify(trajectory, motion)
    poses = dict(zip(trajectory.stamps_ns.tolist(), trajectory.poses, strict=True))
    used = _stamps_to_use(trajectory, config)
    canvas = Canvas(config)
    for cloud, T_map_base in earlier:
        canvas.draw(cloud, T_map_base)
    for number, scan in enumerate(scans):
        progress(number + 1, len(scans))
        known = scan.within(int(fine.stamps_ns[0]), int(fine.stamps_ns[-1]))
        if known is not None and scan.stamp_ns in used:
            cloud = deskew(known, fine, scan.stamp_ns, T_base_laser)
            canvas.draw(cloud, poses[scan.stamp_ns])
    return canvas.grid()


def _stamps_to_use(trajectory: PlanarTrajectory, config: MappingConfig) -> set[int]:
    """Stamps of the scans at which the robot had moved enough since the last one used."""
    if config.min_travel_m == 0.0 and config.min_turn_deg == 0.0:
        return set(trajectory.stamps_ns.tolist())
    steps = np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1)
    turns = np.abs(wrap_angle(np.diff(trajectory.poses[:, 2])))
    progress = np.cumsum(
        steps / max(config.min_travel_m, 1e-9) + turns / max(np.deg2rad(config.min_turn_deg), 1e-9)
    )
    bins = np.floor(np.concatenate([[0.0], progress]))
    first = np.concatenate([[True], np.diff(bins) > 0.0])
    return set(trajectory.stamps_ns[first].tolist())


class Canvas:
    """A grid of log odds that grows where it is drawn upon.

    Cells lie on multiples of the resolution, so growth never moves them.
    """

    def __init__(self, config: MappingConfig) -> None:
        self._config = config
        self._first: IntArray = np.zeros(2, dtype=np.int64)  # (column, row) of cell (0, 0)
        self._log_odds: Float32Array = np.zeros((0, 0), dtype=np.float32)
        self._seen: NDArray[np.int32] = np.zeros((0, 0), dtype=np.int32)
        self._scans = 0
        self._weights = evidence_weights(
            config.hit_probability,
            config.miss_probability,
            config.min_probability,
            config.max_probability,
        )

    def draw(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """Enter one cloud. T_map_base: (3,)."""
        origins, ends, hit = _beams(cloud, self._config)
        if not len(ends):
            return
        scale = 1.0 / self._config.resolution_m
        origins = transform_points(T_map_base, origins) * scale
        ends = transform_points(T_map_base, ends) * scale
        self._cover(
            np.minimum(origins.min(0), ends.min(0)), np.maximum(origins.max(0), ends.max(0))
        )
        self._scans += 1
        update_log_odds(
            self._log_odds,
            self._seen,
            self._scans,
            origins - self._first,
            ends - self._first,
            hit,
            self._weights,
        )

    def _cover(self, lowest: FloatArray, highest: FloatArray) -> None:
        """Grow, by a quarter more than needed, so that all cells between the two exist."""
        low = np.floor(lowest).astype(np.int64) - 1
        high = np.floor(highest).astype(np.int64) + 2
        rows, columns = self._log_odds.shape
        end = self._first + np.array([columns, rows])
        if rows and (low >= self._first).all() and (high <= end).all():
            return
        if rows:
            low, high = np.minimum(low, self._first), np.maximum(high, end)
        self._refuse_if_too_large(high - low)
        if rows:
            spare = (high - low) // 4
            low = np.where(low < self._first, low - spare, low)
            high = np.where(high > end, high + spare, high)
        shape = (int(high[1] - low[1]), int(high[0] - low[0]))
        log_odds, seen = np.zeros(shape, np.float32), np.zeros(shape, np.int32)
        left, top = (self._first - low).tolist() if rows else (0, 0)
        log_odds[top : top + rows, left : left + columns] = self._log_odds
        seen[top : top + rows, left : left + columns] = self._seen
        self._first, self._log_odds, self._seen = low, log_odds, seen

    def _refuse_if_too_large(self, size: IntArray) -> None:
        if int(size[0]) * int(size[1]) > self._config.max_cells:
            metres = size * self._config.resolution_m
            raise SlamsimError(
                f"the map would be {metres[0]:.0f} x {metres[1]:.0f} m, which is more than "
                f"mapping.max_cells = {self._config.max_cells} cells of "
                f"{self._config.resolution_m} m; choose a larger mapping.resolution_m"
            )

    def grid(self) -> Grid:
        """What was drawn, cut to the cells that were ever touched.

        Raises SlamsimError where nothing was drawn.
        """
        rows = np.flatnonzero(self._seen.any(axis=1))
        columns = np.flatnonzero(self._seen.any(axis=0))
        if not len(rows):
            raise SlamsimError("there is nothing to map: no scan of the trajectory has a beam")
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        occupancy = 1.0 / (1.0 + np.exp(-self._log_odds[window]))
        occupancy[self._seen[window] == 0] = np.nan
        corner = self._first + np.array([columns[0], rows[0]])
        x, y = (corner * self._config.resolution_m).tolist()
        return Grid(occupancy.astype(np.float32), self._config.resolution_m, (x, y))


def _beams(cloud: Cloud, config: MappingConfig) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Origins, ends and hits of the beams to draw, in the base frame, cut to their reach.

    A single beam without return between two that have one is a drop-out, not free space; several
    clear as far as the nearer of the returns beside them, for a grazed wall returns nothing.
    """
    rays = cloud.points_m - cloud.origins_m
    length = np.hypot(rays[:, 0], rays[:, 1])
    hit = cloud.hit & (length <= config.max_range_m)
    silent_beam = np.pad(~cloud.hit, 1, constant_values=True)
    clears = silent_beam[:-2] & silent_beam[1:-1] & silent_beam[2:]
    silent_reach = np.minimum(config.clear_without_return_m, _range_beside(length, cloud.hit))
    reach = np.where(cloud.hit, config.max_range_m, silent_reach)
    shorten = np.minimum(1.0, reach / np.maximum(length, 1e-9))
    ends = cloud.origins_m + rays * shorten[:, None]
    kept = (cloud.hit | clears) & (reach > 0.0) & np.isfinite(ends).all(axis=1)
    return cloud.origins_m[kept], ends[kept], hit[kept]


def _range_beside(range_m: FloatArray, hit: BoolArray) -> FloatArray:
    """(n,) for each beam the smaller range of the last return before and the first after it.

    ``inf`` where there is no return at all.
    """
    known = np.where(hit, range_m, np.inf)
    index = np.arange(len(hit))
    before = np.maximum.accumulate(np.where(hit, index, -1))
    after = np.minimum.accumulate(np.where(hit, index, len(hit))[::-1])[::-1]
    padded = np.append(known, np.inf)  # index -1 and index n: no return on that side
    return np.asarray(np.minimum(padded[before], padded[after]))
