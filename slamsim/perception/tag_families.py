"""Families of square tags that OpenCV knows, by the names that a user types."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.guard.errors import SlamsimError, did_you_mean, shown

_ARUCO_COUNTS = (50, 100, 250, 1000)
FAMILIES: dict[str, str] = {
    **{f"apriltag_{code}": f"DICT_APRILTAG_{code}" for code in ("16h5", "25h9", "36h10", "36h11")},
    **{
        f"aruco_{side}x{side}_{count}": f"DICT_{side}X{side}_{count}"
        for side in (4, 5, 6, 7)
        for count in _ARUCO_COUNTS
    },
    "aruco_mip_36h12": "DICT_ARUCO_MIP_36h12",
    "aruco_original": "DICT_ARUCO_ORIGINAL",
}
"""From our names to those of ``cv2.aruco``."""

LARGEST_TAG_M = 10.0
"""A larger one is a size in millimetres or centimetres."""


class UnknownTags(SlamsimError):
    """A family of tags that does not exist, or a size that no tag has."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class TagKind:
    """Tags of one family and one size: size_m is the side of the black square."""

    family: str
    size_m: float

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            meant = did_you_mean(self.family.lower(), FAMILIES, 0.3)
            known = ", ".join(FAMILIES)
            raise UnknownTags(
                f"{shown(self.family)} is no family of tags{meant}; known are {known}"
            )
        if not 0.0 < self.size_m <= LARGEST_TAG_M:
            raise UnknownTags(
                f"a tag's black square is {self.size_m:g} m wide; it must be wider than 0 and at "
                f"most {LARGEST_TAG_M:g} m"
            )


def parse_tags(text: str) -> TagKind:
    """``FAMILY:SIZE_M`` as it is typed, such as ``apriltag_36h11:0.2``. Raises UnknownTags."""
    family, colon, size = text.partition(":")
    try:
        size_m = float(size)
    except ValueError:
        colon, size_m = "", 0.0
    if not colon:
        raise UnknownTags(
            f"{shown(text)} says no family and size of tags; right is, for example, "
            "apriltag_36h11:0.2 (the side of the black square, in metres)"
        )
    return TagKind(family.strip(), size_m)
