"""Solids from the occupied cells of a ROS map_server map.

The format: http://wiki.ros.org/map_server (image, resolution, origin, negate, thresholds, mode).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely
from pydantic import Field, model_validator
from shapely import Polygon

from slamsim.config.base import Config
from slamsim.config.layout import ImageLayout
from slamsim.config.loading import load_model
from slamsim.geometry import transform_points
from slamsim.safe.errors import InputRefused
from slamsim.safe.files import read_input, require_inside
from slamsim.safe.image import read_gray_image
from slamsim.safe.limits import LIMITS
from slamsim.types import BoolArray, IntArray
from slamsim.world.model import Bounds
from slamsim.world.prism import Prism, polygons_of

_Threshold = Annotated[float, Field(ge=0.0, le=1.0)]


class MapServerMap(Config):
    """The YAML file of a ROS map_server map."""

    image: str = Field(min_length=1, max_length=4096)
    """Image file in the folder of the map."""
    resolution: float = Field(gt=0.0, le=100.0)
    """Metres per pixel."""
    origin: Annotated[tuple[float, float, float], Field(strict=False)]
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


def image_prisms(layout: ImageLayout, height_m: float) -> tuple[list[Prism], Bounds]:
    """Occupied cells, and unknown ones if they are to be solid, as upright prisms; and the bounds
    of the whole image. Raises InputRefused or NotFound."""
    path = Path(layout.file)
    described = load_model(MapServerMap, path)
    image_path = require_inside(path.parent, described.image, path, "image")
    occupied, free = _read_cells(described, image_path)
    if not occupied.any():
        reason = f"not one of its {occupied.size:,} cells is occupied"
        raise InputRefused(image_path, f"{reason} by the thresholds and mode of {path.name}")
    solid = ~free if layout.unknown == "solid" else occupied
    prisms = [Prism(_placed(polygon, described), 0.0, height_m) for polygon in outline_cells(solid)]
    rows, columns = solid.shape
    frame = shapely.bounds(_placed(shapely.box(0, 0, columns, rows), described)).tolist()
    return prisms, (frame[0], frame[1], frame[2], frame[3])


def _read_cells(described: MapServerMap, image_path: Path) -> tuple[BoolArray, BoolArray]:
    """Which cells are occupied, and which are free; the first row is the lowest in y."""
    gray = read_gray_image(image_path)[::-1].astype(np.float64)
    if described.mode == "raw":
        probability, known = gray / 100.0, gray <= 100.0
    else:
        probability = gray / 255.0 if described.negate else 1.0 - gray / 255.0
        known = np.ones(gray.shape, dtype=bool)
        if described.mode == "scale":
            known = _opaque(image_path, gray.shape)[::-1]
    occupied = known & (probability > described.occupied_thresh)
    return occupied, known & (probability < described.free_thresh)


def _opaque(image_path: Path, shape: tuple[int, ...]) -> BoolArray:
    """Which pixels are not transparent at all; the image was found whole before."""
    import cv2

    data = np.frombuffer(read_input(image_path, LIMITS.image_file_bytes), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] != 4 or image.shape[:2] != shape:
        return np.ones(shape, dtype=bool)
    return np.asarray(image[:, :, 3] == (65535 if image.dtype == np.uint16 else 255))


def _placed(polygon: Polygon, described: MapServerMap) -> Polygon:
    """From pixels, counted from the image's lower left corner, to metres in the map frame."""
    pose = np.array(described.origin)
    return shapely.transform(
        polygon, lambda points: transform_points(pose, points * described.resolution)
    )


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
