"""What a robot has seen so far, placed by its true poses."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.config.lidar import LidarConfig
from slamsim.config.slam import MappingConfig
from slamsim.core.types import Drive, FloatArray, Grid, PlanarTrajectory, Scan
from slamsim.guard.errors import SlamsimError
from slamsim.live.robot import Window
from slamsim.sensors.lidar import scan_geometry
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.mapping.grid import Canvas

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""Values of the map in an observation."""
_SHADES = np.array([150, 255, 30], dtype=np.uint8)
_PICTURE_PX, _ARROW_M = 480, 0.4
"""Side of the rendered picture, and length of the arrow that shows the heading."""
_PATH, _ROBOT = (60, 120, 220), (220, 60, 40)


class Seen:
    """A map of scans that are placed beam by beam where the robot truly was."""

    def __init__(self, config: MappingConfig, lidar: LidarConfig, T_base_laser: FloatArray) -> None:
        self._config, self._T_base_laser = config, T_base_laser
        self._sweep_ns = scan_geometry(lidar).duration_ns
        self._canvas = Canvas(config)
        self._motion: deque[PlanarTrajectory] = deque()
        self.path: list[FloatArray] = []
        """(3,) T_map_base at the end of each window."""
        self.scan: Scan | None = None
        """The last whole one, stamped in true time."""
        self.grid: Grid | None = None

    @property
    def area_m2(self) -> float:
        """Of all cells that are known to be free or occupied."""
        if self.grid is None:
            return 0.0
        return float(np.isfinite(self.grid.occupancy).sum()) * self._config.resolution_m**2

    def take(self, window: Window) -> None:
        """The next window of the drive."""
        scans = window.readings.scans
        motion = self._moved(window.drive)
        for scan, true_ns in zip(scans, scans.true_stamps_ns.tolist(), strict=True):
            self.scan = Scan(true_ns, scan.ranges_m, scan.geometry)
            cloud = deskew(self.scan, motion, true_ns, self._T_base_laser)
            self._canvas.draw(cloud, motion.at(np.array([true_ns]))[0])
        if len(scans):
            self.grid = self._drawn()

    def around(self, cells: int) -> NDArray[np.uint8]:
        """(cells, cells) UNKNOWN, FREE or OCCUPIED about the robot, north up as in a picture."""
        part: NDArray[np.uint8] = np.full((cells, cells), UNKNOWN, dtype=np.uint8)
        if self.grid is None:
            return part
        column, row = self._cell(self.path[-1][None, :2])[0] - cells // 2
        known = _values(self.grid)
        rows = slice(max(row, 0), min(row + cells, known.shape[0]))
        columns = slice(max(column, 0), min(column + cells, known.shape[1]))
        if rows.stop > rows.start and columns.stop > columns.start:
            at = np.s_[rows.start - row : rows.stop - row, columns.start - column :]
            inner = known[rows, columns]
            part[at][:, : inner.shape[1]] = inner
        return np.ascontiguousarray(part[::-1])

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB of the whole map, the path and the robot, north up."""
        if self.grid is None:
            return np.full((_PICTURE_PX, _PICTURE_PX, 3), _SHADES[UNKNOWN], dtype=np.uint8)
        shades = _SHADES[_values(self.grid)]
        height, width = shades.shape
        scale = max(_PICTURE_PX // max(height, width), 1)
        large = np.repeat(np.repeat(shades, scale, axis=0), scale, axis=1)
        picture = cv2.cvtColor(large, cv2.COLOR_GRAY2RGB)
        cell_m = self.grid.resolution_m / scale
        here = np.array(self.path)
        pixels = np.rint((here[:, :2] - self.grid.origin_m) / cell_m).astype(np.int32)
        cv2.polylines(picture, [pixels], False, _PATH)
        yaw_rad, ahead_px = here[-1, 2], _ARROW_M / cell_m
        ahead = ahead_px * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        tip = np.rint(pixels[-1] + ahead).astype(np.int32)
        cv2.arrowedLine(picture, pixels[-1].tolist(), tip.tolist(), _ROBOT, 2, tipLength=0.4)
        return np.ascontiguousarray(picture[::-1])

    def _moved(self, drive: Drive) -> PlanarTrajectory:
        """The poses of this window and of as many before as its scans may have begun in."""
        if len(drive):
            self._motion.append(drive.trajectory().planar())
            self.path.append(self._motion[-1].poses[-1])
        begun_ns = self._motion[-1].stamps_ns[0] - self._sweep_ns
        while len(self._motion) > 1 and self._motion[1].stamps_ns[0] < begun_ns:
            self._motion.popleft()
        return PlanarTrajectory.joined(self._motion)

    def _drawn(self) -> Grid | None:
        try:
            return self._canvas.grid()
        except SlamsimError:  # no beam has met anything yet
            return None

    def _cell(self, points_m: FloatArray) -> NDArray[np.int64]:
        """(n, 2) column and row."""
        assert self.grid is not None
        cells = np.floor((points_m - self.grid.origin_m) / self.grid.resolution_m)
        return np.asarray(cells, dtype=np.int64)


def _values(grid: Grid) -> NDArray[np.uint8]:
    known = np.isfinite(grid.occupancy)
    return np.where(known, np.where(grid.occupancy > 0.5, OCCUPIED, FREE), UNKNOWN).astype(np.uint8)
