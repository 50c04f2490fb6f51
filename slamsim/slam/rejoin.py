"""Where a part of the map that nothing joins yet touches the others: sought everywhere in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.geometry import between, compose, transform_points
from slamsim.slam.closure import Expected
from slamsim.slam.parts import Parts
from slamsim.slam.relocalise import Everywhere, surface_points
from slamsim.slam.submaps import Submap
from slamsim.types import FloatArray

FOUND = np.diag(np.square([0.15, 0.15, 0.05]))
LOOK_AGAIN_M, LOOK_AGAIN_GROWTH = 1.5, 2.0
"""Path after a look that led nowhere; after each further one it is longer, for a search of a whole
map takes long, and a part that shows nothing of the others may stay so for kilometres."""
MOST_SUBMAPS = 2
NEAR_M = 8.0
BESIDE_M = 5.0


class Rejoiner:
    """Looks for a query in all submaps of other parts; tells where closures should be tried."""

    def __init__(self, config: BackEndConfig) -> None:
        self._config = config
        self._everywhere: Everywhere | None = None
        self._built_for: tuple[int, int] | None = None
        self._next_m, self._pause_m = -np.inf, LOOK_AGAIN_M

    def due(self, path_m: float) -> bool:
        """Whether to look again, after looks that led nowhere."""
        return path_m >= self._next_m

    def look(
        self, query: Submap, part: int, others: Sequence[tuple[int, Submap]], poses: FloatArray
    ) -> list[tuple[int, Expected]]:
        """Numbers of submaps, each with where the query should be in it; [] if nowhere surely.

        part: of the map that the query belongs to. others: numbers and submaps of all the rest.
        """
        everywhere = self._of(part, others, poses)
        T_map_query = everywhere.find(query)
        if T_map_query is None:
            self._next_m = query.to_path_m + self._pause_m
            self._pause_m *= LOOK_AGAIN_GROWTH
            return []
        self._pause_m = LOOK_AGAIN_M
        here_m = transform_points(T_map_query, query.middle_m)
        middles_m = np.array(
            [transform_points(poses[submap.anchor], submap.middle_m) for _, submap in others]
        )
        distance_m = np.hypot(*(middles_m - here_m).T)
        nearest = np.argsort(distance_m, kind="stable")[:MOST_SUBMAPS]
        return [
            (
                others[k][0],
                Expected(between(poses[others[k][1].anchor], T_map_query), FOUND),
            )
            for k in nearest.tolist()
            if distance_m[k] <= NEAR_M
        ]

    def _of(self, part: int, others: Sequence[tuple[int, Submap]], poses: FloatArray) -> Everywhere:
        key = (part, len(others))
        if self._everywhere is None or self._built_for != key:
            points_m = surface_points([submap for _, submap in others], poses)
            self._everywhere, self._built_for = Everywhere(points_m, self._config), key
        return self._everywhere


def moved_onto(
    poses: FloatArray, members: Sequence[slice], T_new: FloatArray, T_old: FloatArray
) -> FloatArray:
    """(n, 3) poses, those of ``members`` carried rigidly by what takes T_old to T_new."""
    moved = poses.copy()
    for part in members:
        moved[part] = compose(T_new, between(T_old, poses[part]))
    return moved


def side_by_side(poses: FloatArray, parts: Parts, submaps: Sequence[Submap]) -> FloatArray:
    """(n, 3) poses, each part that nothing joins to the others moved along x until no submap of
    it reaches into theirs; the first stays."""
    moved, right_m = poses.copy(), -np.inf
    part_of = np.array([parts.of(number) for number in range(len(poses))])
    for part in np.unique(part_of).tolist():
        seen = surface_points([one for one in submaps if part_of[one.anchor] == part], poses)
        x_m = np.concatenate([seen[:, 0], poses[part_of == part, 0]])
        if np.isfinite(right_m):
            moved[part_of == part, 0] += right_m + BESIDE_M - x_m.min()
            x_m = x_m + right_m + BESIDE_M - x_m.min()
        right_m = float(x_m.max())
    return moved
