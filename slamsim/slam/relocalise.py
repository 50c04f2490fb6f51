"""Finding oneself anywhere in a map, without knowing where to look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.geometry import compose, transform_points
from slamsim.slam.correlative import (
    LikelihoodGrid,
    Peak,
    Places,
    Window,
    likelihood_grid,
    scores,
    search,
)
from slamsim.slam.submaps import SIGMA_M, Submap
from slamsim.types import FloatArray

MAX_CELLS = 6_000_000
MAX_POINTS = 300
LOOKUPS_PER_M2 = 10_000_000
"""A search of the whole map may read the grid so often, for its effort grows with the area.

In the offices of fr079, where many rooms look alike and so keep many blocks in the running,
searches ended within 3 million; the rest is margin for buildings that are more alike still.
"""
MIN_SPREAD_M = 1.5
"""A query that spans less than this could be anywhere."""


class Everywhere:
    """A map's surfaces as one likelihood grid.

    points_m: (n, 2) along all surfaces, in the map frame. config: what a match must show.
    """

    def __init__(self, points_m: FloatArray, config: BackEndConfig) -> None:
        self._limits = config.closures
        size_m = np.ptp(points_m, axis=0) if len(points_m) else np.zeros(2)
        resolution_m = config.submaps.resolution_m
        while float(np.prod(size_m / resolution_m)) > MAX_CELLS:
            resolution_m *= 1.5
        self._middle_m = points_m.mean(axis=0) if len(points_m) else np.zeros(2)
        self._half_m = 0.5 * size_m + np.abs(
            0.5 * (points_m.min(axis=0) + points_m.max(axis=0)) - self._middle_m
        )
        self._grid: LikelihoodGrid = likelihood_grid(
            points_m - self._middle_m, resolution_m, max(SIGMA_M, resolution_m), np.inf
        )

    def find(self, query: Submap) -> FloatArray | None:
        """T_map_query: (3,), or None if it fits nowhere, or in several places."""
        points = query.points_m - query.middle_m
        if not len(points) or np.ptp(points, axis=0).max() < MIN_SPREAD_M:
            return None
        points = np.ascontiguousarray(points[:: max(1, -(-len(points) // MAX_POINTS))])
        peak = self._peak(points)
        if peak is None or peak.rival > self._limits.ambiguity_ratio * peak.score:
            return None
        T_middle_query = np.array([-query.middle_m[0], -query.middle_m[1], 0.0])
        T_map_query = compose(peak.T_grid_points, T_middle_query)
        T_map_query[:2] += self._middle_m
        return T_map_query

    def score(self, points_m: FloatArray) -> float:
        """Of points (n, 2) where they are in the map."""
        return float(scores(self._grid, points_m - self._middle_m, np.zeros((1, 3)))[0])

    def places(
        self, points_m: FloatArray, least: float, slack: float
    ) -> Iterator[tuple[FloatArray, float] | None]:
        """The place where points (n, 2) score best, at least ``least``, then all others that score
        at most ``slack`` less: the step (3,) that takes them there from where they are, and the
        score. None, and nothing more, if the search took too long: what it did not find may be
        better."""
        middle_m, limits = points_m.mean(axis=0), self._limits
        apart = (limits.ambiguity_distance_m, float(np.deg2rad(limits.ambiguity_turn_deg)))
        points = np.ascontiguousarray(points_m - middle_m)
        window, most_lookups = self._whole_map()
        search = Places(self._grid, points, np.zeros(3), window, apart, most_lookups)
        best = 0.0
        while (peak := search.best(least)) is not None:
            best = max(best, peak.score)
            least = max(least, best - slack)
            T_map_middle = peak.T_grid_points + np.append(self._middle_m, 0.0)
            yield compose(T_map_middle, np.append(-middle_m, 0.0)), peak.score
        if search.given_up:
            yield None

    def _peak(self, points_m: FloatArray) -> Peak | None:
        limits = self._limits
        rival = (
            limits.ambiguity_ratio,
            limits.ambiguity_distance_m,
            float(np.deg2rad(limits.ambiguity_turn_deg)),
        )
        window, most_lookups = self._whole_map()
        middle = np.zeros(3)
        return search(self._grid, points_m, middle, window, limits.min_score, rival, most_lookups)

    def _whole_map(self) -> tuple[Window, float]:
        window = Window(float(self._half_m[0]), float(self._half_m[1]), np.pi)
        area_m2 = 4.0 * float(self._half_m[0] * self._half_m[1])
        return window, LOOKUPS_PER_M2 * max(area_m2, 1.0)


def surface_points(submaps: Sequence[Submap], poses: FloatArray) -> FloatArray:
    """(n, 2) along the surfaces of submaps, whose anchors stand at ``poses`` (n, 3)."""
    placed = [
        transform_points(poses[submap.anchor], submap.points_m)
        for submap in submaps
        if len(submap.points_m)
    ]
    return np.concatenate(placed) if placed else np.zeros((0, 2))
