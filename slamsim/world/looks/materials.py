"""Of what surfaces are made, as cameras and range finders need to know."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class Material:
    """ir_reflectance: share of light of 850 nm that comes back, 0 to 1, whatever the colour.

    roughness: 1 matt, 0 polished. is_glass: rays mostly pass. is_mirror: rays are thrown back.
    """

    name: str
    ir_reflectance: float
    roughness: float
    is_glass: bool = False
    is_mirror: bool = False


class MaterialId(IntEnum):
    """Number of a material, its place in ``MATERIALS``."""

    NOTHING = 0
    PAINT = 1
    PLASTER = 2
    BRICK = 3
    CONCRETE = 4
    WOOD = 5
    TILE = 6
    LINOLEUM = 7
    FABRIC = 8
    CARDBOARD = 9
    PAPER = 10
    TAG = 11
    GLASS = 12
    MIRROR = 13


MATERIALS: tuple[Material, ...] = (
    Material("nothing", 0.0, 1.0),
    Material("paint", 0.75, 0.8),
    Material("plaster", 0.80, 1.0),
    Material("brick", 0.40, 1.0),
    Material("concrete", 0.40, 0.9),
    Material("wood", 0.50, 0.6),
    Material("tile", 0.60, 0.2),
    Material("linoleum", 0.45, 0.4),
    Material("fabric", 0.55, 1.0),
    Material("cardboard", 0.45, 0.9),
    Material("paper", 0.80, 0.7),
    Material("tag", 0.60, 0.8),
    Material("glass", 0.08, 0.0, is_glass=True),
    Material("mirror", 0.90, 0.0, is_mirror=True),
)
"""By ``MaterialId``. Reflectances are typical ones: paper, wood and cardboard after the table of
remission in SICK's technical description of the LMS200 (paper 0.8, raw wood 0.4, grey cardboard
0.2 to 0.5); brick and concrete after the ECOSTRESS spectral library at 0.85 micrometres; glass 2
times 4 % of Fresnel's reflection; roughness is our own order of them."""
