"""Solids from the occupied cells of a ROS map_server map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from shapely import Polygon

from slamsim.config.layout import ImageLayout
from slamsim.core.geometry import transform_points
from slamsim.core.types import BoolArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.limits import LIMITS, Limits
from slamsim.world.map_server import MapServerMap, read_cells
from slamsim.world.model import Bounds
from slamsim.world.prism import Prism, polygons_of

_BLOCK_ROWS = 512


def image_prisms(
    layout: ImageLayout, height_m: float, limits: Limits = LIMITS
) -> tuple[list[Prism], Bounds]:
    """Occupied cells, and unknown ones if they are to be solid, as upright prisms; and the bounds
    of the whole image. Raises InputRefused or NotFound."""
    path = Path(layout.file)
    described, image_path, occupied, free = read_cells(path)
    if not occupied.any():
        reason = f"not one of its {occupied.size:,} cells is occupied"
        raise InputRefused(image_path, f"{reason} by the thresholds and mode of {path.name}")
    solid = ~free if layout.unknown == "solid" else occupied
    if (corners := _corners(solid)) > limits.image_corners:
        reason = f"its walls have {corners:,} corners, at most {limits.image_corners:,} are built"
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
