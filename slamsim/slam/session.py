"""SLAM as a stream of scans, and over a whole log: one and the same session."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.landmarks import NO_TAGS, Landmark, TagsSeen
from slamsim.core.places import SeenAgain
from slamsim.core.progress import Progress, silent
from slamsim.core.result import Calibrated, Event, MapGraph, SlamResult
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, Scan
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite, require_mount, solving
from slamsim.process.children import return_freed_memory
from slamsim.slam.backend.surface_information import MapInformation
from slamsim.slam.closures.images import ImageCandidates
from slamsim.slam.failures import Failures
from slamsim.slam.frontend.keyframes import ABOUT_THERE, ANYWHERE, Before, Keyframe, KeyframeMaker
from slamsim.slam.frontend.motion import NoMotion, Odometry, log_odometry, predict_motion
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.frontend.scan_order import InOrder, NothingSeen, nothing_seen, nothing_to_track
from slamsim.slam.frontend.track import Track
from slamsim.slam.frontend.tracking import Status, Step, Tracked
from slamsim.slam.landmarks.graph import as_known, held_by_tags
from slamsim.slam.laser.estimate import laser_of
from slamsim.slam.mapping.assembly import assemble, odometry_alone
from slamsim.slam.mapping.look_alike import ambiguous_steps, unchecked_holds
from slamsim.slam.mapping.saved_map import SavedMap, settled
from slamsim.slam.online.anchors import Anchors
from slamsim.slam.online.async_back_end import AsyncBackEnd
from slamsim.slam.online.motion_filter import MotionFilter
from slamsim.slam.online.samples import NOTHING, MotionSamples, MotionSource, WholeMotion
from slamsim.slam.online.sync_back_end import MapKeeper, SyncBackEnd
from slamsim.slam.online.warm import warm_up

FINISH_SHARE, SEARCH_SHARE = 0.2, 0.5
"""Part of the progress that the finish takes, and part of the finish that its searches take. Until
then scans count for less than one, so that the time that is left is told rightly."""


class SlamSession:
    """Scan by scan: tracked by the front end, kept together by a back end.

    ``open_session`` makes one for a robot that drives, ``run_slam`` one for a log.

    front_end: has seen no scan yet. motion: what is known of the robot's motion. keeper: the back
    end. before: how the drive follows on an earlier one that the back end knows. A context
    manager: closing it ends whatever the back end runs in.
    """

    def __init__(
        self,
        config: SlamConfig,
        front_end: FrontEnd,
        motion: MotionSource,
        keeper: MapKeeper,
        before: Before | None = None,
    ) -> None:
        self._front_end, self._motion, self._keeper = front_end, motion, keeper
        self._config = config.back_end
        self._first = 0 if before is None else before.keyframe.index + 1
        self._fixed = before is not None and before.fixed
        self._maker = KeyframeMaker(config.back_end.keyframes, config.front_end.max_range_m, before)
        self._anchors = Anchors()
        self._track = Track()
        self._solved: MapGraph | None = None
        self._information: MapInformation | None = None
        self._events_told: set[tuple[str, int]] = set()
        self._seconds: defaultdict[str, float] = defaultdict(float)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Scans tracked so far."""
        return len(self._track)

    @property
    def keeper(self) -> MapKeeper:
        """The back end."""
        return self._keeper

    def step(self, scan: Scan, samples: MotionSamples = NOTHING) -> Step | None:
        """Track one scan, given what arrived of the robot's motion until the scan's end, and best
        with the first sample after it: motion that is not covered is extrapolated.

        None for a scan that had to be left out: not later than the one before, or at a time that
        the motion does not cover. Raises BadNumbers or NoSolution for a motion that is none.
        """
        followed = self.follow(scan, samples)
        if followed is None:
            return None
        with solving(f"the scan at {scan.stamp_ns} ns"):
            return self._told(*followed)

    def follow(
        self, scan: Scan, samples: MotionSamples = NOTHING
    ) -> tuple[Tracked, Keyframe | None] | None:
        """``step`` without the pose in the map, whose covariance takes a tenth of the time of a
        long log; not to be mixed with ``step``, which needs every key frame."""
        if not self._track.is_later(scan.stamp_ns):
            return None
        with solving(f"the scan at {scan.stamp_ns} ns"):
            return self._followed(scan, samples)

    def _followed(
        self, scan: Scan, samples: MotionSamples
    ) -> tuple[Tracked, Keyframe | None] | None:
        """``follow`` for a scan that is later than the one before."""
        begun_s = time.perf_counter()
        self._motion.add(samples)
        self._front_end.renew_motion(self._motion.until(scan.span_ns[1]))

        tracked = self._front_end.step(scan)
        tracked_s = time.perf_counter()
        self._seconds["front end"] += tracked_s - begun_s
        if tracked is None:
            return None
        self._track.keep(tracked)

        keyframe = self._maker.make(tracked)
        self._seconds["key frames"] += time.perf_counter() - tracked_s
        if keyframe is not None:
            self._keeper.take(keyframe)
        return tracked, keyframe

    def finish(self, progress: Progress = silent) -> SlamResult:
        """The final solution. Raises SlamsimError if no scan could be tracked."""
        if not len(self._track):
            raise SlamsimError("there is nothing to solve: no scan was tracked")
        if not self._front_end.sighted:
            raise NothingSeen(nothing_seen(len(self._track)))
        return_freed_memory()
        with solving("the whole map"):
            outcome = self._keeper.finish(progress)
            self._solved = outcome.graph
            steps, lost = self._front_end.sudden_steps, self._front_end.lost_holds
            torn: tuple[Event, ...] = ()
            if steps or lost:
                drive = self._keeper.keyframes(), outcome.graph, self._first, self._config
                torn = ambiguous_steps(steps, *drive) + unchecked_holds(lost, *drive)
            result, self._information = assemble(
                self._track, self._front_end, outcome, self._first, self._seconds, torn
            )
            return result

    @property
    def information(self) -> MapInformation | None:
        """What holds the key frames since ``finish``; None without a final refinement."""
        return self._information

    @property
    def joined(self) -> bool:
        """Whether anything joins the drive that ``finish`` solved to the earlier map, or that stays
        as it is."""
        assert self._solved is not None
        return self._fixed or any(
            e.weight > 0.0 and e.source < self._first - 1 and e.target >= self._first
            for e in self._solved.edges
        )

    def saved(self, result: SlamResult, earlier: Sequence[Landmark] = ()) -> SavedMap:
        """What a later run needs to go on with the map that ``finish`` gave, or to localise.

        The earlier map, with its tags, is part of it if it is ``joined``.
        """
        assert self._solved is not None
        first, edges = self._first, self._solved.edges
        poses = self._solved.keyframes.poses.copy()
        poses[first:] = result.graph.keyframes.poses
        seen = {tag.number for tag in result.landmarks}
        kept = [tag for tag in earlier if self.joined and tag.number not in seen]
        landmarks = sorted([*kept, *result.landmarks], key=lambda tag: tag.number)
        begin = 0 if self.joined else first
        return settled(self._keeper.keyframes(), poses, edges, begin, landmarks)

    def close(self) -> None:
        """End the back end, whatever it is doing; the session cannot go on."""
        self._keeper.close()

    def _told(self, tracked: Tracked, keyframe: Keyframe | None) -> Step:
        if keyframe is not None:
            self._anchors.add(keyframe)
        self._anchors.move(self._keeper.correction())
        match = tracked.match
        T_map_base, covariance = self._anchors.place(tracked)
        known = self._anchors.joined or not self._fixed
        return Step(
            stamp_ns=tracked.stamp_ns,
            T_map_base=T_map_base if known else np.full(3, np.nan),
            T_odom_base=tracked.T_odom_base,
            covariance=covariance,
            match_quality=tracked.match_quality,
            degenerate_directions=np.eye(3) if match is None else match.degenerate_directions,
            status=self._status(tracked) if known else "lost",
            events=(*self._new_events(), *self._keeper.events()),
            keyframe=None if keyframe is None else keyframe.index,
            cloud=None if keyframe is None else tracked.cloud,
        )

    def _status(self, tracked: Tracked) -> Status:
        if tracked.restart is not None:
            return "lost"
        followed = tracked.match is not None or tracked.keyscan or tracked.held_back
        return "tracking" if followed else "searching"

    def _new_events(self) -> tuple[Event, ...]:
        """What the front end noticed and has not told yet; some events still grow when told."""
        new = [e for e in self._front_end.events() if (e.kind, e.start_ns) not in self._events_told]
        self._events_told.update((event.kind, event.start_ns) for event in new)
        return tuple(new)


