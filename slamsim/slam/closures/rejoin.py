"""Where a key frame lies in a map if nothing tells roughly where: sought everywhere in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import between, compose, transform_points
from slamsim.core.types import FloatArray
from slamsim.slam.closures.relocalise import Effort, Everywhere, surface_points
from slamsim.slam.closures.submaps import Submap
from slamsim.slam.frontend.parts import Parts

LOOK_AGAIN_M, LOOK_AGAIN_GROWTH = 1.5, 2.0
"""Path after a look that led nowhere; after each further one it is longer, for a search of a whole
map takes long, and a part that shows nothing of the others may stay so for kilometres."""

KEEP_LOOKING_M = 10.0
"""After a look that led somewhere, others must confirm it: so far no pause is made."""

MOST_SUBMAPS = 2
NEAR_M = 8.0
"""About the reach of the lidars of small robots: submaps farther away share no surface."""
BESIDE_M = 5.0
"""Between the bounding boxes of parts that are laid beside each other: no scan of one reaches into
the other by accident."""


class MapSearch:
    """Looks for a query anywhere in many submaps; tells where closures should be tried."""

    def __init__(self, config: BackEndConfig, effort: Effort) -> None:
        self._config, self._effort = config, effort
        self._everywhere: Everywhere | None = None
        self._built_for: tuple[int, ...] = ()
        self._poses = np.zeros((0, 3))
        self._next_m, self._found_m, self._pause_m = -np.inf, -np.inf, LOOK_AGAIN_M

    def due(self, path_m: float) -> bool:
        """Whether to look again, after looks that led nowhere."""
        return path_m >= self._next_m

    def wait(self, path_m: float) -> None:
        """There is nothing to look into here."""
        self._next_m = path_m + LOOK_AGAIN_M

    def forget_map(self) -> None:
        """Nothing is searched for now; its grids are built again when needed."""
        self._everywhere, self._built_for = None, ()

    def look(
        self,
        query: Submap,
        submaps: Mapping[int, Submap],
        poses: FloatArray,
        turn_rad: float = np.pi,
    ) -> list[tuple[int, FloatArray]]:
        """Numbers of submaps, each with T_submap_query (3,); [] if it is nowhere for sure.

        submaps: by their numbers. poses: (n, 3) T_map_base of all key frames. turn_rad: how far the
        heading of the query may be off.
        """
        everywhere = self._of(submaps, poses)
        T_map_query = everywhere.find(query, float(poses[query.anchor, 2]), turn_rad)
        if T_map_query is None:
            if query.to_path_m > self._found_m + KEEP_LOOKING_M:
                self._next_m = query.to_path_m + self._pause_m
                self._pause_m = min(self._pause_m * LOOK_AGAIN_GROWTH, self._effort.longest_pause_m)
            return []
        self._found_m, self._pause_m = query.to_path_m, LOOK_AGAIN_M
        here_m = transform_points(T_map_query, query.middle_m)
        anchors = {n: self._poses[submap.anchor] for n, submap in submaps.items()}
        middles_m = [transform_points(anchors[n], one.middle_m) for n, one in submaps.items()]
        distance_m = np.hypot(*(np.array(middles_m) - here_m).T)
        nearest = np.argsort(distance_m, kind="stable")[:MOST_SUBMAPS]
        numbers = np.array(list(submaps))[nearest[distance_m[nearest] <= NEAR_M]].tolist()
        return [(number, between(anchors[number], T_map_query)) for number in numbers]

    def _of(self, submaps: Mapping[int, Submap], poses: FloatArray) -> Everywhere:
        key = tuple(submaps)
        if self._everywhere is None or self._built_for != key:
            points_m = surface_points(list(submaps.values()), poses)
            self._everywhere = Everywhere(points_m, self._config, self._effort)
            self._built_for, self._poses = key, poses.copy()
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
