"""kiss-icp (Vizzo et al. 2023): point to point on a voxel map."""

from __future__ import annotations

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.kiss_icp import KissICP

from slamsim.bench.peers.base import PeerScan, Setup, flat_points
from slamsim.core.geometry import between, se2_from_se3, se3_from_se2
from slamsim.core.types import FloatArray

RANGE_PER_VOXEL = 100.0
"""As in the library's own ``load_config``."""


class Kiss:
    """The library's own odometry; guided, its constant-velocity prediction is replaced by ours."""

    def __init__(self, setup: Setup) -> None:
        config, settings = load_config(None), setup.settings
        self._guided = setup.guided
        if self._guided:
            config.data.max_range = settings["max_range_m"]
            config.mapping.voxel_size = settings["voxel_m"]
            config.adaptive_threshold.initial_threshold = settings["initial_threshold_m"]
            config.adaptive_threshold.min_motion_th = settings["min_motion_m"]
            config.data.deskew = False
        else:  # the one number that its users are asked for; the voxels follow from it
            config.data.max_range = setup.geometry.range_max_m
            config.mapping.voxel_size = setup.geometry.range_max_m / RANGE_PER_VOXEL
        self._odometry = KissICP(config)
        self._T_odom_last: FloatArray | None = None

    def step(self, scan: PeerScan) -> FloatArray:
        """See ``Peer.step``."""
        if self._guided:
            if self._T_odom_last is not None:
                moved = between(self._T_odom_last, scan.T_odom_base)
                self._odometry.last_delta = se3_from_se2(moved)
            self._T_odom_last = scan.T_odom_base
        self._odometry.register_frame(flat_points(scan.points_m), np.asarray(scan.fired))
        return se2_from_se3(self._odometry.last_pose)