def open_session(
    config: SlamConfig,
    T_base_laser: FloatArray,
    T_base_imu: FloatArray | None = None,
    start: FloatArray | None = None,
) -> SlamSession:
    """A session for a robot that drives, its back end in a process of its own.

    T_base_laser, T_base_imu: 4 x 4 mounts; None for a robot without a gyroscope. start: (3,)
    T_map_base at the first scan, the origin without it. Kernels are compiled before this returns.

        with open_session(SlamConfig(), T_base_laser, T_base_imu) as session:
            for scan, odometry in robot:
                step = session.step(scan, MotionSamples(odometry=odometry))
                publish(step.T_map_odom)
            result = session.finish()
    """
    require_mount("T_base_laser", T_base_laser)
    if T_base_imu is not None:
        require_mount("T_base_imu", T_base_imu)
    warm_up(config, T_base_laser)
    motion = MotionFilter(None if T_base_imu is None else T_base_imu[:3, :3])
    front_end = FrontEnd(config.front_end, None, T_base_laser)
    if start is not None:
        require_finite("the pose to begin at", start, (3,))
        front_end.start_at(start)
    return SlamSession(config, front_end, motion, AsyncBackEnd(config))


def run_slam(log: Log, config: SlamConfig, progress: Progress = silent) -> SlamResult:
    """Trajectory and graph of a recording; ``mapping.build_grid`` draws its map.

    The map frame begins where the base stood at the first scan used. A log that says nothing of
    the robot's motion is mapped all the same, with a warning. Raises SlamsimError for a log
    without a scan that the motion covers.
    """
    return map_log(log, config, progress)[0]


