"""A thing that moves by itself: left out where it alone says that the wheels slip.

Along a corridor the walls hold nothing, and a person who walks ahead of the robot looks as if the
robot stood. Walls do not move and wheels seldom slip: if the scan agrees with the odometry as soon
as one compact thing is left out, it is that thing which moves. From then on it is followed, and is
left out of each scan before that is matched or mapped, until it stands: a map that holds where it
was pulls at each scan that sees it a little farther on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from slamsim.core.geometry import between, transform_points
from slamsim.core.types import BoolArray, Cloud, FloatArray, IntArray
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.matching import Match

SLOWEST_M_S = 0.2
"""What people fall below only while they turn or stand. A radius that is 5 % wrong makes less of a
robot that drives 2 m/s."""

WIDEST_M = 1.0
"""Of a person with a trolley, of two side by side; a wall of which less is seen tells no slipping
either, as nothing says that it is none."""

GAP_M, GAP_BEAMS = 0.2, 3.0
"""Neighbouring beams that end farther apart than this, and than so many beams are there, ended on
different things."""

ALONE_SHARE = 0.5
"""Of the information along the step that the odometry denies: the thing tells more than all the
rest, whose part may be the steps of rounded ranges, which seem to go with the robot."""

FIT_SLACK = 0.02
"""Where odometry is right, what stands fits at least as well as all did with what moved; but for
one piece of surface of fifty. Among trees (fr-clinic) it fits worse: there nothing moved."""

AGAIN_S, AGAIN_SCANS, FASTEST_M_S = 0.5, 3.0, 2.5
"""Within so long, or so many scans of a slow lidar, and no farther on than one runs indoors, it is
the same thing that was seen to move."""

MOST_TRIED = 3
"""Things that most beams meet: who is as near as to blind a robot fills a tenth of its view."""

STANDS_S = 1.0
"""Who walks slower than ``SLOWEST_M_S`` for so long stands: legs stop for half a second in a
stride, and the middle of what is seen of a person moves by less than the 0.2 m that this makes."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sighting:
    """Where a thing that moves was seen: time, ns, and place in the map (2,)."""

    stamp_ns: int
    place_m: FloatArray

    def until(self, stamp_ns: int) -> float:
        return (stamp_ns - self.stamp_ns) * 1e-9

    def can_reach(self, place_m: FloatArray, stamp_ns: int) -> bool:
        """Whether what was seen here can be at a place (2,) by now."""
        reach_m = WIDEST_M + FASTEST_M_S * self.until(stamp_ns)
        return float(np.hypot(*(place_m - self.place_m))) <= reach_m


class _Followed:
    """A thing that moves, as it was seen during the last ``STANDS_S``."""

    def __init__(self, first: _Sighting) -> None:
        self._seen = deque([first])

    @property
    def last(self) -> _Sighting:
        return self._seen[-1]

    def nearest(self, places_m: FloatArray, stamp_ns: int) -> int | None:
        """Which of the places (n, 2) of things it is at; None if it can be at none."""
        if len(places_m) == 0:
            return None
        first, last = self._seen[0], self.last
        seconds = max(first.until(last.stamp_ns), 1e-9)
        on_m = (last.place_m - first.place_m) * min(last.until(stamp_ns) / seconds, 1.0)
        off_m = np.hypot(*(places_m - last.place_m - on_m).T)
        nearest = int(np.argmin(off_m))
        return nearest if last.can_reach(places_m[nearest], stamp_ns) else None

    def see(self, sighting: _Sighting) -> None:
        self._seen.append(sighting)
        while self._seen[1].until(sighting.stamp_ns) >= STANDS_S:
            self._seen.popleft()

    @property
    def stands(self) -> bool:
        first = self._seen[0]
        seconds = first.until(self.last.stamp_ns)
        moved_m = float(np.hypot(*(self.last.place_m - first.place_m)))
        return seconds >= STANDS_S and moved_m < SLOWEST_M_S * seconds


