"""A picture of a world as a camera at its start sees it."""

from __future__ import annotations

import numpy as np

from slamsim.cameras.lens import pinhole
from slamsim.cameras.poses import RowPoses
from slamsim.config.layout import LooksConfig
from slamsim.core.geometry import matrix_from_xyzw, xyzw_from_yaw
from slamsim.core.types import Float32Array
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.scene import Scene
from slamsim.world.looks.build import build_looks
from slamsim.world.model import World
from slamsim.world.preview import Image, encoded_png

_CAMERA = pinhole(480, 270, 75.0)
_HEIGHT_M = 0.5
_FLOOR_REACH_M = 30.0
_BRIGHTEST_PERCENT = 98.0
"""Of all radiances so many are no brighter than white."""

_R_BASE_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of a camera (z ahead, x to the right, y down) that looks along x."""


def view_png(world: World, looks: LooksConfig) -> bytes:
    """480 x 270 pixels without noise, 0.5 m above the start and along its heading, as a PNG."""
    view = View(Scene(world.mesh, _FLOOR_REACH_M), _CAMERA, np.eye(4), readout_s=0.0)
    x_m, y_m, yaw_rad = world.start_pose
    R_map_optical = matrix_from_xyzw(xyzw_from_yaw(np.array(yaw_rad))) @ _R_BASE_OPTICAL
    at = np.zeros(1, dtype=np.int64), np.array([[x_m, y_m, _HEIGHT_M]]), R_map_optical[None]
    radiance = view.radiance(view.sight(RowPoses(*at)), build_looks(world, looks))
    return encoded_png(_exposed(radiance).reshape(_CAMERA.height, _CAMERA.width, 3)[..., ::-1])


def _exposed(radiance: Float32Array) -> Image:
    """(n, 3) sRGB values (IEC 61966-2-1) of linear light, hardly any of it brighter than white."""
    white = max(float(np.percentile(radiance, _BRIGHTEST_PERCENT)), 1e-9)
    share = np.clip(radiance / white, 0.0, 1.0)
    curved = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    image: Image = np.rint(255.0 * curved).astype(np.uint8)
    return image
