"""Square marks on walls that cameras recognise: AprilTag and ArUco, as OpenCV draws them."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.config.looks.walls import TagFamily
from slamsim.core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tag:
    """A tag on a wall. size_m: side of its black square, without the white border.

    T_map_tag: (4, 4); the tag's frame has its origin in the middle, x to the right and y up as it
    is read, z out of the wall.
    """

    id: int
    family: TagFamily
    size_m: float
    T_map_tag: FloatArray