class Movers:
    """Leaves out what moves by itself, from the second time on that it is seen to move: where
    stamps jitter, a thing that stands seems to move in one scan now and then."""

    def __init__(self) -> None:
        self._last: _Sighting | None = None
        """When and where a thing was last seen to move."""
        self._followed: list[_Followed] = []

    def standing(self, cloud: Cloud, prediction: Prediction) -> Cloud:
        """The cloud without the things that were seen to move and have not stood since."""
        if not self._followed:
            return cloud
        stamp_ns, lost_s = prediction.stamp_ns, again_s(prediction)
        self._followed = [one for one in self._followed if one.last.until(stamp_ns) <= lost_s]
        things = list(compact_things(cloud))
        middles_m = [cloud.points_m[thing].mean(axis=0) for thing in things]
        places_m = transform_points(prediction.T_map_base, np.reshape(middles_m, (-1, 2)))
        kept = np.ones(cloud.hit.size, dtype=np.bool_)
        for one in self._followed:
            at = one.nearest(places_m, stamp_ns)
            if at is not None:
                one.see(_Sighting(stamp_ns, places_m[at]))
                kept &= one.stands | ~things[at]
        self._followed = [one for one in self._followed if not one.stands]
        return cloud if kept.all() else without(cloud, ~kept)

    def left_out(
        self,
        cloud: Cloud,
        near: Match,
        prediction: Prediction,
        agrees: Callable[[Match], bool],
        match: Callable[[Cloud], Match | None],
    ) -> tuple[Cloud, Match]:
        """The cloud and its match without the thing that moved, or as they are.

        near: the match of the whole cloud, which denies the odometry. agrees: whether a match lies
        where odometry has it. match: lays a cloud onto the map from there.
        """
        if not _is_fast(near, prediction):
            return cloud, near
        for thing in islice(compact_things(cloud), MOST_TRIED):
            rest = without(cloud, thing)
            found = match(rest)
            if found is None or found.inlier_ratio < near.inlier_ratio - FIT_SLACK:
                continue
            if agrees(found) and _loosened(near, found, prediction):
                place_m = transform_points(found.T_map_base, cloud.points_m[thing].mean(axis=0))
                again = self._is_again(prediction, place_m)
                self._last = _Sighting(prediction.stamp_ns, place_m)
                if not again:
                    return cloud, near
                self._followed.append(_Followed(self._last))
                return rest, found
        return cloud, near

    def _is_again(self, prediction: Prediction, place_m: FloatArray) -> bool:
        """Whether it can be the thing that was seen to move before."""
        if self._last is None:
            return False
        recent = self._last.until(prediction.stamp_ns) <= again_s(prediction)
        return recent and self._last.can_reach(place_m, prediction.stamp_ns)


def again_s(prediction: Prediction) -> float:
    """How long a thing may be out of sight and still be the same."""
    seconds = 0.0 if prediction.odometry is None else prediction.odometry.seconds
    return max(AGAIN_S, AGAIN_SCANS * seconds)


def _is_fast(near: Match, prediction: Prediction) -> bool:
    """Whether what the odometry denies is as fast as what walks."""
    if prediction.odometry is None or prediction.jump:
        return False
    step = between(prediction.T_map_base, near.T_map_base)
    return float(np.hypot(step[0], step[1])) > SLOWEST_M_S * prediction.odometry.seconds


def _loosened(near: Match, found: Match, prediction: Prediction) -> bool:
    """Whether the thing tells more of what the odometry denies than all the rest."""
    step = between(prediction.T_map_base, near.T_map_base)
    held, still_held = (float(step @ one.information @ step) for one in (near, found))
    return still_held < ALONE_SHARE * held


def compact_things(cloud: Cloud) -> Iterator[BoolArray]:
    """(n,) beams on each thing no wider than ``WIDEST_M``, with what stands beside it within that
    width (legs), the one that most beams meet first."""
    hits = np.flatnonzero(cloud.hit)
    if hits.size < 2:
        return
    points_m = cloud.points_m[hits]
    own = int(cloud.hit[: cloud.own_beams].sum())
    number = _numbered(points_m, cloud.origins_m[hits], own)
    count = np.bincount(number)
    middle_m = np.stack([np.bincount(number, axis) / count for axis in points_m.T], axis=-1)
    off_m = np.hypot(*(points_m - middle_m[number]).T)
    reach_m = np.zeros(count.size)
    np.maximum.at(reach_m, number, off_m)
    compact = reach_m <= 0.5 * WIDEST_M
    done = np.zeros(count.size, dtype=np.bool_)
    for one in np.argsort(-count, kind="stable"):
        if not compact[one] or done[one]:
            continue
        beside = np.hypot(*(middle_m - middle_m[one]).T) + reach_m <= 0.5 * WIDEST_M + reach_m[one]
        together = compact & beside & ~done
        done |= together
        thing = np.zeros(cloud.hit.size, dtype=np.bool_)
        thing[hits] = together[number]
        yield thing


def _numbered(points_m: FloatArray, origins_m: FloatArray, own: int) -> IntArray:
    """(n,) which thing each of the (n, 2) points is on, one after the other round the robot. own:
    how many are of its first lidar."""
    beams_m = points_m - origins_m
    turn_rad = np.abs(np.diff(np.unwrap(np.arctan2(beams_m[:, 1], beams_m[:, 0]))))
    apart_m = np.hypot(*np.diff(points_m, axis=0).T)
    # The usual turn: where nothing comes back over many beams, what is beside ends all the same.
    for lidar in (turn_rad[:own], turn_rad[own:]):
        if lidar.size:
            lidar[:] = np.median(lidar)
    spacing_m = np.hypot(*beams_m[1:].T) * turn_rad
    is_next = apart_m > np.maximum(GAP_M, GAP_BEAMS * spacing_m)
    number = np.concatenate([[0], np.cumsum(is_next)])
    if number[-1] > 0 and np.hypot(*(points_m[0] - points_m[-1])) <= GAP_M:
        number[number == number[-1]] = 0  # all the way round
    return np.asarray(number, dtype=np.int64)


def without(cloud: Cloud, left: BoolArray) -> Cloud:
    """The cloud but for some of its beams (n,)."""
    own = cloud.own_beams
    return replace(cloud.select(~left), own_beams=None if own is None else int((~left)[:own].sum()))
