"""Matching on a finished map: our matcher, on surfaces that scans no longer change."""

from __future__ import annotations

import numpy as np

from slamsim.config.slam import FrontEndConfig
from slamsim.slam.matching.line import LineMatcher
from slamsim.slam.matching.local_map import SIDE, LocalMap
from slamsim.slam.matching.surfaces import X, Y
from slamsim.types import Cloud, FloatArray

REFILL_AFTER_M = 4.0
_EVER_M = 1e12


class FixedMapMatcher(LineMatcher):
    """surfaces: (m, PIECE_FIELDS) of the whole map, in its frame, each once.

    Only those around the robot lie in the table that the matcher reads.
    """

    def __init__(self, config: FrontEndConfig, surfaces: FloatArray, noise_m: float) -> None:
        super().__init__(config)
        self._map = LocalMap(config.local_map.cell_m, _EVER_M)
        self._surfaces, self._map_noise_m = surfaces, noise_m
        self._centre_m: FloatArray | None = None

    def insert(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """The map stays as it is; what lies around the robot is made ready."""
        self.centre_on(T_map_base[:2])

    def forget(self) -> None:
        """Nothing: the map is finished."""

    def centre_on(self, place_m: FloatArray) -> None:
        """Make the surfaces around a place (2,) ready, unless they are."""
        if self._centre_m is not None and np.hypot(*(place_m - self._centre_m)) < REFILL_AFTER_M:
            return
        self._centre_m = place_m.copy()
        reach_m = (SIDE // 2 - 2) * self._map.cell_m * 0.7
        near = (np.abs(self._surfaces[:, [X, Y]] - place_m) < reach_m).all(axis=1)
        around = self._surfaces[near]
        around[:, [X, Y]] -= place_m
        self._map.clear()
        self._map.insert(around, np.append(place_m, 0.0), self._map_noise_m)
