"""What hangs on walls, for cameras to see: tags, posters, panes."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.layout import SizeRange

TagFamily = Literal[
    "apriltag_36h11",
    "aruco_4x4_50",
    "aruco_4x4_100",
    "aruco_4x4_250",
    "aruco_4x4_1000",
    "aruco_5x5_50",
    "aruco_5x5_100",
    "aruco_5x5_250",
    "aruco_5x5_1000",
    "aruco_6x6_50",
    "aruco_6x6_100",
    "aruco_6x6_250",
    "aruco_6x6_1000",
    "aruco_original",
]

_OTHER_COUNTS = {"apriltag_36h11": 587, "aruco_original": 1024}


def tags_in(family: TagFamily) -> int:
    """Different tags that a family has, as ``cv2.aruco`` knows them."""
    return _OTHER_COUNTS.get(family) or int(family.rpartition("_")[2])


Count = Annotated[int, Field(ge=0, le=1000)]


class TagsConfig(Config):
    """Square marks on walls that cameras recognise, each with its own number."""

    count: Count = 0
    """How many hang on walls beside free floor; those that find no room are left out."""
    family: TagFamily = "apriltag_36h11"
    """Which marks: AprilTag 36h11, or a dictionary of ArUco."""
    first_id: int = Field(default=0, ge=0, le=1023)
    """Number of the first tag; the next ones count up."""
    size_m: SizeRange = (0.16, 0.16)
    """Smallest and largest side of the black square, in metres, without the white border around."""
    height_m: SizeRange = (0.25, 0.7)
    """Lowest and highest middle above the floor, in metres."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        there = tags_in(self.family)
        if self.first_id + self.count > there:
            raise ValueError(
                f"{self.count} tags from first_id {self.first_id} are more than the {there} of "
                f"{self.family}"
            )
        return self


class PostersConfig(Config):
    """Printed sheets on walls: what makes places look different from each other."""

    count: Count = 24
    """How many hang on walls beside free floor, times ``texture``; those that find no room are
    left out."""
    size_m: SizeRange = (0.3, 0.7)
    """Smallest and largest width, in metres; sheets are up to 1.4 times as high, or as low."""
    height_m: SizeRange = (0.3, 1.4)
    """Lowest and highest middle above the floor, in metres."""


class PanesConfig(Config):
    """Sheets of glass and mirrors on walls, the hard cases of cameras.

    They hang flat on the wall's mesh, so that no lidar sees them.
    """

    glass: Count = 0
    """How many panes of glass, behind which the wall is dark."""
    mirrors: Count = 0
    """How many mirrors."""
    size_m: SizeRange = (0.4, 0.9)
    """Smallest and largest side, in metres."""
