"""Where a key frame was seen before: candidates, matches, and which of them to believe."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.solution import Solution
from slamsim.slam.closures.candidates import CandidateIndex
from slamsim.slam.closures.closure import Closure, ClosureFinder, Expected, Refusal
from slamsim.slam.closures.images import BY_IMAGES, ImageCandidates
from slamsim.slam.closures.pending import WaitingClosures
from slamsim.slam.closures.rejoin import MapSearch
from slamsim.slam.closures.relocalise import QUICK, THOROUGH
from slamsim.slam.closures.submap_cutter import SubmapCutter
from slamsim.slam.closures.submaps import Submap

LOOK_TRAVEL_M, LEAST_TRAVEL_M = 24.0, 6.0
"""What a search of the whole map looks for: all that was seen on so much path, and at least on so
much where the robot was carried before. Swept over a simulated round of 2 km: along 24 m of a
corridor, doors that are set back by 8 to 25 cm tell one stretch from the others 200 m long; along
12 m they do not."""

LOOK_KEYFRAMES = 100
"""In so many key frames, where the robot turned on the spot."""

MOVED_M = 0.15
MOVED_RAD = 0.03
"""A submap that moved by less is sought in again from nearly the same guess, which leads to the
same match."""


class ClosureSearch:
    """Searches the submaps of ``cutter``; what is believed is entered into ``solution``."""

    def __init__(
        self,
        config: BackEndConfig,
        cutter: SubmapCutter,
        solution: Solution,
        images: ImageCandidates,
    ) -> None:
        self._config, self._images = config.closures, images
        self._cutter, self._solution = cutter, solution
        self._candidates = CandidateIndex(config.closures)
        self._finder = ClosureFinder(config)
        self._waiting = WaitingClosures(config.closures.min_support, config.closures.query_travel_m)
        self._far, self._apart = MapSearch(config, QUICK), MapSearch(config, THOROUGH)
        self._closed: set[tuple[int, int]] = set()
        self._failures: dict[tuple[int, int], FloatArray] = {}
        self._new: list[GraphEdge] = []
        self.refusals: Counter[str] = Counter()
        """Why closures were not believed, and how often."""

    def offer(self, submap: Submap) -> None:
        """One more submap in which later key frames may find themselves."""
        self._candidates.add(submap)

    def restore(self, closures: Iterable[GraphEdge]) -> None:
        """Enter closures that another search found among the same submaps."""
        numbers = {submap.anchor: number for number, submap in enumerate(self._cutter.submaps)}
        for edge in closures:
            if edge.source in numbers:
                self._closed.add((numbers[edge.source], edge.target))
                self._solution.enter(edge)

    def search(self, index: int) -> int:
        """Search the submaps that may overlap with a key frame; how many closures came of it."""
        self.refusals["unsupported"] += self._waiting.forget(self._path_m(index))
        parts = self._solution.parts
        begun = parts.begun(index)
        is_open = bool(parts.open_between(begun - 1, begun))
        query = self._cutter.query(index, self._config.query_travel_m)
        before_m = np.nextafter(self._path_m(begun), np.inf) if is_open else -np.inf
        found = self._by_images(query)
        for number in self._candidates.of(query, self._solution.estimate, before_m):
            anchor = self._cutter.submaps[number].anchor
            if not parts.linked(anchor, index) or (number, index) in self._closed:
                continue
            expected = self._solution.expected(anchor, index)
            if self._failed_before(number, index, expected):
                continue
            closure = self._find(query, number, expected)
            if closure is None:
                self._failures[number, index] = expected.T_submap_query
            else:
                found += self._weigh(closure)
        if is_open and self._path_m(index) < before_m + LEAST_TRAVEL_M:
            return found
        if not found:
            found += self._look_far(index, before_m)
        return found + self._rejoin(index) if parts.loose else found

    def within_reach(self, query: Submap) -> list[Submap]:
        """The submaps in which a search near the estimate would find a key frame again."""
        numbers = self._candidates.within_reach(query, self._solution.estimate)
        return [self._cutter.submaps[number] for number in numbers]

    def new_closures(self) -> tuple[GraphEdge, ...]:
        """Those that came to count since this was last asked."""
        new = tuple(self._new)
        self._new.clear()
        return new

    def forget(self, members: IntArray) -> None:
        """These key frames lie elsewhere than they did: nothing was sought there. members: (k,)."""
        moved = set(members.tolist())
        self._closed = {pair for pair in self._closed if pair[1] not in moved}

    def give_up_waiting(self) -> None:
        """No closure that still waits for others to agree will ever count."""
        self.refusals["unsupported"] += self._waiting.forget(np.inf)

    def forget_grids(self) -> None:
        """All is found: what only speeds the search up takes hundreds of megabytes."""
        self._finder.forget_grids()
        self._far.forget_map()
        self._apart.forget_map()

    def _by_images(self, query: Submap) -> int:
        """Look for a key frame where images showed its place before. Camera and lidar are two
        witnesses; others must agree with them, for what looks alike to one may do so to both."""
        found, submaps, index = 0, self._cutter.submaps, query.anchor
        tried: dict[int, FloatArray] = {}
        for keyframe, T_keyframe_query in self._images.of(self._cutter.keyframes, index):
            number = self._cutter.submap_around(keyframe)
            if number is None or (number, index) in self._closed:
                continue
            anchor = submaps[number].anchor
            if submaps[number].to_path_m > query.to_path_m - self._config.min_travel_m:
                continue
            T_anchor_keyframe = between(
                self._solution.poses[anchor], self._solution.poses[keyframe]
            )
            T = compose(T_anchor_keyframe, T_keyframe_query)
            if number in tried and _is_near(tried[number], T):
                continue
            tried[number] = T
            closure = self._find(query, number, Expected(T, BY_IMAGES))
            if closure is None:
                continue
            if not self._solution.may_be(closure.edge):
                self.refusals["contradiction"] += 1
            else:
                found += self._weigh(replace(closure, expected=False, witnesses=2))
        return found

    def _look_far(self, index: int, before_m: float) -> int:
        """Look for a key frame in all that it may see again after a drift larger than any window of
        a search near the estimate."""
        if not self._far.due(self._path_m(index)):
            return 0
        linked, submaps = self._solution.parts.linked, self._cutter.submaps
        query = self._cutter.query(index, LOOK_TRAVEL_M, LOOK_KEYFRAMES)
        numbers = self._candidates.anywhere(query, self._solution.estimate, before_m)
        others = {n: submaps[n] for n in numbers if linked(submaps[n].anchor, index)}
        if not others:
            self._far.wait(self._path_m(index))
            return 0
        limits, first = self._config, submaps[min(others)].anchor
        sigma_rad = float(np.sqrt(self._solution.expected(first, index).covariance[2, 2]))
        least_rad = float(np.deg2rad(limits.min_window_deg))
        turn_rad = min(max(limits.gate_sigmas * sigma_rad, least_rad), np.pi)
        return self._placed(query, self._far.look(query, others, self._solution.poses, turn_rad))

    def _rejoin(self, index: int) -> int:
        """Look for a key frame in all that is not joined to its part of the map."""
        if not self._apart.due(self._path_m(index)):
            return 0
        parts = self._solution.parts
        part, submaps = parts.of(index), enumerate(self._cutter.submaps)
        others = {n: submap for n, submap in submaps if parts.of(submap.anchor) != part}
        if not others:
            return 0
        query = self._cutter.query(index, LOOK_TRAVEL_M, LOOK_KEYFRAMES)
        return self._placed(query, self._apart.look(query, others, self._solution.poses))

    def _placed(self, query: Submap, places: Sequence[tuple[int, FloatArray]]) -> int:
        """Closures of a query with the submaps in which a search of the whole map found it."""
        found = 0
        for number, T_submap_query in places:
            anchor = self._cutter.submaps[number].anchor
            around = self._cutter.around(anchor, LOOK_TRAVEL_M)
            closure = self._told(self._finder.placed(query, number, around, T_submap_query))
            if closure is not None:
                found += self._weigh(closure)
        return found

    def _find(self, query: Submap, number: int, expected: Expected) -> Closure | None:
        """A verified match of the query with a submap."""
        submap, noise_m = self._cutter.submaps[number], self._cutter.noise_m
        return self._told(self._finder.find(query, number, submap, expected, noise_m))

    def _told(self, closure: Closure | Refusal) -> Closure | None:
        """The closure; why there is none is counted."""
        if isinstance(closure, Closure):
            return closure
        self.refusals[closure] += 1
        return None

    def _failed_before(self, number: int, index: int, expected: Expected) -> bool:
        """Whether the same search from nearly the same place led nowhere."""
        before = self._failures.get((number, index))
        return before is not None and _is_near(before, expected.T_submap_query)

    def _weigh(self, closure: Closure) -> int:
        """Believe an expected closure at once, a surprising one when others agree; how many count
        now."""
        accepted: Sequence[Closure] = [closure]
        if not closure.expected:
            accepted = self._waiting.add(closure, self._solution.poses)
        count = 0
        for one in accepted:
            pair = (one.submap, one.edge.target)
            if self._looks_alike(one.edge):
                self.refusals["contradiction"] += 1
            elif pair not in self._closed:  # it may have been found again while it waited
                self._closed.add(pair)
                self._solution.close(one)
                self._new.append(one.edge)
                count += 1
        return count

    def _looks_alike(self, edge: GraphEdge) -> bool:
        """Whether a closure finds the robot elsewhere past doubts none of which is left: what was
        seen after them follows on what was seen before."""
        undecided = self._solution.parts.open_between(edge.source, edge.target)
        return bool(undecided) and not self._solution.may_be(edge)

    def _path_m(self, index: int) -> float:
        return self._cutter.keyframes[index].path_m


def _is_near(T_submap_before: FloatArray, T_submap_query: FloatArray) -> bool:
    """Whether a search would find the same from both."""
    moved = between(T_submap_before, T_submap_query)
    return bool(np.hypot(moved[0], moved[1]) < MOVED_M and abs(moved[2]) < MOVED_RAD)
