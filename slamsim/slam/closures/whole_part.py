"""Where a part of the map lies in another by all that was ever seen from it.

The other map was finished before, or made before the robot was carried.

A few scans of a building whose rooms look alike fit in several of them, and fit best in a wrong one
if they were taken on unmapped ground. All that was seen from a part says more, and only in the
end is all of it known: then each part is sought once more, and goes where it fits better than
anywhere else, or nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slamsim.config.back_end import BackEndConfig
from slamsim.core.components import components
from slamsim.core.geometry import between, compose, inverse, transform_points
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.solution import Solution
from slamsim.slam.backend.views import PIECE_M
from slamsim.slam.closures.relocalise import Everywhere, surface_points
from slamsim.slam.closures.submaps import FREE, UNKNOWN, SpaceGrid, Submap, space_between
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.matching.surfaces import X, Y

FOUND = np.diag(np.square([0.05, 0.05, 0.02]))
"""Covariance of where a search in steps of 0.08 m finds a part, before any closure is found."""

SURE_NATS = 12.0
"""A place is believed if it is so much likelier than any other. Each piece of wall that lies on the
map makes it likelier by e (``placing.NATS_A_PIECE``), each that it contradicts less likely."""

LEAST_PIECES, MOST_PIECES = 40, 300
"""Fewer pieces of wall cannot say where they are; more say no more, and take longer."""

LEAST_SCORE = 0.4
"""Of a drive half of which the map shows: below that, chance finds as much."""

MOST_PLACES = 24
"""In a building of equal rooms there are as many places as rooms to be looked at."""


class WholeParts:
    """The parts of a drive in a map, that of the first ``held`` key frames."""

    def __init__(
        self,
        config: BackEndConfig,
        keyframes: Sequence[Keyframe],
        submaps: Sequence[Submap],
        poses: FloatArray,
        held: int,
    ) -> None:
        self._keyframes, self._held = keyframes, held
        self._limits, self._resolution_m = config.closures, config.submaps.resolution_m
        submaps = [one for one in submaps if one.last < held]
        self._everywhere = Everywhere(surface_points(submaps, poses), config)
        self._map = _seen(keyframes[:held], poses[:held], self._resolution_m)

    def settle(
        self, solution: Solution, *, only_joined: bool = False
    ) -> tuple[list[IntArray], list[int]]:
        """Put each part where it fits best; the key frames of those that do not stay, and those
        before which the robot was carried as it turned out.

        What was joined to the map by its looks and fits in several places is joined no longer. What
        follows on by odometry stays where that has it, unless it fits in another place alone.
        only_joined: parts that no closure joins to the map are left as they are. Key frames are
        (k,) of each part.
        """
        moved, carried = [], []
        every = self._parts(solution)
        for members in every:
            poses, begins = solution.poses.copy(), _begins(members)
            followed = [k for k in begins if not self._keyframes[k].kidnapped]
            joined = solution.parts.of(begins[0]) == solution.parts.of(0)
            if only_joined and not (joined and solution.crossing(members)):
                continue
            likely = self._likely(members, poses, joined)
            here = [T for T in likely if self._is_here(T, poses[members])]
            if len(likely) > 1 and followed:
                likely = here
            if len(likely) > 1:
                if joined:
                    solution.separate(members, [])
                    moved.append(members)
                continue
            stays = bool(here) and (joined or bool(followed))
            if not likely or (stays and solution.crossing(members)):
                continue
            if not stays:
                loose = [self._held_by_nothing(every, begin - 1, solution) for begin in followed]
                for one in (members, *(before for before in loose if before is not None)):
                    cut = [k for k in _begins(one) if not self._keyframes[k].kidnapped]
                    solution.separate(one, cut)
                    carried += cut
            solution.enter(self._edge(likely[0], poses, members))
            moved.append(members)
        return moved, carried

    def _held_by_nothing(
        self, every: Sequence[IntArray], last: int, solution: Solution
    ) -> IntArray | None:
        """The part that ends before the robot was found elsewhere, if odometry alone tells where it
        is: the robot may have been carried before it as well. Where it began is known."""
        part = next((one for one in every if last in one), None)
        if part is None or part[0] == self._held or solution.crossing(part):
            return None
        return part

    def _likely(self, members: IntArray, poses: FloatArray, joined: bool) -> list[FloatArray]:
        """The steps (3,) in the map frame that take a part to where it may lie: none if that is not
        clear, several if these are equally likely.

        poses: (n, 3) T_map_base of all key frames where they are now, which is in the map if the
        part is joined to it. Of the places where about as much lies on the map as at the best one,
        that is likelier of whose walls fewer stand where the part has free space.
        """
        part = [self._keyframes[k] for k in members]
        seen = _seen(part, poses[members], self._resolution_m)
        points_m = seen.walls_m[:MOST_PIECES]
        if len(points_m) < LEAST_PIECES:
            return []
        slack = SURE_NATS / len(points_m)
        least = LEAST_SCORE
        if joined:
            least = min(LEAST_SCORE, max(self._everywhere.score(points_m) - slack, 0.0))
        found: list[tuple[float, FloatArray]] = []
        for place in self._everywhere.places(points_m, least, slack):
            if place is None or len(found) == MOST_PLACES:
                return []
            T, score = place
            free, known = seen.in_the_open(self._map, inverse(T))
            found.append((len(points_m) * (score - free / max(known, 1)), T))
        most = max((nats for nats, _ in found), default=0.0)
        likely = [T for nats, T in found if nats > most - SURE_NATS]
        return [T for T in likely if not self._is_refuted(seen, T)]

    def _is_refuted(self, seen: _Seen, T: FloatArray) -> bool:
        """Whether part and map contradict each other there, each the other, as different places
        do: doors, furniture and people contradict one of them more than the other."""
        both = (seen.in_the_open(self._map, inverse(T)), self._map.in_the_open(seen, T))
        return all(free > self._limits.max_contradiction * known for free, known in both)

    def _parts(self, solution: Solution) -> list[IntArray]:
        """The key frames that matches and closures hold together without the map."""
        count = len(self._keyframes) - self._held
        ends = [(k.index - 1, k.index) for k in self._keyframes[self._held + 1 :] if not k.broken]
        ends += [(e.source, e.target) for e in solution.closures if e.weight > 0.0]
        pairs = np.array(ends, dtype=np.int64).reshape(-1, 2) - self._held
        pairs = pairs[(pairs >= 0).all(axis=1)]
        part = components(pairs, count)
        return [np.flatnonzero(part == one) + self._held for one in np.unique(part).tolist()]

    def _is_here(self, T_best: FloatArray, poses: FloatArray) -> bool:
        """Whether the best place of a part is the one where it lies."""
        off = between(poses, compose(T_best, poses))
        near = np.hypot(off[:, 0], off[:, 1]).max() < self._limits.ambiguity_distance_m
        return bool(near and abs(off[0, 2]) < np.deg2rad(self._limits.ambiguity_turn_deg))

    def _edge(self, T_best: FloatArray, poses: FloatArray, members: IntArray) -> GraphEdge:
        """What the search says, between the key frames of map and part that come closest."""
        at = compose(T_best, poses[members])
        distances_m, nearest = map(np.asarray, cKDTree(poses[: self._held, :2]).query(at[:, :2]))
        number = int(np.argmin(distances_m))
        source = int(nearest[number])
        T = between(poses[source], at[number])
        return GraphEdge(source, int(members[number]), T, FOUND, "closure")


def _begins(members: IntArray) -> list[int]:
    """The first key frame of each run of consecutive ones."""
    begins: list[int] = members[np.diff(members, prepend=members[0] - 2) > 1].tolist()
    return begins


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """walls_m: (n, 2) one of each piece of wall. space: what is known of the floor around them."""

    walls_m: FloatArray
    space: SpaceGrid

    def in_the_open(self, other: _Seen, T_this_other: FloatArray) -> tuple[int, int]:
        """How many of the other's pieces stand where there is free space here, of so many that
        stand where anything is known."""
        states = self.space.at(transform_points(T_this_other, other.walls_m))
        return int(np.count_nonzero(states == FREE)), int(np.count_nonzero(states != UNKNOWN))


def _seen(keyframes: Sequence[Keyframe], poses: FloatArray, resolution_m: float) -> _Seen:
    """What key frames saw from poses (n, 3)."""
    placed = list(zip(keyframes, poses, strict=True))
    origins_m = [np.tile(transform_points(T, k.origin_m), (len(k.beams_m), 1)) for k, T in placed]
    ends_m = [transform_points(T, k.beams_m.astype(np.float64)) for k, T in placed]
    points_m = [transform_points(T, k.pieces[:, [X, Y]]) for k, T in placed]
    beams_m = np.concatenate(origins_m), np.concatenate(ends_m)
    space = space_between(*beams_m, np.concatenate(points_m), resolution_m)
    return _Seen(_walls(points_m), space)


def _walls(points_m: Sequence[FloatArray]) -> FloatArray:
    """(n, 2) one point of each piece of wall that was seen from two key frames or more, in no
    order: what was seen once only is mostly people, and ends of grazing beams."""
    by = np.repeat(np.arange(len(points_m)), [len(one) for one in points_m])
    cells = np.floor(np.concatenate(points_m) / PIECE_M).astype(np.int64)
    seen, first = np.unique(np.column_stack([cells, by]), axis=0, return_index=True)
    _, one, count = np.unique(seen[:, :2], axis=0, return_index=True, return_counts=True)
    again = first[one[count >= 2]]
    points: FloatArray = np.concatenate(points_m)[np.random.default_rng(0).permutation(again)]
    return points
