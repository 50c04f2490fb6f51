"""Finding oneself anywhere in a map, without knowing where to look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import compose, transform_points
from slamsim.core.types import FloatArray
from slamsim.slam.closures.correlative import (
    LikelihoodGrid,
    Peak,
    Places,
    Window,
    likelihood_grid,
    scores,
    search,
)
from slamsim.slam.closures.submaps import SIGMA_M, Submap

MAX_CELLS = 24_000_000
MAP_LEVELS = 8
"""Of the pyramid: blocks of 8 m at the fine resolution, or searching a hundred metres begins with
millions of them."""

MAX_POINTS = 800
SIGMAS_M = (SIGMA_M, 0.03)
"""How far a surface may be off, first coarse, then fine. The coarse search finds places of which
much has changed. Places that it cannot tell apart, as those along a corridor whose doors are set
back by a decimetre, differ in the fine one."""

BESIDE_PATH_M = 5.0
"""Farther from where the robot was, beams lie too far apart to show what tells one stretch of a
corridor from another: at a grazing angle one degree is a metre of wall at 8 m."""

MIN_SPREAD_M = 1.5
"""A query that spans less than this could be anywhere."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How hard to search a map.

    least_score: of the coarse search, if more than any match must show. most_lookups: a search
    that has read the grid so often is given up. longest_pause_m: after looks that led nowhere, the
    path to the next.
    """

    least_score: float
    most_lookups: float
    longest_pause_m: float


THOROUGH = Effort(0.0, np.inf, np.inf)
"""For what nothing else tells."""

QUICK = Effort(0.7, 3e8, 8.0)
"""For a search that is repeated all along the path: a second or so. Outdoors (fr-clinic) the same
place scores 0.7 to 0.88, and none that scored less was clearer than the next best; indoors it
scores above 0.9."""

LOOKUPS_PER_M2 = 1e7
"""No search reads the grid more often than that, for the effort grows with the area.

In the offices of fr079, where many rooms look alike and so keep many blocks in the running,
searches ended within 3 million; the rest is margin for buildings that are more alike still.
"""


class Everywhere:
    """A map's surfaces as likelihood grids, one for each of ``SIGMAS_M``, built when needed.

    points_m: (n, 2) along all surfaces, in the map frame. config: what a match must show.
    """

    def __init__(
        self, points_m: FloatArray, config: BackEndConfig, effort: Effort = THOROUGH
    ) -> None:
        self._limits, self._effort = config.closures, effort
        self._resolution_m = config.submaps.resolution_m
        self._middle_m = points_m.mean(axis=0) if len(points_m) else np.zeros(2)
        self._points_m = points_m - self._middle_m
        self._half_m = np.abs(self._points_m).max(axis=0, initial=0.0)
        self._grids: dict[float, LikelihoodGrid] = {}

    def find(
        self, query: Submap, heading_rad: float = 0.0, turn_rad: float = np.pi
    ) -> FloatArray | None:
        """T_map_query: (3,), or None if it fits nowhere, or in several places.

        heading_rad: of the query in the map frame, to within turn_rad.
        """
        points = beside_path(query) - query.middle_m
        if not len(points) or np.ptp(points, axis=0).max() < MIN_SPREAD_M:
            return None
        points = np.ascontiguousarray(points[:: max(1, -(-len(points) // MAX_POINTS))])
        middle = np.array([0.0, 0.0, heading_rad])
        for sigma_m in SIGMAS_M:
            peak = self._peak(sigma_m, points, middle, turn_rad)
            if peak is None:
                return None
            if peak.rival <= self._limits.ambiguity_ratio * peak.score:
                T_middle_query = np.array([-query.middle_m[0], -query.middle_m[1], 0.0])
                T_map_query = compose(peak.T_grid_points, T_middle_query)
                T_map_query[:2] += self._middle_m
                return T_map_query
        return None

    def score(self, points_m: FloatArray) -> float:
        """Of points (n, 2) where they are in the map."""
        return float(scores(self._grid(SIGMA_M), points_m - self._middle_m, np.zeros((1, 3)))[0])

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
        window, most_lookups = self._whole_map(np.pi)
        found = Places(self._grid(SIGMA_M), points, np.zeros(3), window, apart, most_lookups)
        best = 0.0
        while (peak := found.best(least)) is not None:
            best = max(best, peak.score)
            least = max(least, best - slack)
            T_map_middle = peak.T_grid_points + np.append(self._middle_m, 0.0)
            yield compose(T_map_middle, np.append(-middle_m, 0.0)), peak.score
        if found.given_up:
            yield None

    def _peak(
        self, sigma_m: float, points_m: FloatArray, T_map_points: FloatArray, turn_rad: float
    ) -> Peak | None:
        limits = self._limits
        rival = (
            limits.ambiguity_ratio,
            limits.ambiguity_distance_m,
            float(np.deg2rad(limits.ambiguity_turn_deg)),
        )
        least = limits.min_score
        if sigma_m == SIGMA_M:
            least = max(least, self._effort.least_score)
        window, most_lookups = self._whole_map(turn_rad)
        grid = self._grid(sigma_m)
        return search(grid, points_m, T_map_points, window, least, rival, most_lookups)

    def _whole_map(self, turn_rad: float) -> tuple[Window, float]:
        window = Window(float(self._half_m[0]), float(self._half_m[1]), turn_rad)
        area_m2 = 4.0 * float(self._half_m[0] * self._half_m[1])
        most_lookups = min(LOOKUPS_PER_M2 * max(area_m2, 1.0), self._effort.most_lookups)
        return window, most_lookups

    def _grid(self, sigma_m: float) -> LikelihoodGrid:
        if sigma_m not in self._grids:
            area_m2 = 4.0 * float(self._half_m[0] * self._half_m[1])
            finest_m = float(np.sqrt(area_m2 / MAX_CELLS))
            resolution_m = max(min(self._resolution_m, sigma_m), finest_m)
            self._grids[sigma_m] = likelihood_grid(
                self._points_m, resolution_m, max(sigma_m, resolution_m), np.inf, MAP_LEVELS
            )
        return self._grids[sigma_m]


def beside_path(query: Submap) -> FloatArray:
    """(n, 2) of its points those near where the robot was, in a wide place the nearer half."""
    points_m = query.points_m
    if not len(points_m):
        return points_m
    away_m = query.away_m(points_m)
    return points_m[away_m <= max(BESIDE_PATH_M, float(np.median(away_m)))]


def surface_points(submaps: Sequence[Submap], poses: FloatArray) -> FloatArray:
    """(n, 2) along the surfaces of submaps, whose anchors stand at ``poses`` (n, 3)."""
    placed = [
        transform_points(poses[submap.anchor], submap.points_m)
        for submap in submaps
        if len(submap.points_m)
    ]
    return np.concatenate(placed) if placed else np.zeros((0, 2))
