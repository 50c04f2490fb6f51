"""small_gicp (Koide 2024): voxelised generalised ICP, scan to map."""

from __future__ import annotations

import numpy as np
import small_gicp

from slamsim.bench.peers.base import PeerScan, Setup, band_points
from slamsim.core.geometry import between, compose, se2_from_se3, se3_from_se2
from slamsim.core.types import FloatArray

RINGS, SPACING_M = 3, 0.1
"""It needs points in space: a scan is repeated in so many rings, so far apart in height."""
HORIZON_SCANS, CLEAR_CYCLE = 100, 10


class Gicp:
    """As in the library's odometry example; guided, it starts from our prediction."""

    def __init__(self, setup: Setup) -> None:
        self._settings, self._guided = setup.settings, setup.guided
        self._map = small_gicp.GaussianVoxelMap(self._settings["voxel_m"])
        self._map.set_lru(horizon=HORIZON_SCANS, clear_cycle=CLEAR_CYCLE)
        self._T_odom_last: FloatArray | None = None
        self._T_map_base = np.zeros(3)

    def step(self, scan: PeerScan) -> FloatArray:
        """See ``Peer.step``."""
        if self._guided and self._T_odom_last is not None:
            moved = between(self._T_odom_last, scan.T_odom_base)
            self._T_map_base = compose(self._T_map_base, moved)
        self._T_odom_last = scan.T_odom_base
        cloud, _ = small_gicp.preprocess_points(
            band_points(scan.points_m, RINGS, SPACING_M), self._settings["point_m"]
        )
        if self._map.size() > 0:
            found = small_gicp.align(
                self._map,
                cloud,
                se3_from_se2(self._T_map_base),
                max_correspondence_distance=self._settings["gate_m"],
            )
            self._T_map_base = se2_from_se3(found.T_target_source)
        self._map.insert(cloud, se3_from_se2(self._T_map_base))
        return self._T_map_base
