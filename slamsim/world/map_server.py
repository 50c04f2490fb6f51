"""The maps of ROS map_server, a YAML file beside an image, and solids from their occupied cells.

The format: http://wiki.ros.org/map_server (image, resolution, origin, negate, thresholds, mode).
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely
from pydantic import ConfigDict, Field, model_validator
from shapely import Polygon

from slamsim.config.base import Config
from slamsim.config.layout import ImageLayout
from slamsim.config.loading import load_model
from slamsim.config.world import Place
from slamsim.core.geometry import transform_points
from slamsim.core.types import BoolArray, Grid, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input, require_inside
from slamsim.guard.limits import LIMITS
from slamsim.guard.pictures import read_gray_image
from slamsim.world.model import Bounds
from slamsim.world.prism import Prism, polygons_of

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


_BLOCK_ROWS = 512


def image_prisms(layout: ImageLayout, height_m: float) -> tuple[list[Prism], Bounds]:
    """Occupied cells, and unknown ones if they are to be solid, as upright prisms; and the bounds
    of the whole image. Raises InputRefused or NotFound."""
    path = Path(layout.file)
    described, image_path, occupied, free = read_cells(path)
    if not occupied.any():
        reason = f"not one of its {occupied.size:,} cells is occupied"
        raise InputRefused(image_path, f"{reason} by the thresholds and mode of {path.name}")
    solid = ~free if layout.unknown == "solid" else occupied
    if (corners := _corners(solid)) > LIMITS.image_corners:
        reason = f"its walls have {corners:,} corners, at most {LIMITS.image_corners:,} are built"
        raise InputRefused(image_path, f"{reason}: this is noise", limit="image_corners")
    prisms = [Prism(_placed(polygon, described), 0.0, height_m) for polygon in outline_cells(solid)]
    rows, columns = solid.shape
    frame = shapely.bounds(_placed(shapely.box(0, 0, columns, rows), described)).tolist()
    return prisms, (frame[0], frame[1], frame[2], frame[3])


def _placed(polygon: Polygon, described: MapServerMap) -> Polygon:
    """From pixels, counted from the image's lower left corner, to metres in the map frame."""
    pose = np.array(described.origin)
    return shapely.transform(
        polygon, lambda points: transform_points(pose, points * described.resolution)
    )


def _corners(solid: BoolArray) -> int:
    """How many corners the outlines of a mask have."""
    padded, count = np.pad(solid, 1), 0
    for first in range(0, len(padded) - 1, _BLOCK_ROWS):
        rows = padded[first : first + _BLOCK_ROWS + 1]
        a, b, c, d = rows[:-1, :-1], rows[:-1, 1:], rows[1:, :-1], rows[1:, 1:]
        touching = (a == d) & (a ^ b) & (a ^ c)
        count += int(np.count_nonzero(a ^ b ^ c ^ d) + 2 * np.count_nonzero(touching))
    return count


def outline_cells(solid: BoolArray) -> list[Polygon]:
    """The exact outlines, in cells, of a mask (rows, columns); x counts columns, y rows."""
    low_row, high_row, low_column, high_column = _rectangles(solid).T
    boxes = shapely.box(low_column, low_row, high_column, high_row)
    return [shapely.simplify(part, 0.0) for part in polygons_of(shapely.union_all(boxes))]


def _rectangles(solid: BoolArray) -> IntArray:
    """(n, 4) first and last-plus-one row and column of rectangles that cover the mask exactly:
    the runs of each row, equal runs of successive rows taken together."""
    padded = np.pad(solid, ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=1)
    row, begin = np.nonzero(change == 1)
    end = np.nonzero(change == -1)[1]
    order = np.lexsort((row, end, begin))
    row, begin, end = row[order], begin[order], end[order]
    goes_on = (begin[1:] == begin[:-1]) & (end[1:] == end[:-1]) & (row[1:] == row[:-1] + 1)
    first = np.flatnonzero(np.append(True, ~goes_on))
    last = np.append(first[1:], len(row)) - 1
    return np.column_stack([row[first], row[last] + 1, begin[first], end[first]])
