"""The maps of ROS map_server: a YAML file beside an image.

The format: http://wiki.ros.org/map_server (image, resolution, origin, negate, thresholds, mode).
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from slamsim.config.base import Config
from slamsim.config.loading import load_model
from slamsim.config.world import Place
from slamsim.core.types import BoolArray, Grid
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input, require_inside
from slamsim.guard.image import read_gray_image

_log = logging.getLogger(__name__)
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]
_Threshold = Annotated[float, Field(ge=0.0, le=1.0)]


class MapServerMap(Config):
    """The YAML file of a ROS map_server map.

    Other programs write these files, and add keys of their own (``map_type``, ``cost_scaling``):
    unlike in our own files a further key is told of and otherwise ignored.
    """

    model_config = ConfigDict(extra="allow")

    image: str = Field(min_length=1, max_length=1000)
    """Image file in the folder of the map."""
    resolution: float = Field(gt=0.0, le=100.0)
    """Metres per pixel."""
    origin: Annotated[tuple[Place, Place, Angle], Field(strict=False)]
    """Pose of the image's lower left corner: x and y in metres, yaw in radians."""
    negate: Literal[0, 1] | bool
    """Whether white is occupied, instead of black."""
    occupied_thresh: _Threshold
    """What is more probably occupied than this is occupied."""
    free_thresh: _Threshold
    """What is less probably occupied than this is free."""
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    """How grey levels are read: trinary and scale by the thresholds, where scale takes what is
    transparent for unknown; raw takes the levels 0 to 100 for percent, higher ones for unknown."""

    @model_validator(mode="after")
    def _check(self) -> MapServerMap:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError(
                f"free_thresh {self.free_thresh:g} exceeds occupied_thresh {self.occupied_thresh:g}"
            )
        return self


def read_map(path: Path) -> Grid:
    """The grid of a map whose axes are those of the map frame: 1 occupied, 0 free, else ``nan``.

    Raises InputRefused or NotFound.
    """
    described, _, occupied, free = read_cells(path)
    x_m, y_m, yaw_rad = described.origin
    if yaw_rad != 0.0:
        raise InputRefused(path, f"a map turned by {yaw_rad:g} rad is not supported", "origin")
    occupancy = np.full(occupied.shape, np.nan, dtype=np.float32)
    occupancy[occupied], occupancy[free] = 1.0, 0.0
    return Grid(occupancy, described.resolution, (x_m, y_m))


def read_cells(path: Path) -> tuple[MapServerMap, Path, BoolArray, BoolArray]:
    """The description at path, its image's path, and which cells are occupied and which free.

    (rows, cols) each, the first row the lowest in y. Raises InputRefused or NotFound.
    """
    described = load_model(MapServerMap, path)
    if further := ", ".join(described.model_extra or ()):
        _log.warning("%s: these keys of the map are not used: %.200s", path, further)
    image_path = require_inside(path.parent, described.image, path, "image")
    occupied, free = _classified(described, image_path)
    return described, image_path, occupied, free


def _classified(described: MapServerMap, image_path: Path) -> tuple[BoolArray, BoolArray]:
    """Which cells are occupied, and which are free; the first row is the lowest in y."""
    gray, level = read_gray_image(image_path)[::-1], np.arange(256)
    if described.mode == "raw":
        probability, known = level / 100.0, level <= 100
    else:
        probability = level / 255.0 if described.negate else 1.0 - level / 255.0
        known = np.ones(256, dtype=bool)
    occupied = (known & (probability > described.occupied_thresh))[gray]
    free = (known & (probability < described.free_thresh))[gray]
    if described.mode == "scale":
        opaque = _opaque(image_path, gray.shape)[::-1]
        occupied, free = occupied & opaque, free & opaque
    return occupied, free


def _opaque(image_path: Path, shape: tuple[int, ...]) -> BoolArray:
    """Which pixels are not transparent at all; the image was found whole before."""
    import cv2

    data = np.frombuffer(read_input(image_path, "image_file_bytes"), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] != 4 or image.shape[:2] != shape:
        return np.ones(shape, dtype=bool)
    return np.asarray(image[:, :, 3] == (65535 if image.dtype == np.uint16 else 255))
