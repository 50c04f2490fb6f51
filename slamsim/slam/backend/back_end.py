"""The back end: key frames, submaps, closures, and the graph that joins them."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.progress import Progress, silent
from slamsim.core.result import Event, GraphEdge, MapGraph
from slamsim.core.types import FloatArray, IntArray, PlanarPoses
from slamsim.process.children import return_freed_memory
from slamsim.slam.backend.bundle import NotRefined
from slamsim.slam.backend.correction import Correction
from slamsim.slam.backend.graph import variance_factor
from slamsim.slam.backend.marginals import relative_covariances
from slamsim.slam.backend.refinement import refine_keyframes
from slamsim.slam.backend.solution import Solution
from slamsim.slam.backend.surface_information import SurfaceInformation
from slamsim.slam.calibration.recalibrate import Recalibration
from slamsim.slam.calibration.solve import Solved
from slamsim.slam.closures.images import ImageCandidates
from slamsim.slam.closures.pending import witnesses
from slamsim.slam.closures.search import ClosureSearch
from slamsim.slam.closures.submap_cutter import SubmapCutter
from slamsim.slam.closures.submaps import WALL_MARGIN_M, Submap
from slamsim.slam.closures.visits import Visits, spacing_m
from slamsim.slam.closures.whole_part import WholeParts
from slamsim.slam.failures import Failures
from slamsim.slam.frontend.keyframes import LEAST_MOTION, Keyframe, begins_drive, chain_edge
from slamsim.slam.frontend.odometry import CARRIED, ELSEWHERE
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep, then
from slamsim.slam.mapping.health import (
    AFTERWARDS,
    EVERY_KEYFRAMES,
    Usual,
    carried,
    contradicts_what_was_before,
    follows_on,
    tears,
)
from slamsim.slam.mapping.joints import SURE_SIGMAS, doubtful_joints, open_loops

CALIBRATION_ROUNDS = 2

BENT_HERE = (
    "all that was seen before and after would fit best if the robot had moved otherwise here than "
    "the odometry has it: it may have been carried, and the map be torn there"
)


class BackEnd:
    """Takes one key frame after the other, and keeps the map in one piece.

    images: candidates for closures that images tell, in addition to those of the estimate.
    """

    def __init__(self, config: SlamConfig, images: ImageCandidates | None = None) -> None:
        self._config = config.back_end
        self._motion = config.front_end.motion
        self._odometry_noise = OdometryNoise(self._motion)
        self.calibration: Solved | None = None
        """Of wheels and gyroscope, once finished; None without odometry."""
        self._cutter = SubmapCutter(self._config.submaps)
        self._solution = Solution(self._config.graph)
        images = images or ImageCandidates()
        self._search = ClosureSearch(self._config, self._cutter, self._solution, images)
        self._taken: list[int] = []
        self._passed: list[OdometryStep | None] = []
        self._visits = Visits()
        self._found = False
        """Whether closures hold the last key frame."""
        self._held = 0
        self._suspected: list[Event] = []
        self._refusal: NotRefined | None = None
        self.information: SurfaceInformation | None = None
        """What holds the key frames, once finished and refined."""
        self.unrefined = np.zeros((0, 3))
        """(n, 3) T_map_base of the key frames when the last closures were in."""
        self.failures = Failures()
        """Stages that failed; what stood before them is the result."""
        self.seconds: defaultdict[str, float] = defaultdict(float)
        """Time spent per stage."""

    def take(self, keyframe: Keyframe) -> None:
        """Join one more key frame, and search where it was seen before.

        Where the robot has often been, only one in a few metres is kept, to hold the pose.
        """
        apart_m = self._apart_m(keyframe)
        if not self._needed(keyframe, apart_m):
            self._passed.append(keyframe.odometry)
            return
        with self._timed("key frames"):
            self._join(self._cut_off(keyframe), known=apart_m > 0.0)
        if self._config.closures.enabled:
            self._found = False  # if the search fails
            with self._stage("closures"):
                self._found = self._search.search(len(self.keyframes) - 1) > 0
        if self._solution.due():
            with self._stage("solve"):
                self._solution.update()

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
        closed = {edge.target for edge in closures}
        for keyframe in keyframes:
            self._found = len(self.keyframes) - 1 in closed
            apart_m = self._apart_m(keyframe)
            if kept is not None and keyframe.index not in kept:
                self._passed.append(keyframe.odometry)
            else:
                self._join(keyframe, known=apart_m > 0.0)
        if poses is not None:
            self._solution.estimate.move(poses)
        if closures:
            self._search.restore(closures)
            self._solution.take_up()

    def hold(self, keyframes: Iterable[Keyframe], poses: FloatArray) -> None:
        """Begin with a finished map, whose key frames stay at their ``poses`` (n, 3)."""
        for keyframe in keyframes:
            self._join(keyframe, known=False)
        self._held = len(self.keyframes)
        self._solution.hold(poses)

    @property
    def keyframes(self) -> Sequence[Keyframe]:
        """Those that were kept, numbered as in the graph."""
        return self._cutter.keyframes

    @property
    def kept(self) -> list[int]:
        """Which key frames were kept, by their indices as they came."""
        return self._taken

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base of the key frames as estimated by now."""
        return self._solution.poses.copy()

    @property
    def accepted(self) -> int:
        """Closures that hold the map together by now."""
        return sum(edge.weight > 0.0 for edge in self._solution.closures)

    @property
    def rejected(self) -> int:
        """Matches that were found but not believed, or believed and withdrawn."""
        withdrawn = len(self._solution.closures) - self.accepted
        return self.refusals.total() - self.refusals["score"] + withdrawn

    @property
    def refusals(self) -> Counter[str]:
        """Why closures were not believed, and how often."""
        return self._search.refusals

    def new_closures(self) -> tuple[GraphEdge, ...]:
        """Those that came to count since this was last asked."""
        return self._search.new_closures()

    def correction(self) -> Correction | None:
        """Where the newest key frame is by now, None before the first."""
        if not self.keyframes:
            return None
        last = len(self.keyframes) - 1
        covariance = self._solution.estimate.covariance(0, last)
        parts, pose = self._solution.parts, self._solution.poses[last].copy()
        return Correction(self._taken[last], pose, covariance, parts.of(last) == parts.of(0))

    def finish(self, progress: Progress = silent) -> MapGraph:
        """The final solution, after searching again wherever the estimate is better by now."""
        with self._stage("solve"):
            self._solution.solve()
        self._close_what_is_open(progress)
        if self._place_whole_parts():
            self._close_what_is_open(progress)
        self._search.forget_grids()
        return_freed_memory()
        with self._stage("join"):
            self._settle()
        with self._stage("calibrate"):
            self._calibrate()
        self.unrefined, covariances = self.poses, None
        if self._config.refinement.enabled and len(self.keyframes) > 1:
            with self._stage("refine"):
                covariances = self._refine()
        if covariances is None:
            covariances = self._graph_covariances()
        with self._stage("set apart"):
            self._solution.set_apart(self._cutter.submaps)
        return_freed_memory()
        stamps_ns = np.array([k.stamp_ns for k in self.keyframes], dtype=np.int64)
        keyframes = PlanarPoses(stamps_ns, self.poses)
        return MapGraph(keyframes, covariances, tuple(self._solution.edges))

    def events(self, graph: MapGraph) -> tuple[Event, ...]:
        """What is wrong with the finished map, and where it was driven."""
        stamps_ns = graph.keyframes.stamps_ns
        whole = (int(stamps_ns[0]), int(stamps_ns[-1]))
        refusal, unrefined, torn = self._refusal, list[Event](), list[Event]()
        if refusal is not None:
            unrefined.append(Event(*whole, "unrefined", str(refusal)))
            if (bent := refusal.bent_after) is not None:
                torn.append(
                    Event(int(stamps_ns[bent]), int(stamps_ns[bent + 1]), "torn", BENT_HERE)
                )
        with self._stage("check"):
            around = self._around
            submaps, size = self._cutter.submaps, self._config.submaps
            own = self.keyframes[max(self._held, 1) :]
            doubts = [k.index for k in own if k.doubt_ns and not k.broken]
            drives = {two.index for one, two in pairwise(self.keyframes) if begins_drive(one, two)}
            torn += doubtful_joints(graph, drives)
            torn += open_loops(graph, self._held)
            usual = Usual(around, self.keyframes, doubts, size)
            torn += tears(around, submaps, graph, size, doubts, usual, self._held)
        withdrawn = self.withdrawn_ns
        kidnapped = (event for event in self._suspected if event.end_ns not in withdrawn)
        return (*kidnapped, *torn, *unrefined)

    @property
    def withdrawn_ns(self) -> frozenset[int]:
        """Stamps of the key frames before which the robot may have been carried, and was not."""
        begun = self._solution.parts.withdrawn
        return frozenset(self.keyframes[number].stamp_ns for number in begun)

    def _apart_m(self, keyframe: Keyframe) -> float:
        """Path from one key frame to the next to keep where this one is, 0 where all are."""
        T_map_base = keyframe.T_map_base
        if self.keyframes:
            step = between(self.keyframes[-1].T_map_base, T_map_base)
            T_map_base = compose(self._solution.poses[-1], step)
        return spacing_m(self._visits.passes(T_map_base, keyframe.path_m), self._found)

    def _needed(self, keyframe: Keyframe, apart_m: float) -> bool:
        """Whether a key frame must be kept, though what it sees may be mapped already."""
        if keyframe.broken or keyframe.doubt_ns is not None or not self.keyframes:
            return True
        return keyframe.path_m - self.keyframes[-1].path_m >= apart_m

    def _cut_off(self, keyframe: Keyframe) -> Keyframe:
        """Before a doubtful key frame that contradicts what was seen just before, the robot may
        have been carried."""
        if keyframe.doubt_ns is None or keyframe.broken or not self.keyframes:
            return keyframe
        last = len(self.keyframes) - 1
        before = self._around(last)
        T_before_now = between(self.keyframes[last].T_map_base, keyframe.T_map_base)
        now = self._cutter.alone(keyframe)
        if not carried(before, now, T_before_now, self._config.submaps):
            return keyframe
        event = Event(keyframe.doubt_ns, keyframe.stamp_ns, "kidnapped", CARRIED)
        self._suspected.append(event)
        if keyframe.odometry is None:
            return replace(keyframe, restart=ELSEWHERE)
        noise = self._odometry_noise.covariance(keyframe.odometry) + LEAST_MOTION
        return replace(keyframe, restart=noise, suspect=True)

    def _join(self, keyframe: Keyframe, known: bool) -> None:
        """Give a key frame its number, and its place in the graph and in a submap."""
        self._taken.append(keyframe.index)
        odometry = reduce(then, [*self._passed, keyframe.odometry])
        self._passed.clear()
        keyframe = replace(keyframe, index=len(self.keyframes), odometry=odometry)
        if not self.keyframes:
            self._solution.begin(keyframe.T_map_base)
        else:
            before = self.keyframes[-1]
            edge = chain_edge(before, keyframe, self._odometry_noise, self._config.graph)
            apart = keyframe.kidnapped or keyframe.suspect
            self._solution.extend(edge, apart, linked=not keyframe.kidnapped)
        submap = self._cutter.add(keyframe, known)
        if submap is not None:
            self._search.offer(submap)
        self._look_back()

    def _look_back(self) -> None:
        """Once the metres after a doubt are seen: do they follow on what was seen before it?

        Then a closure that finds them elsewhere was misled by a place that looks alike, and all of
        the run has to say otherwise, see ``_settle``.
        """
        begin, parts = len(self.keyframes) - AFTERWARDS, self._solution.parts
        doubted = parts.doubted_between(begin - 1, begin)
        if doubted and follows_on(self._around, self.keyframes, begin, self._config.submaps):
            parts.follow(begin)

    def _close_what_is_open(self, progress: Progress) -> None:
        """Search and solve in turn, until no more is found."""
        rounds = self._config.closures.rounds if self._config.closures.enabled else 0
        for number in range(rounds):
            begun = number * len(self.keyframes)
            if not self._search_all(progress, begun, rounds * len(self.keyframes)):
                break
            with self._stage("solve"):
                self._solution.solve()
        self._search.give_up_waiting()

    def _place_whole_parts(self) -> bool:
        """Put each part of the drive where all of it fits best in the map; whether any moved.

        The map is the one that was finished before, or what was seen before the robot was carried
        for the first time; what nothing joins to that may lie on new ground, and stays apart.
        """
        moved: list[IntArray] = []
        unknown = self._solution.parts.carried_to
        self._lose_odometry(unknown)
        held = self._held or min(unknown, default=0)
        if not held:
            return False
        with self._stage("whole parts"):
            submaps = self._cutter.submaps
            poses, keyframes = self._solution.poses.copy(), self.keyframes
            whole = WholeParts(self._config, keyframes, submaps, poses, held)
            moved, carried_to = whole.settle(self._solution, only_joined=not self._held)
            for begin in carried_to:
                first = keyframes[begin]
                since_ns = first.doubt_ns or first.stamp_ns
                if not first.suspect:  # else it was told before
                    self._suspected.append(Event(since_ns, first.stamp_ns, "kidnapped", CARRIED))
                self._cutter.keyframes[begin] = replace(first, restart=ELSEWHERE)
            for members in moved:
                self._search.forget(members)
            self._solution.solve()
        return bool(moved)

    def _search_all(self, progress: Progress, begun: int, whole: int) -> int:
        """Search again from each key frame that no closure holds yet; how many were found."""
        closed = {edge.target for edge in self._solution.closures if edge.weight > 0.0}
        found = 0
        for keyframe in self.keyframes[self._held :]:
            progress(begun + keyframe.index + 1, whole)
            if keyframe.index not in closed:
                with self._stage("closures", keyframe.index):
                    found += self._search.search(keyframe.index)
        return found

    def _around(self, index: int) -> Submap:
        """What was seen on the last metres up to a key frame."""
        return self._cutter.query(index, self._config.closures.query_travel_m)

    def _settle(self) -> None:
        """Decide of the runs that odometry links and no closure joins, whether they follow on.

        They do unless what was seen anywhere on the run contradicts the map where odometry puts it:
        then the robot was carried. If only what was seen on the metres after contradicts what was
        seen before, it may have been: that is told, and the run stays where odometry has it, on new
        ground. A slope does the same to scans, and what is set apart is lost to the map. In a map
        that is held a guess is of no use: there it is unknown where such a run lies.
        """
        parts, count = self._solution.parts, len(self.keyframes)
        undecided = parts.open_between(0, count)
        usual = Usual(self._around, self.keyframes, undecided, self._config.submaps)
        for begin in undecided:
            if self._contradicts_map(begin, usual):
                self._solution.loosen(begin)
            elif not usual.is_carried_to(begin):
                parts.withdraw(begin)
            elif self._held:
                self._solution.loosen(begin)
            else:
                parts.leave(begin)
        self._lose_odometry(parts.carried_to)
        if set(undecided).intersection(parts.carried_to):
            self._solution.solve()

    def _contradicts_map(self, begin: int, usual: Usual) -> bool:
        """Whether the run that begins here contradicts the map where odometry puts it.

        Only that of which the run before tells where it is: once that one was carried to, odometry
        says nothing of the map from before it; and where the run may have drifted across a wall, as
        after a kilometre without a loop, that it lies across what was seen before is the drift.
        """
        parts, poses, size = self._solution.parts, self._solution.poses, self._config.submaps
        run = range(begin, parts.end(begin, len(self.keyframes)), EVERY_KEYFRAMES)
        near = self._search.within_reach(self._around(begin))
        known = [one for one in near if parts.linked(one.last, begin - 1)]

        def sure(anchor: int, number: int) -> bool:
            return self._drift_m(anchor, begin, number) <= WALL_MARGIN_M

        return contradicts_what_was_before(self._around, known, poses, size, usual, run, sure)

    def _drift_m(self, anchor: int, begin: int, number: int) -> float:
        """How far a key frame of the run that begins at one may, with 95 %, be off as seen from an
        earlier key frame, if the run begins where odometry has it."""
        before = self._solution.expected(anchor, begin - 1).covariance
        within = self._solution.expected(begin, number).covariance
        carry = adjoint(between(self._solution.poses[number], self._solution.poses[begin - 1]))
        variances = np.linalg.eigvalsh((carry @ before @ carry.T + within)[:2, :2])
        return SURE_SIGMAS * float(np.sqrt(variances[1]))

    def _lose_odometry(self, carried_to: Iterable[int]) -> None:
        """Nothing tells where these key frames are, seen from the ones before."""
        for number in carried_to:
            keyframe = self.keyframes[number]
            if keyframe.suspect:
                self._cutter.keyframes[number] = replace(keyframe, restart=ELSEWHERE)

    def _calibrate(self) -> None:
        """Calibrate the odometry by all key frames; what only odometry held moves with it."""
        recalibration = Recalibration(self.keyframes[self._held :], self._motion)
        if recalibration.solved is None:
            return
        if recalibration.moves_chain:
            before, poses = self._solution.believed, self.poses
            self._solve_calibrated(recalibration, poses)
            lost = before - self._solution.believed
            are_evidence = self._witnesses(lost) >= self._config.closures.min_support
            if are_evidence and recalibration.doubt_unseen_noise():
                self._solve_calibrated(recalibration, poses)
        self._cutter.keyframes[self._held :] = recalibration.keyframes()
        self.calibration = recalibration.solved
        self._odometry_noise = recalibration.solved.noise

    def _witnesses(self, closures: set[tuple[int, int]]) -> int:
        """How many of closures (source, target) share no scans."""
        seen = [(self.keyframes[target].path_m, 1) for _, target in closures]
        return witnesses(seen, self._config.closures.query_travel_m)

    def _solve_calibrated(self, recalibration: Recalibration, begin: FloatArray) -> None:
        """Poses, sought from ``begin`` (n, 3), and calibration in turn, each given the other."""
        for _ in range(CALIBRATION_ROUNDS):
            self._solution.solve_with(recalibration.chain(self._config.graph), begin)
            recalibration.close(self.poses, self._solution.edges)
            begin = self.poses

    def _refine(self) -> FloatArray | None:
        """Move the key frames to where all views agree best.

        (n, 3, 3) how sure they are there, None if the refinement is not to be used.
        """
        noise_m, edges, held = self._cutter.noise_m, self._solution.edges, max(self._held, 1)
        try:
            poses, information = refine_keyframes(
                self.keyframes, self.poses, self._odometry_noise, noise_m, edges, held
            )
        except NotRefined as refusal:
            self._refusal = refusal
            return None
        covariances = np.concatenate([np.zeros((held - 1, 3, 3)), information.covariances()])
        self._solution.estimate.move(poses)
        self.information = information
        return covariances

    def _graph_covariances(self) -> FloatArray:
        """(n, 3, 3) without a refinement: those of the graph, scaled by how well its closures fit
        what was claimed; those of its chain alone if it has none."""
        poses, edges = self.poses, self._solution.edges
        with self._stage("covariances"):
            return relative_covariances(poses, edges, 0) * variance_factor(poses, edges)
        return relative_covariances(poses, [e for e in edges if e.kind != "closure"], 0)

    @contextmanager
    def _stage(self, name: str, keyframe: int | None = None) -> Iterator[None]:
        """A stage that may fail alone, and how long it takes."""
        at = len(self.keyframes) - 1 if keyframe is None else keyframe
        with self._timed(name), self.failures.caught(name, at):
            yield

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] += time.perf_counter() - start
