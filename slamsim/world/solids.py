"""All solids of a world: outlines at a height, covered ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from shapely import Polygon

from slamsim.core.types import FloatArray
from slamsim.world.prism import Prism, oriented_rings


class Solids(Protocol):
    """Outlines are directed segments (n, 2, 2) in the map frame with the solid on the left."""

    def section(self, height_m: float) -> FloatArray:
        """The outline of what a horizontal plane cuts."""
        ...

    def shadow(self, low_m: float, high_m: float) -> FloatArray:
        """The outline of the ground below whatever lies between two heights."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PrismSolids:
    """Solids made of prisms; they may overlap."""

    prisms: Sequence[Prism]

    def section(self, height_m: float) -> FloatArray:
        return outline(prism.section(height_m) for prism in self.prisms)

    def shadow(self, low_m: float, high_m: float) -> FloatArray:
        return outline(prism.shadow(low_m, high_m) for prism in self.prisms)


def outline(polygons: Iterable[Polygon]) -> FloatArray:
    """The borders of polygons as directed segments."""
    rings = [ring for polygon in polygons for ring in oriented_rings(polygon)]
    pieces = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return np.concatenate([np.zeros((0, 2, 2)), *pieces])
