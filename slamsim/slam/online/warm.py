"""Compiled and loaded before the first scan, so that none has to wait for it."""

from __future__ import annotations

import gc

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry
from slamsim.models.differential_drive import pose_reading
from slamsim.slam.frontend.keyframes import KeyframeMaker
from slamsim.slam.frontend.motion import Odometry, increments
from slamsim.slam.frontend.odometry import FrontEnd

_ROOM_M = 3.0
"""Half the side of a square room, within reach of every lidar."""
_SCAN_NS = 100_000_000


def warm_up(config: SlamConfig, T_base_laser: FloatArray) -> None:
    """Track a few scans of a square room, some of them from a place that was not predicted.

    What is loaded by then is taken out of Python's garbage collection (``gc.freeze``): looking
    through all of it would hold up a scan by a quarter of a second now and then. T_base_laser: (4,
    4).
    """
    geometry = ScanGeometry(-np.pi, np.pi / 180.0, 360, 200_000, 0.05, 30.0)
    stamps_ns = np.arange(9) * _SCAN_NS
    wheels = PlanarTrajectory(stamps_ns, np.zeros((9, 3)))
    odometry = Odometry(increments(wheels), pose_reading(wheels))
    front_end = FrontEnd(config.front_end, odometry, T_base_laser)
    maker = KeyframeMaker(config.back_end.keyframes, config.front_end.max_range_m)
    for number in range(6):
        turned = 0.0 if number < 3 else 0.35
        scan = Scan(int(stamps_ns[number]), _square(geometry, turned), geometry)
        tracked = front_end.step(scan)
        if tracked is not None:
            maker.make(tracked)
    gc.collect()
    gc.freeze()


def _square(geometry: ScanGeometry, turned_rad: float) -> np.ndarray:
    """Ranges in the middle of a room; its wall is nearest where cosine or sine is largest."""
    angles = geometry.angles_rad() + turned_rad
    return (_ROOM_M / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))).astype(np.float32)
