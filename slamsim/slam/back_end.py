"""The back end: key frames, submaps, closures, and the graph that joins them."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.geometry import between, compose, inverse
from slamsim.progress import Progress, silent
from slamsim.slam.agreement import WaitingClosures
from slamsim.slam.bundle import NotRefined, refine
from slamsim.slam.calibration_solve import Solved
from slamsim.slam.candidates import CandidateIndex
from slamsim.slam.closure import Closure, ClosureFinder, Expected
from slamsim.slam.estimate import Estimate
from slamsim.slam.graph import PoseGraphSolver, variance_factor
from slamsim.slam.health import CARRIED, carried, loose_joints, tears
from slamsim.slam.keyframes import Keyframe, chain_edge, odometry_edge
from slamsim.slam.marginals import in_own_frame, relative_covariances
from slamsim.slam.odometry import ELSEWHERE
from slamsim.slam.parts import Parts
from slamsim.slam.recalibrate import Recalibration
from slamsim.slam.rejoin import Rejoiner, moved_onto
from slamsim.slam.steps import OdometryNoise, OdometryStep
from slamsim.slam.submaps import Submap, Surfaces, make_submap, submap_is_full
from slamsim.slam.visits import Visits
from slamsim.types import Event, FloatArray, GraphEdge, PlanarTrajectory, PoseGraph

UPDATE_AFTER_KEYFRAMES = 10
RENEW_AFTER_KEYFRAMES = 20
RENEW_AFTER_SHARE = 0.1
KNOWN_TRAVEL_M = 3.0
REJOIN_TRAVEL_M = 6.0
MOVED_M = 0.15
MOVED_RAD = 0.03
SURPRISE_M = 0.1
SURPRISE_RAD = 0.03
CALIBRATION_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """T_map_base: (3,) of a key frame as the closures known by now have it. covariance: (3, 3)
    relative to the first key frame, of a small step of the base in its own frame. keyframe: its
    index as it came."""

    keyframe: int
    T_map_base: FloatArray
    covariance: FloatArray


class BackEnd:
    """Takes one key frame after the other, and keeps the map in one piece."""

    def __init__(self, config: SlamConfig, gyro: bool) -> None:
        self._config = config.back_end
        self._motion = config.front_end.motion
        self._odometry_noise = OdometryNoise(self._motion)
        self.calibration: Solved | None = None
        """Of wheels and gyroscope, once finished; None without odometry."""
        self._finder = ClosureFinder(self._config)
        self._waiting = WaitingClosures(
            self._config.closures.min_support, self._config.closures.query_travel_m
        )
        self._scratch = Surfaces()
        self._estimate = Estimate()
        self._keyframes: list[Keyframe] = []
        self._taken: list[int] = []
        self._passed: list[OdometryStep | None] = []
        self._visits = Visits()
        self._parts = Parts()
        self._rejoiner = Rejoiner(self._config)
        self._graph = PoseGraphSolver(self._config.graph)
        self._submaps: list[Submap] = []
        self._candidates = CandidateIndex(self._config.closures)
        self._submap_from = 0
        self._noise_m = 0.0
        self._updated_keyframes = 0
        self._unsolved: list[Closure] = []
        self._new: list[GraphEdge] = []
        self._closed: set[tuple[int, int]] = set()
        self._carried: list[Event] = []
        self._unrefined = ""
        self._failures: dict[tuple[int, int], FloatArray] = {}
        self.unrefined = np.zeros((0, 3))
        """(n, 3) T_map_base of the key frames when the last closures were in."""
        self.refusals: Counter[str] = Counter()
        """Why closures were not believed, and how often."""
        self.seconds: defaultdict[str, float] = defaultdict(float)
        """Time spent per stage."""

    def take(self, keyframe: Keyframe) -> None:
        """Join one more key frame, and search where it was seen before.

        Where the robot has often been, only one in a few metres is kept, to hold the pose.
        """
        known = self._visits.enough(self._placed(keyframe), keyframe.path_m)
        if known and not self._needed(keyframe):
            self._passed.append(keyframe.odometry)
            return
        with self._timed("key frames"):
            keyframe = self._join(self._cut_off(keyframe))
            self._cut_submaps(keyframe, known)
        if self._config.closures.enabled:
            with self._timed("closures"):
                self._close_loops(keyframe.index)
        if self._due():
            with self._timed("solve"):
                self._update()

    def restore(
        self,
        keyframes: Iterable[Keyframe],
        closures: Sequence[GraphEdge],
        kept: Container[int] | None = None,
        poses: FloatArray | None = None,
    ) -> None:
        """Begin with key frames and the closures found among them in another back end's time.

        kept: the indices of those that it kept, None for all. poses: (n, 3) of its solution.
        """
        for keyframe in keyframes:
            if kept is not None and keyframe.index not in kept:
                self._passed.append(keyframe.odometry)
                continue
            known = self._visits.enough(self._placed(keyframe), keyframe.path_m)
            self._cut_submaps(self._join(keyframe), known)
        if poses is not None:
            self._estimate.move(poses)
        numbers = {submap.anchor: number for number, submap in enumerate(self._submaps)}
        for edge in closures:
            if edge.source in numbers:
                self._enter(edge, numbers[edge.source])
        if closures:
            self._estimate.move(self._graph.update(self._estimate.poses))
            self._estimate.renew_covariances(self._graph.edges)

    @property
    def keyframes(self) -> Sequence[Keyframe]:
        """Those that were kept, numbered as in the graph."""
        return self._keyframes

    @property
    def loose_parts(self) -> int:
        """How many parts of the map nothing joins to the first."""
        return self._parts.loose

    @property
    def kept(self) -> list[int]:
        """Which key frames were kept, by their indices as they came."""
        return self._taken

    def new_closures(self) -> tuple[GraphEdge, ...]:
        """Those that came to count since this was last asked."""
        new = tuple(self._new)
        self._new.clear()
        return new

    def correction(self) -> Correction | None:
        """Where the newest key frame is by now, None before the first."""
        if not self._keyframes:
            return None
        last = len(self._keyframes) - 1
        covariance = self._estimate.covariance(0, last)
        return Correction(self._taken[last], self._estimate.poses[last].copy(), covariance)

    def finish(self, progress: Progress = silent) -> PoseGraph:
        """The final solution, after searching again wherever the estimate is better by now."""
        with self._timed("solve"):
            self._solve()
        rounds = self._config.closures.rounds if self._config.closures.enabled else 0
        for number in range(rounds):
            begun = number * len(self._keyframes)
            with self._timed("closures"):
                found = self._search_all(progress, begun, rounds * len(self._keyframes))
            if not found:
                break
            with self._timed("solve"):
                self._solve()
        self.refusals["unsupported"] += self._waiting.forget(np.inf)
        with self._timed("calibrate"):
            self._calibrate()
        self.unrefined = self.poses
        covariances = None
        if self._config.refinement.enabled and len(self._keyframes) > 1:
            with self._timed("refine"):
                covariances = self._refine()
        return self._pose_graph(covariances)

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base of the key frames as estimated by now."""
        return self._estimate.poses.copy()

    @property
    def accepted(self) -> int:
        """Closures that hold the map together by now."""
        return sum(edge.weight > 0.0 for edge in self._closures())

    @property
    def rejected(self) -> int:
        """Matches that were found but not believed, or believed and withdrawn."""
        withdrawn = len(self._closures()) - self.accepted
        return self.refusals.total() - self.refusals["score"] + withdrawn

    def events(self, graph: PoseGraph) -> tuple[Event, ...]:
        """What is wrong with the finished map, and where it was driven."""
        stamps_ns = graph.keyframes.stamps_ns
        whole = (int(stamps_ns[0]), int(stamps_ns[-1]))
        unrefined = [Event(*whole, "unrefined", self._unrefined)] if self._unrefined else []
        with self._timed("check"):
            around = partial(self._query, travel_m=self._config.closures.query_travel_m)
            torn = tears(around, self._submaps, graph.keyframes, self._config.submaps)
            return (*self._carried, *loose_joints(graph), *torn, *unrefined)

    def _cut_off(self, keyframe: Keyframe) -> Keyframe:
        """A doubtful key frame that contradicts what was seen just before may be anywhere."""
        if keyframe.doubt_ns is None or keyframe.broken or not self._keyframes:
            return keyframe
        before = self._query(len(self._keyframes) - 1, self._config.closures.query_travel_m)
        now = make_submap([keyframe], 0, self._scratch, keyframe.noise_m)
        T = between(self._keyframes[-1].T_map_base, keyframe.T_map_base)
        if not carried(before, now, T, self._config.submaps):
            return keyframe
        self._carried.append(Event(keyframe.doubt_ns, keyframe.stamp_ns, "kidnapped", CARRIED))
        return replace(keyframe, restart=ELSEWHERE)

    def _placed(self, keyframe: Keyframe) -> FloatArray:
        """Where a key frame that is not joined yet should be."""
        if not self._keyframes:
            return keyframe.T_map_base
        step = between(self._keyframes[-1].T_map_base, keyframe.T_map_base)
        return compose(self._estimate.poses[-1], step)

    def _needed(self, keyframe: Keyframe) -> bool:
        """Whether a key frame must be kept, though all that it sees was mapped already."""
        if keyframe.broken or keyframe.doubt_ns is not None or not self._keyframes:
            return True
        return keyframe.path_m - self._keyframes[-1].path_m >= KNOWN_TRAVEL_M

    def _join(self, keyframe: Keyframe) -> Keyframe:
        """The key frame under its number in the graph."""
        self._taken.append(keyframe.index)
        odometry = _chained([*self._passed, keyframe.odometry])
        keyframe = replace(keyframe, index=len(self._keyframes), odometry=odometry)
        self._passed.clear()
        if not self._keyframes:
            self._estimate.begin(keyframe.T_map_base)
        else:
            edge = chain_edge(
                self._keyframes[-1], keyframe, self._odometry_noise, self._config.graph
            )
            self._graph.add(edge)
            self._estimate.extend(edge)
        if keyframe.kidnapped and keyframe.index:
            self._parts.begin(keyframe.index)
        self._keyframes.append(keyframe)
        self._noise_m = keyframe.noise_m
        self._visits.add(self._estimate.poses[-1], keyframe.path_m)
        return keyframe

    def _cut_submaps(self, keyframe: Keyframe, known: bool) -> None:
        """Finish the open submap when it is full or the chain broke; the next overlaps it.

        What is known lies in other submaps already.
        """
        if keyframe.broken or known:
            if keyframe.index - self._submap_from >= 2:
                self._finish_submap(keyframe.index)
            self._submap_from = keyframe.index + known
            return
        members = self._keyframes[self._submap_from :]
        if len(members) >= 2 and submap_is_full(members, self._config.submaps):
            self._finish_submap(keyframe.index + 1)
            self._submap_from += len(members) // 2

    def _finish_submap(self, end: int) -> None:
        members = self._keyframes[self._submap_from : end]
        middle = len(members) // 2
        submap = make_submap(members, middle, self._scratch, self._noise_m)
        self._submaps.append(submap)
        self._candidates.add(submap)

    def _query(self, index: int, travel_m: float) -> Submap:
        """The key frame with those just before it."""
        first = index
        far_m = self._keyframes[index].path_m - travel_m
        while (
            first > 0
            and not self._keyframes[first].broken
            and self._keyframes[first - 1].path_m >= far_m
            and index - first < self._config.submaps.max_keyframes
        ):
            first -= 1
        members = self._keyframes[first : index + 1]
        return make_submap(members, len(members) - 1, self._scratch, self._noise_m)

    def _close_loops(self, index: int) -> int:
        """Search the submaps that may overlap with a key frame; how many closures came of it."""
        self.refusals["unsupported"] += self._waiting.forget(self._keyframes[index].path_m)
        query = self._query(index, self._config.closures.query_travel_m)
        found = 0
        for number in self._candidates.of(query, self._estimate):
            if self._parts.of(self._submaps[number].anchor) != self._parts.of(index):
                continue
            expected = self._expected(number, index)
            if (number, index) in self._closed or self._failed_before(number, index, expected):
                continue
            closure = self._finder.find(
                query, number, self._submaps[number], expected, self._noise_m
            )
            if isinstance(closure, Closure):
                found += self._weigh(closure)
            else:
                self.refusals[closure] += 1
                self._failures[number, index] = expected.T_submap_query
        return found + (self._rejoin(index) if self._parts.loose else 0)

    def _rejoin(self, index: int) -> int:
        """Look for a key frame in all that is not joined to its part of the map."""
        part = self._parts.of(index)
        others = [
            (number, submap)
            for number, submap in enumerate(self._submaps)
            if self._parts.of(submap.anchor) != part
        ]
        if not others or not self._rejoiner.due(self._keyframes[index].path_m):
            return 0
        query = self._query(index, REJOIN_TRAVEL_M)
        found = 0
        for number, expected in self._rejoiner.look(query, part, others, self._estimate.poses):
            closure = self._finder.find(
                query, number, self._submaps[number], expected, self._noise_m
            )
            if isinstance(closure, Closure):
                found += self._weigh(replace(closure, expected=False))
            else:
                self.refusals[closure] += 1
        return found

    def _failed_before(self, number: int, index: int, expected: Expected) -> bool:
        """Whether the same search from nearly the same place led nowhere."""
        before = self._failures.get((number, index))
        if before is None:
            return False
        moved = between(before, expected.T_submap_query)
        return bool(np.hypot(moved[0], moved[1]) < MOVED_M and abs(moved[2]) < MOVED_RAD)

    def _expected(self, number: int, index: int) -> Expected:
        anchor = self._submaps[number].anchor
        poses = self._estimate.poses
        T_submap_query = between(poses[anchor], poses[index])
        return Expected(T_submap_query, self._estimate.covariance(anchor, index))

    def _weigh(self, closure: Closure) -> int:
        """Believe an expected closure at once, a surprising one when others agree."""
        if closure.expected:
            accepted = [closure]
        else:
            accepted = list(self._waiting.add(closure, self._estimate.poses))
        count = 0
        for one in accepted:
            pair = (one.submap, one.edge.target)
            if pair not in self._closed:  # it may have been found again while it waited
                self._enter(one.edge, one.submap)
                self._new.append(one.edge)
                self._unsolved.append(one)
                count += 1
        return count

    def _enter(self, edge: GraphEdge, submap: int) -> None:
        """A closure that counts; if it joins two parts of the map, one is carried to the other."""
        source, target = edge.source, edge.target
        if self._parts.of(source) != self._parts.of(target):
            poses = self._estimate.poses
            if self._parts.of(target) < self._parts.of(source):
                members = self._parts.members(source, len(poses))
                T_new = compose(poses[target], inverse(edge.T_source_target))
                poses = moved_onto(poses, members, T_new, poses[source])
            else:
                members = self._parts.members(target, len(poses))
                T_new = compose(poses[source], edge.T_source_target)
                poses = moved_onto(poses, members, T_new, poses[target])
            self._estimate.move(poses)
            self._graph.begin_anew()
            self._parts.join(source, target)
        self._closed.add((submap, target))
        self._graph.add(edge)

    def _due(self) -> bool:
        """Whether a solution now would help the search for the next closures."""
        if not self._unsolved:
            return False
        since = len(self._keyframes) - self._updated_keyframes
        if since >= UPDATE_AFTER_KEYFRAMES:
            return True
        edges = [closure.edge for closure in self._unsolved]
        poses = self._estimate.poses
        now = between(poses[[e.source for e in edges]], poses[[e.target for e in edges]])
        step = between(np.array([edge.T_source_target for edge in edges]), now)
        surprise_m, surprise_rad = np.hypot(step[:, 0], step[:, 1]).max(), np.abs(step[:, 2]).max()
        return bool(surprise_m > SURPRISE_M or surprise_rad > SURPRISE_RAD)

    def _update(self) -> None:
        """Let the new closures move the estimate; now and then, renew its uncertainties."""
        poses = self._graph.update(self._estimate.poses)
        self._estimate.move(poses)
        self._updated_keyframes = len(self._keyframes)
        opened = not all(closure.expected for closure in self._unsolved)
        self._unsolved.clear()
        grown = len(self._keyframes) - self._estimate.solved_count
        if opened or grown >= RENEW_AFTER_KEYFRAMES + RENEW_AFTER_SHARE * len(self._keyframes):
            self._estimate.renew_covariances(self._graph.edges)

    def _solve(self) -> None:
        """The full solution."""
        self._estimate.move(self._graph.solve(self._estimate.poses))
        self._estimate.renew_covariances(self._graph.edges)
        self._unsolved.clear()

    def _search_all(self, progress: Progress, begun: int, whole: int) -> int:
        """Search again from each key frame that no closure holds yet; how many were found."""
        closed = {edge.target for edge in self._closures() if edge.weight > 0.0}
        found = 0
        for keyframe in self._keyframes:
            progress(begun + keyframe.index + 1, whole)
            if keyframe.index not in closed:
                found += self._close_loops(keyframe.index)
        return found

    def _closures(self) -> list[GraphEdge]:
        return [edge for edge in self._graph.edges if edge.kind == "closure"]

    def _calibrate(self) -> None:
        """Calibrate the odometry by all key frames; what only odometry held moves with it."""
        recalibration = Recalibration(self._keyframes, self._motion)
        if recalibration.solved is None:
            return
        for _ in range(CALIBRATION_ROUNDS if recalibration.moves_chain else 0):
            self._graph.renew(recalibration.chain(self._config.graph))
            self._solve()
            recalibration.close(self.poses, self._graph.edges)
        self._keyframes = recalibration.keyframes()
        self.calibration = recalibration.solved
        self._odometry_noise = recalibration.solved.noise

    def _refine(self) -> FloatArray | None:
        """Move the key frames to where all views agree best; their covariances, or None."""
        odometry = [
            odometry_edge(before, after, self._odometry_noise)
            for before, after in pairwise(self._keyframes)
        ]
        views = [keyframe.view for keyframe in self._keyframes]
        try:
            refined = refine(views, self.poses, odometry, self._noise_m, self._graph.edges)
        except NotRefined as refusal:
            self._unrefined = str(refusal)
            return None
        self._estimate.move(refined.poses)
        return refined.covariances

    def _pose_graph(self, covariances: FloatArray | None) -> PoseGraph:
        """The result. Without covariances, those of the graph, scaled by how well its closures fit
        what was claimed."""
        poses, edges = self.poses, self._graph.edges
        if covariances is None:
            in_map = relative_covariances(poses, edges, 0, np.zeros(2))
            covariances = in_own_frame(poses, in_map) * variance_factor(poses, edges)
        stamps_ns = np.array([k.stamp_ns for k in self._keyframes], dtype=np.int64)
        return PoseGraph(PlanarTrajectory(stamps_ns, poses), covariances, tuple(edges))

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] += time.perf_counter() - start


def _chained(steps: Sequence[OdometryStep | None]) -> OdometryStep | None:
    """One step after the other, None if one of them is not known."""
    whole = steps[0]
    for step in steps[1:]:
        whole = None if whole is None or step is None else whole.then(step)
    return whole
