"""Localising in a finished map: nothing is mapped, every pose is in that map's frame.

A robot that does not know where it is follows its own scans as in mapping, and after each key
frame looks for what it saw last anywhere in the map. When several looks agree it is there, and
from then on every scan is matched with the map itself; when nothing fits any more it begins to look
again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.geometry import between, compose, inverse
from slamsim.safe.errors import SlamsimError
from slamsim.safe.numbers import require_finite, solving
from slamsim.slam.keyframes import Keyframe, KeyframeMaker
from slamsim.slam.known_map import KnownMap
from slamsim.slam.matching import make_matcher
from slamsim.slam.matching.fixed import FixedMapMatcher
from slamsim.slam.odometry import FrontEnd
from slamsim.slam.online.samples import NOTHING, MotionSamples, MotionSource
from slamsim.slam.relocalise import Everywhere
from slamsim.slam.submaps import Surfaces, make_submap
from slamsim.slam.track import Track
from slamsim.slam.tracking import Status, Step, Tracked
from slamsim.types import FloatArray, PlanarTrajectory, Scan

AGREEING = 2
"""So many looks, each from another key frame, must lead to the same place."""

AGREE_M = 0.2
AGREE_RAD = 0.06
MOST_KEYFRAMES = 16
FOUND = np.diag(np.square([0.1, 0.1, 0.05]))
NOWHERE = np.full(3, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Localised:
    """trajectory: ``T_map_base`` at the stamps of the scans that could be placed, of ``scans``.
    odometry: ``T_odom_base`` at the same stamps. match_quality: (n,) inlier ratios."""

    trajectory: PlanarTrajectory
    odometry: PlanarTrajectory
    match_quality: FloatArray
    scans: int


class Localiser:
    """Scan by scan: where the robot is in a known map.

    front_end: has seen no scan yet. motion: what is known of the robot's motion. T_map_base: (3,)
    where the robot begins, None if nobody knows; a robot that does not know has to move by a key
    frame or two before it can be sure.
    """

    def __init__(
        self,
        config: SlamConfig,
        known: KnownMap,
        front_end: FrontEnd,
        motion: MotionSource,
        T_map_base: FloatArray | None = None,
    ) -> None:
        if T_map_base is not None:
            require_finite("the pose to begin at", T_map_base, (3,))
        self._config, self._known = config, known
        self._front_end, self._motion = front_end, motion
        self._everywhere = Everywhere(known.points_m, config.back_end)
        self._matcher = FixedMapMatcher(config.front_end, known.surfaces, known.noise_m)
        self._scratch = Surfaces()
        self._track = Track()
        self._stretches: list[_Stretch] = []
        self._seen: deque[Keyframe] = deque(maxlen=MOST_KEYFRAMES)
        self._guesses: list[FloatArray] = []
        self._found = T_map_base is not None
        if T_map_base is None:
            self._look()
        else:
            self._go_on_at(T_map_base)

    def step(self, scan: Scan, samples: MotionSamples = NOTHING) -> Step | None:
        """Localise one scan; None for one that had to be left out.

        ``Step.T_map_base`` is nan while the robot is looking for itself.
        """
        if not self._track.is_later(scan.stamp_ns):
            return None
        with solving(f"the scan at {scan.stamp_ns} ns"):
            return self._followed(scan, samples)

    def _followed(self, scan: Scan, samples: MotionSamples) -> Step | None:
        """``step`` for a scan that is later than the one before."""
        self._motion.add(samples)
        self._front_end.renew_motion(self._motion.until(scan.end_ns))
        tracked = self._front_end.step(scan)
        if tracked is None:
            return None
        if tracked.restart is not None:
            self._front_end.begin_anew(make_matcher(self._config.front_end))
            self._look()
        self._track.keep(tracked)
        step = self._told(tracked)
        if not self._found and (keyframe := self._maker.make(tracked)) is not None:
            self._look_from(keyframe, tracked)
        return step

    def result(self) -> Localised:
        """All that is known by now. Raises SlamsimError if the robot was never found."""
        local = self._track.front_end()
        known = [stretch for stretch in self._stretches if stretch.T_map_local is not None]
        if not len(local) or not known:
            raise SlamsimError(
                f"none of the {len(local)} scans could be placed in the map: does it show where "
                "this was recorded?"
            )
        poses = np.full((len(local), 3), np.nan)
        ends = [*(stretch.first for stretch in self._stretches[1:]), len(local)]
        for stretch, end in zip(self._stretches, ends, strict=True):
            if stretch.T_map_local is not None:
                part = slice(stretch.first, end)
                poses[part] = compose(stretch.T_map_local, local.poses[part])
        placed = np.isfinite(poses[:, 0])
        trajectory = PlanarTrajectory(local.stamps_ns[placed], poses[placed])
        odometry = PlanarTrajectory(local.stamps_ns[placed], self._track.odometry().poses[placed])
        return Localised(trajectory, odometry, self._track.quality[placed], len(local))

    def _told(self, tracked: Tracked) -> Step:
        match = tracked.match
        known = (match is not None or tracked.held_back) and self._found
        status: Status = "tracking" if known else "searching" if self._found else "lost"
        return Step(
            stamp_ns=tracked.stamp_ns,
            T_map_base=tracked.T_map_base if self._found else NOWHERE,
            T_odom_base=tracked.T_odom_base,
            covariance=self._front_end.covariance,
            match_quality=tracked.match_quality,
            degenerate_directions=np.eye(3) if match is None else match.degenerate_directions,
            status=status,
        )

    def _look(self) -> None:
        """Begin a map of its own, and with each key frame look for it in the known one."""
        self._found = False
        self._maker = KeyframeMaker(
            self._config.back_end.keyframes, self._config.front_end.max_range_m
        )
        self._seen.clear()
        self._guesses.clear()
        self._stretches.append(_Stretch(self._first_lost(), None))

    def _first_lost(self) -> int:
        """Number of the first scan that does not belong to the stretch before."""
        if not self._front_end.breaks_ns:
            return len(self._track)
        stamps_ns = self._track.front_end().stamps_ns
        return int(np.searchsorted(stamps_ns, self._front_end.breaks_ns[-1]))

    def _look_from(self, keyframe: Keyframe, tracked: Tracked) -> None:
        """One look at the whole map; go on in it when looks agree."""
        self._seen.append(keyframe)
        members = list(self._seen)
        query = make_submap(members, len(members) - 1, self._scratch, keyframe.noise_m)
        T_map_base = self._everywhere.find(query)
        if T_map_base is None:
            return
        T_map_local = compose(T_map_base, inverse(keyframe.T_map_base))
        others = [compose(guess, keyframe.T_map_base) for guess in self._guesses]
        self._guesses.append(T_map_local)
        if sum(_same(T_map_base, other) for other in others) < AGREEING - 1:
            return
        self._matcher.centre_on(T_map_base[:2])
        match = self._matcher.search(tracked.cloud, T_map_base, FOUND)
        if match is None or match.inlier_ratio < self._config.front_end.matching.min_inlier_ratio:
            return
        found = match.T_map_base
        self._stretches[-1].T_map_local = compose(found, inverse(keyframe.T_map_base))
        self._go_on_at(found)

    def _go_on_at(self, T_map_base: FloatArray) -> None:
        """Match every scan from now on with the known map."""
        self._found = True
        self._matcher.centre_on(T_map_base[:2])
        self._front_end.begin_at(T_map_base, FOUND, self._matcher)
        self._stretches.append(_Stretch(len(self._track), np.zeros(3)))


@dataclass(slots=True, eq=False)
class _Stretch:
    """Scans from number ``first`` on whose poses are in one frame; where it lies, once known."""

    first: int
    T_map_local: FloatArray | None


def _same(one: FloatArray, other: FloatArray) -> bool:
    step = between(one, other)
    return bool(np.hypot(step[0], step[1]) < AGREE_M and abs(step[2]) < AGREE_RAD)
