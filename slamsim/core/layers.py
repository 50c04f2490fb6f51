"""Layers that images add to a map, in cells of the same grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import FloatArray, Grid


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleLayer:
    """What depth images show to stand in the way.

    grid: occupied, free or unknown, as the map's. views: (n, 3) poses of the optical axis in the
    plane, in the map. half_angle_rad, max_depth_m: how far to both sides and ahead they see.
    """

    grid: Grid
    views: FloatArray
    half_angle_rad: float
    max_depth_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SemanticLayer:
    """labels: (rows, cols) int32, the label that was seen most often in each cell, -1 for none.

    shares: (rows, cols) of the votes that it has. grid: gives resolution and origin. topic, images:
    where they come from, and how many were used.
    """

    labels: NDArray[np.int32]
    shares: NDArray[np.float32]
    grid: Grid
    topic: str
    images: int


@dataclass(frozen=True, slots=True, eq=False)
class MapLayers:
    """Those that were asked for."""

    obstacles: ObstacleLayer | None = None
    semantic: SemanticLayer | None = None


NO_LAYERS = MapLayers()
_GOLDEN = 0.618033988749895
"""Hues so far apart from one label to the next differ for any number of labels."""


def label_colours(labels: NDArray[np.integer]) -> NDArray[np.uint8]:
    """(..., 3) RGB of labels, each another colour; light grey for those below 0."""
    hue = 6.0 * ((np.asarray(labels, np.float64) * _GOLDEN) % 1.0)
    away = np.abs((hue[..., None] - np.array([0.0, 2.0, 4.0]) + 3.0) % 6.0 - 3.0)
    shade = 60.0 + 170.0 * np.clip(2.0 - away, 0.0, 1.0)
    return np.where(np.asarray(labels)[..., None] < 0, 235, shade).round().astype(np.uint8)
