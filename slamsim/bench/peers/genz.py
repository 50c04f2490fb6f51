"""GenZ-ICP (Lee et al. 2025): point to plane and point to point, weighed by degeneracy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from genz_icp.config import load_config
from genz_icp.genz_icp import GenZICP
from genz_icp.mapping import get_voxel_hash_map
from genz_icp.pybind import genz_icp_pybind
from genz_icp.registration import get_registration
from genz_icp.threshold import get_threshold_estimator

from slamsim.bench.peers.base import PeerScan, Setup, band_points
from slamsim.core.geometry import between, compose, se2_from_se3, se3_from_se2
from slamsim.core.types import FloatArray

PRESET = "indoor"
"""The library's own settings for buildings."""

RINGS, SPACING_M = 3, 0.1
"""It needs points in space: a scan is repeated in so many rings, so far apart in height."""


class Shipped:
    """The library's own odometry with its own settings for buildings."""

    def __init__(self, setup: Setup) -> None:
        self._odometry = GenZICP(load_config(Path(PRESET)))

    def step(self, scan: PeerScan) -> FloatArray:
        """See ``Peer.step``."""
        points = band_points(scan.points_m, RINGS, SPACING_M)
        self._odometry.register_frame(points, np.tile(scan.fired, RINGS))
        return se2_from_se3(self._odometry.last_pose)


class Guided:
    """Its registration and map, with our prediction; the steps are those of its own odometry."""

    def __init__(self, setup: Setup) -> None:
        config, settings = load_config(Path(PRESET)), setup.settings
        config.data.max_range = settings["max_range_m"]
        config.mapping.voxel_size = settings["voxel_m"]
        config.adaptive_threshold.initial_threshold = settings["initial_threshold_m"]
        config.adaptive_threshold.min_motion_th = settings["min_motion_m"]
        self._voxel_m = settings["voxel_m"]
        self._map = get_voxel_hash_map(config)
        self._registration = get_registration(config)
        self._threshold = get_threshold_estimator(config)
        self._T_odom_last: FloatArray | None = None
        self._T_map_base = np.zeros(3)

    def step(self, scan: PeerScan) -> FloatArray:
        """See ``Peer.step``."""
        if self._T_odom_last is not None:
            moved = between(self._T_odom_last, scan.T_odom_base)
            self._T_map_base = compose(self._T_map_base, moved)
        self._T_odom_last = scan.T_odom_base
        points = band_points(scan.points_m, RINGS, SPACING_M)
        dense = _thinned(points, 0.5 * self._voxel_m)
        guess, pose = se3_from_se2(self._T_map_base), se3_from_se2(self._T_map_base)
        if not self._map.empty():
            sigma = self._threshold.get_threshold()
            sparse = _thinned(dense, 1.5 * self._voxel_m)
            pose = self._registration.align_points_to_map(
                sparse, self._map, guess, 3.0 * sigma, sigma / 3.0
            )
            self._threshold.update_model_deviation(np.linalg.inv(guess) @ pose)
        self._map.update(dense, pose)
        self._T_map_base = se2_from_se3(pose)
        return self._T_map_base


def _thinned(points_m: FloatArray, voxel_m: float) -> FloatArray:
    thinned = genz_icp_pybind._voxel_down_sample(genz_icp_pybind._Vector3dVector(points_m), voxel_m)
    return np.asarray(thinned)
