"""Karto's correlative scan matcher (Konolige et al. 2010), on a buffer of recent scans."""

from __future__ import annotations

from collections import deque

import karto_scanmatcher as karto
import numpy as np

from slamsim.bench.peers.base import PeerScan, Setup
from slamsim.core.geometry import between, compose, inverse
from slamsim.core.types import FloatArray

BUFFER_SCANS, BUFFER_M = 70, 20.0
KEEP_AFTER_M, KEEP_AFTER_RAD = 0.2, float(np.deg2rad(10.0))
"""Sizes of the running buffer and when a scan enters it, as OpenKarto's mapper has them."""

NOTHING_M = 1e3
"""Stands for no return: beyond the matcher's range threshold, which leaves it out."""


class Karto:
    """Each scan is matched with the buffer, from where the odometry says the robot is."""

    def __init__(self, setup: Setup) -> None:
        config = karto.ScanMatcherConfig()
        if setup.settings:
            config.range_threshold = setup.settings["range_threshold_m"]
        geometry, T_base_laser = setup.geometry, setup.T_base_laser
        self._matcher = karto.Wrapper(config)
        self._laser = karto.LaserScanConfig(
            geometry.angle_min_rad,
            geometry.angle_min_rad + (geometry.beam_count - 1) * geometry.angle_step_rad,
            geometry.angle_step_rad,
            geometry.range_min_m,
            geometry.range_max_m,
            config.range_threshold,
            "laser",
        )
        yaw = np.arctan2(T_base_laser[1, 0], T_base_laser[0, 0])
        self._T_base_laser = np.array([T_base_laser[0, 3], T_base_laser[1, 3], yaw])
        self._buffer: deque[karto.LocalizedRangeScan] = deque(maxlen=BUFFER_SCANS)
        self._T_odom_last: FloatArray | None = None
        self._T_map_base = np.zeros(3)
        self._T_map_kept = np.zeros(3)
        self._count = 0

    def step(self, scan: PeerScan) -> FloatArray:
        """See ``Peer.step``."""
        if self._T_odom_last is not None:
            moved = between(self._T_odom_last, scan.T_odom_base)
            self._T_map_base = compose(self._T_map_base, moved)
        self._T_odom_last = scan.T_odom_base
        if self._buffer:
            found = self._matcher.match_scan(
                self._localized(scan), list(self._buffer), True, True
            ).best_pose
            T_map_laser = np.array([found.x, found.y, found.yaw])
            self._T_map_base = compose(T_map_laser, inverse(self._T_base_laser))
        self._keep(scan)
        return self._T_map_base

    def _localized(self, scan: PeerScan) -> karto.LocalizedRangeScan:
        pose = karto.Pose2(*compose(self._T_map_base, self._T_base_laser))
        ranges = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, NOTHING_M)
        self._count += 1
        return karto.LocalizedRangeScan(
            self._laser, ranges.tolist(), pose, pose, self._count, 0.1 * self._count
        )

    def _keep(self, scan: PeerScan) -> None:
        """Put the scan into the buffer if the robot moved; drop those that are far behind."""
        moved = between(self._T_map_kept, self._T_map_base)
        near = np.hypot(moved[0], moved[1]) < KEEP_AFTER_M and abs(moved[2]) < KEEP_AFTER_RAD
        if near and self._buffer:
            return
        self._T_map_kept = self._T_map_base
        self._buffer.append(self._localized(scan))
        while self._away_m(self._buffer[0]) > BUFFER_M:
            self._buffer.popleft()

    def _away_m(self, kept: karto.LocalizedRangeScan) -> float:
        pose = kept.corrected_pose
        return float(np.hypot(pose.x - self._T_map_base[0], pose.y - self._T_map_base[1]))