def map_log(
    log: Log,
    config: SlamConfig,
    progress: Progress = silent,
    earlier: SavedMap | None = None,
    start: FloatArray | None = None,
    fixed: bool = False,
    tags: TagsSeen = NO_TAGS,
    again: Sequence[SeenAgain] = (),
) -> tuple[SlamResult, SavedMap]:
    """As ``run_slam``, with what a later run needs to go on or to localise in this map.

    earlier: a map to go on with; the trajectory is then in its frame, and both are one map, as soon
    as something is recognised. start: (3,) T_map_base in it at the first scan, give or take half a
    metre; without it the robot finds itself. fixed: the earlier map stays as it is. tags: in its
    images; those of the earlier map are known ones as soon as it is joined. again: places that its
    images show again, where closures are sought besides. Raises SlamsimError for a log of which no
    scan can be tracked.
    """
    started_s = time.perf_counter()
    if start is not None:
        require_finite("the pose to begin at", start, (3,))
    if earlier is not None:
        require_same_tags(tags, earlier.landmarks)
    failures = Failures()
    odometry = odometry_of(log)
    seconds = {"motion": time.perf_counter() - started_s}

    laser = laser_of(log, odometry, config, failures)
    if laser.reversed.wheels or laser.reversed.gyro:
        log = laser.reversed.applied(log)
        odometry = odometry_of(log)
        laser = laser_of(log, odometry, config, failures)
    log = laser.applied(log)
    if laser.moves_odometry:
        odometry = odometry_of(log)
    seconds["laser"] = time.perf_counter() - started_s - seconds["motion"]
    return_freed_memory()

    front_end = FrontEnd(config.front_end, odometry, log.T_base_laser)
    whole = float(len(log.scans))
    tracked = whole * (1.0 - FINISH_SHARE)
    if start is not None:
        front_end.start_at(start)
    before = None
    if earlier is not None:
        before = Before(earlier.keyframes[-1], ANYWHERE if start is None else ABOUT_THERE, fixed)
    images, scans = ImageCandidates(again, odometry), InOrder(log.scans)
    keeper = SyncBackEnd(config, earlier, fixed, images)
    with SlamSession(config, front_end, WholeMotion(odometry), keeper, before) as session:
        for number, scan in enumerate(scans):
            session.follow(scan)
            progress((number + 1) * (1.0 - FINISH_SHARE), whole)
        if not len(session):
            raise SlamsimError(nothing_to_track(log, odometry))
        result = session.finish(_rest_of(progress, tracked, whole))
        before_tags = () if earlier is None else earlier.landmarks
        if earlier is not None:
            known = tuple(map(as_known, before_tags)) if session.joined else ()
            tags = replace(tags, known=known, continues=True, joined=session.joined)
        result = held_by_tags(result, session.information, tags, config, failures)
        saved = session.saved(result, before_tags)
    progress(whole, whole)
    whole_result = replace(
        result,
        odometry=odometry_alone(log, result.odometry),
        seconds=seconds | result.seconds,
        warnings=(*map(str, failures), *result.warnings, *scans.warnings()),
        calibration=result.calibration | laser.calibrated(),
        calibration_beside={topic: one.calibrated() for topic, one in laser.beside.items()},
        failed=(*failures, *result.failed),
        log=log,
    )
    return whole_result, saved


def require_same_tags(tags: TagsSeen, earlier: Sequence[Landmark]) -> None:
    """Raises SlamsimError for tags that do not go with those of an earlier map."""
    if tags.known:
        raise SlamsimError(
            f"{len(tags.known)} surveyed tags do not go with an earlier map: it keeps its own frame"
        )
    families = {tag.family for tag in earlier} - {""}
    if tags.family and families - {tags.family}:
        raise SlamsimError(
            f"the map that is continued has tags of {', '.join(sorted(families))}, this drive of "
            f"{tags.family}: equal numbers would be other tags"
        )


def motion_of(log: Log, calibration: Mapping[str, Calibrated]) -> PlanarTrajectory | None:
    """``T_odom_base`` of a log, None if it says nothing about how the robot moved."""
    try:
        return predict_motion(log, calibration)
    except NoMotion:
        return None


def odometry_of(log: Log) -> Odometry | None:
    """Wheels and gyroscope of a log, None if it says nothing about how the robot moved."""
    try:
        return log_odometry(log)
    except NoMotion:
        return None


def _rest_of(progress: Progress, done_before: float, whole: float) -> Progress:
    """Progress of the searches of the finish, after which the solution is still to come. If all is
    searched once more, it waits."""
    most = 0.0

    def report(done: float, total: float) -> None:
        nonlocal most
        most = max(most, SEARCH_SHARE * done / max(total, 1.0))
        progress(done_before + (whole - done_before) * most, whole)

    return report
