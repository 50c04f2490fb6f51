"""Where a part of the map lies in a finished one, by all that was ever seen from it.

A few scans of a building whose rooms look alike fit in several of them, and fit best in a wrong one
if they were taken where nobody has mapped. All that was seen from a part says more, and only in the
end is all of it known: then each part is sought once more, and goes where it fits better than
anywhere else, or nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.config.back_end import BackEndConfig, SubmapConfig
from slamsim.geometry import between, compose, inverse, transform_points
from slamsim.result import GraphEdge
from slamsim.slam.keyframes import Keyframe
from slamsim.slam.matching.surfaces import X, Y
from slamsim.slam.relocalise import Everywhere, surface_points
from slamsim.slam.solution import Solution
from slamsim.slam.submaps import FREE, SpaceGrid, Submap, space_between
from slamsim.slam.views import PIECE_M
from slamsim.types import FloatArray, IntArray

FOUND = np.diag(np.square([0.05, 0.05, 0.02]))
"""Covariance of where a search in steps of 0.08 m finds a part, before any closure is found."""

SURE_NATS = 12.0
"""A place is believed if it is so much likelier than any other. Each piece of wall that lies on the
map makes it likelier by e (``placing.NATS_A_PIECE``), each that it contradicts less likely."""

LEAST_PIECES, MOST_PIECES = 40, 600
"""Fewer pieces of wall cannot say where they are; more say no more, and take longer."""

MOST_PLACES = 24
"""In a building of equal rooms there are as many places as rooms to be looked at."""


class WholeParts:
    """The parts of a drive in a map of key frames that are held fixed, the first ``held``."""

    def __init__(
        self, config: BackEndConfig, submaps: Sequence[Submap], poses: FloatArray, held: int
    ) -> None:
        self._held = held
        self._limits = config.closures
        of_map = [submap for submap in submaps if submap.last < held]
        self._size, self._walls_m = config.submaps, surface_points(of_map, poses)
        self._everywhere = Everywhere(self._walls_m, config)
        self._walls_m = one_a_cell(self._walls_m)

    def settle(self, solution: Solution, keyframes: Sequence[Keyframe]) -> list[IntArray]:
        """Put each part where it fits best; the key frames of those that were put elsewhere.

        One that fits in several places, or nowhere, is joined to the map no longer. What follows
        on a place that was given is left there unless it fits in another one alone.
        """
        moved = []
        for members in self._parts(solution, keyframes):
            first, parts = int(members[0]), solution.parts
            if first in parts.withdrawn:
                continue
            T_now_best = self._place([keyframes[k] for k in members], solution.poses[members])
            joined = parts.of(first) == parts.of(0)
            if T_now_best is not None and joined and self._is_here(T_now_best, solution, members):
                continue
            if T_now_best is None and not joined:
                continue
            if joined:
                solution.separate(members)
            if T_now_best is not None:
                solution.enter(self._edge(T_now_best, solution.poses, members))
            moved.append(members)
        return moved

    def _place(self, part: Sequence[Keyframe], poses: FloatArray) -> FloatArray | None:
        """(3,) the step in the map frame that takes a part to where it lies; None if that is not
        clear. poses: (n, 3) T_map_base of its key frames where they are now.

        A place is the likelier, the more of what was seen lies on the map, and the fewer of its
        walls stand where the part has free space. A place that was not looked at any more cannot be
        likelier than by what lies on the map alone.
        """
        seen_m = np.concatenate(
            [transform_points(T, k.pieces[:, [X, Y]]) for k, T in zip(part, poses, strict=True)]
        )
        seen_m = one_a_cell(seen_m)[:MOST_PIECES]
        if len(seen_m) < LEAST_PIECES:
            return None
        space = _space_around(part, poses, seen_m, self._size)
        found: list[tuple[float, FloatArray]] = []
        left = -np.inf
        for T, score in self._everywhere.places(seen_m):
            left = score * len(seen_m)
            nats = [one for one, _ in found]
            if len(found) == MOST_PLACES or (nats and left < max(nats) - SURE_NATS):
                break
            through = np.count_nonzero(
                space.at(transform_points(inverse(T), self._walls_m)) == FREE
            )
            found.append((left - through, T))
            left = -np.inf
        found.sort(key=lambda one: -one[0])
        if not found or found[0][0] - max(left, *(n for n, _ in found[1:]), -np.inf) < SURE_NATS:
            return None
        return found[0][1]

    def _parts(self, solution: Solution, keyframes: Sequence[Keyframe]) -> list[IntArray]:
        """The key frames that hold together without the map."""
        count, withdrawn = len(keyframes) - self._held, solution.parts.withdrawn
        follows = [k for k in keyframes[self._held + 1 :] if not _begins(k, withdrawn)]
        ends = [(k.index - 1, k.index) for k in follows]
        ends += [(e.source, e.target) for e in solution.closures if e.weight > 0.0]
        pairs = np.array(ends, dtype=np.int64).reshape(-1, 2) - self._held
        pairs = pairs[(pairs >= 0).all(axis=1)]
        graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
        part = connected_components(graph, directed=False)[1]
        return [np.flatnonzero(part == one) + self._held for one in np.unique(part).tolist()]

    def _is_here(self, T_now_best: FloatArray, solution: Solution, members: IntArray) -> bool:
        """Whether the best place of a part is the one where it lies."""
        at = solution.poses[members]
        off = between(at, compose(T_now_best, at))
        near = np.hypot(off[:, 0], off[:, 1]).max() < self._limits.ambiguity_distance_m
        return bool(near and abs(off[0, 2]) < np.deg2rad(self._limits.ambiguity_turn_deg))

    def _edge(self, T_now_best: FloatArray, poses: FloatArray, members: IntArray) -> GraphEdge:
        """What the search says, between the key frames of map and part that come closest."""
        at = compose(T_now_best, poses[members])
        apart = poses[: self._held, None, :2] - at[None, :, :2]
        source, number = np.unravel_index(
            np.argmin(np.square(apart).sum(axis=2)), (self._held, len(members))
        )
        T = between(poses[source], at[number])
        return GraphEdge(int(source), int(members[number]), T, FOUND, "closure")


def _begins(keyframe: Keyframe, withdrawn: set[int]) -> bool:
    """Whether the robot was carried before a key frame, or may have been."""
    return keyframe.kidnapped or (keyframe.suspect and keyframe.index not in withdrawn)


def _space_around(
    part: Sequence[Keyframe], poses: FloatArray, seen_m: FloatArray, size: SubmapConfig
) -> SpaceGrid:
    """Where the beams of key frames at ``poses`` (n, 3) found free space, in the frame of these."""
    beams = [
        (np.broadcast_to(transform_points(T, k.origin_m), k.beams_m.shape), T, k.beams_m)
        for k, T in zip(part, poses, strict=True)
    ]
    origins_m = np.concatenate([origins for origins, _, _ in beams])
    ends_m = np.concatenate([transform_points(T, b.astype(np.float64)) for _, T, b in beams])
    return space_between(origins_m, ends_m, seen_m, size.resolution_m)


def one_a_cell(points_m: FloatArray) -> FloatArray:
    """(k, 2) of points (n, 2) one in each square as large as a piece of wall, in no order."""
    _, first = np.unique(np.floor(points_m / PIECE_M).astype(np.int64), axis=0, return_index=True)
    return points_m[np.random.default_rng(0).permutation(first)]
