"""Compact things count once they are seen to stand where the odometry has them.

In a crowd no one thing denies the odometry: several people creep along with the robot, each takes
the match a little with him, and the map holds where they were. Where the rest of a scan tells
little of some direction, a compact thing that moves in the odometry's own frame is therefore left
out of it, and while any does, each new one until it has stood there for a while: the map shows what
odometry errs by as soon as it counts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import transform_points, wrap_angle
from slamsim.core.types import BoolArray, Cloud, FloatArray
from slamsim.slam.frontend.movers import again_s, compact_things, without
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.matching import Matcher
from slamsim.slam.matching.surfaces import NORMAL_X, NORMAL_Y, VARIANCE, X, Y

WATCHED_S = 1.0
"""A thing is judged by so long of what was seen of it: who changes legs halts for half of that."""

PROVEN_S, PROVEN_SCANS = 0.3, 3
"""So long it must have been seen to be judged at all, and in so many scans."""

RAREST_S = WATCHED_S / (PROVEN_SCANS - 1)
"""Scans that come more rarely show too few of what is watched, and no one is known again."""

SLOWEST_M_S = 0.03
"""What creeps faster does not stand: in a crowd people do 0.1 m/s, and a robot's odometry is
calibrated to 3 % of a walk. Of 0.03, 0.07 and 0.15 m/s this did best in two crowds."""

MIDDLE_M = 0.02
"""The middle of what is seen of a thing that stands wanders by so much, and by the space between
two beams."""

TURN_SHARE = 0.05
"""Of its turns the odometry errs by no more; what is far away seems to move by that."""

STEADY_SHARE = 0.25
"""Of the way that its share of the time makes, in either half: what jumps once was taken for
another thing."""

STEP_M, STEP_M_S, NEW_STEP_M_S = 0.25, 0.75, 1.5
"""How far from where it should be a thing may be found again: for what its visible part wanders,
and for how it changes its speed, which of a new one is not known."""

BEHIND_M = 0.1
"""What ends beside a thing, nearer than so far behind its edge, may hide a part of it: the middle
of that which is seen then moves with the robot."""

FAN_ENDS = 4.0
"""Beams are neighbours if no more than so many usual angles lie between them."""

REST_SHARE = 0.5
"""Of the information along the direction that the rest tells least of: where it is more, a thing
that moves pulls by less than half of its step. With 0.8 aces loses what stands (0.5 mm)."""

TURN_KEPT = float(np.square(1.0 / np.deg2rad(0.5)))
"""Information of the robot's turn that must be left: among trees they alone tell it, and wheels
tell turns far worse than steps."""

TINY = 1e-9
"""Information, 1/m^2, of a direction that nothing tells."""

CHECKED_NS = 500_000_000
"""So often it is asked whether anything must be watched: where what is not compact tells enough by
itself, nothing is. To follow the things of each scan of a labyrinth took as long as to match it."""

SLIP_THINGS, SLIP_SHARE = 3, 0.25
"""So many things that all move by one step, give or take so much of it, stand: the wheels slip."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sighting:
    """Time, ns, and place in the odometry's frame (2,), as far from the robot; the space there
    between two beams. turned_rad: how far the robot has turned so far, either way."""

    stamp_ns: int
    place_m: FloatArray
    far_m: float
    spacing_m: float
    turned_rad: float


class _Track:
    """One thing, as it was seen during the last ``WATCHED_S``."""

    def __init__(self, first: _Sighting) -> None:
        self._seen = deque([first])
        self.moves = False

    @property
    def last(self) -> _Sighting:
        return self._seen[-1]

    @property
    def since_ns(self) -> int:
        return self._seen[0].stamp_ns

    @property
    def seconds(self) -> float:
        return (self.last.stamp_ns - self._seen[0].stamp_ns) * 1e-9

    @property
    def moved_m(self) -> FloatArray:
        """(2,) since the first sighting."""
        return self.last.place_m - self._seen[0].place_m

    @property
    def wander_m(self) -> float:
        """By how much it may seem to move although it stands."""
        turned_rad = self.last.turned_rad - self._seen[0].turned_rad
        turned_m = TURN_SHARE * turned_rad * max(seen.far_m for seen in self._seen)
        return MIDDLE_M + max(seen.spacing_m for seen in self._seen) + turned_m

    @property
    def judged(self) -> bool:
        return self.seconds >= PROVEN_S and len(self._seen) >= PROVEN_SCANS

    def nearest(self, places_m: FloatArray, stamp_ns: int) -> int | None:
        """Which of the places (n, 2) of things it is at; None if it can be at none."""
        since_s = (stamp_ns - self.last.stamp_ns) * 1e-9
        known = len(self._seen) >= PROVEN_SCANS
        on_m = self.moved_m * min(since_s / self.seconds, 1.0) if known else np.zeros(2)
        off_m = np.hypot(*(places_m - self.last.place_m - on_m).T)
        nearest = int(np.argmin(off_m))
        reach_m = STEP_M + (STEP_M_S if known else NEW_STEP_M_S) * since_s
        return nearest if off_m[nearest] <= reach_m else None

    def see(self, sighting: _Sighting) -> None:
        self._seen.append(sighting)
        while (
            len(self._seen) > PROVEN_SCANS - 1
            and (sighting.stamp_ns - self._seen[1].stamp_ns) * 1e-9 >= WATCHED_S
        ):
            self._seen.popleft()
        if self.judged:
            self.moves = self._moves()

    def _moves(self) -> bool:
        """Once it moves it stands only when it has done so for as long as things are watched."""
        moved_m, seconds = float(np.hypot(*self.moved_m)), self.seconds
        slowest_m = SLOWEST_M_S * seconds
        if self.moves:
            return seconds < 0.9 * WATCHED_S or moved_m >= slowest_m
        if moved_m <= slowest_m + self.wander_m:
            return False
        first, half = self._seen[0], self._seen[len(self._seen) // 2]
        before = (half.stamp_ns - first.stamp_ns) * 1e-9 / seconds
        way = float((half.place_m - first.place_m) @ self.moved_m) / moved_m**2
        least = 2.0 * STEADY_SHARE
        return least * before < way < 1.0 - least * (1.0 - before)


class StandingThings:
    """Follows the compact things of each scan in the frame of the odometry."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []
        self._turned_rad = 0.0
        self._checked_ns: int | None = None
        self._needless = False
        self._since_ns: int | None = None
        self._last_rad = 0.0

    def left(self, cloud: Cloud, prediction: Prediction, matcher: Matcher) -> Cloud:
        """The cloud without what is not known to stand, where that tells most."""
        odometry = prediction.odometry
        if odometry is None or prediction.jump or odometry.seconds > RAREST_S:
            self._forget()
            return cloud
        yaw_rad = prediction.T_odom_base[2:]
        self._turned_rad += float(np.abs(wrap_angle(yaw_rad - self._last_rad))[0])
        self._last_rad = float(yaw_rad[0])
        self._check(cloud, prediction.stamp_ns, matcher)
        if self._needless:
            return cloud
        unproven = self._unproven(cloud, list(compact_things(cloud)), prediction)
        if not unproven.any():
            return cloud
        rest = without(cloud, unproven)
        tells_most, tells_turn = _compared(matcher, cloud, rest)
        return rest if tells_turn and not tells_most else cloud

    def _check(self, cloud: Cloud, stamp_ns: int, matcher: Matcher) -> None:
        """Now and then, whether a scan tells enough without any compact thing."""
        if self._checked_ns is not None and 0 <= stamp_ns - self._checked_ns < CHECKED_NS:
            return
        self._checked_ns = stamp_ns
        compact = np.zeros(cloud.hit.size, dtype=np.bool_)
        for thing in compact_things(cloud):
            compact |= thing
        self._needless = _compared(matcher, cloud, without(cloud, compact))[0]
        if self._needless:
            self._forget()

    def _forget(self) -> None:
        """What is seen next is not new."""
        self._tracks, self._since_ns = [], None

    def _unproven(self, cloud: Cloud, things: list[BoolArray], prediction: Prediction) -> BoolArray:
        """(n,) beams on things that move, or are not known yet."""
        if self._since_ns is None:
            self._since_ns = prediction.stamp_ns
        seen = _Seen.of(cloud, things, prediction)
        stamp_ns, lost_s = prediction.stamp_ns, again_s(prediction)
        self._tracks = [
            one for one in self._tracks if (stamp_ns - one.last.stamp_ns) * 1e-9 <= lost_s
        ]
        tracked: dict[int, _Track] = {}
        free_m = seen.places_m.copy()
        for track in sorted(self._tracks, key=lambda one: -one.seconds):
            at = track.nearest(free_m, stamp_ns) if things else None
            if at is not None and (seen.whole[at] or track.moves):
                free_m[at] = np.inf
                track.see(seen.sighting(at, stamp_ns, self._turned_rad))
                tracked[at] = track
        for k in range(len(things)):
            if seen.whole[k] and k not in tracked:
                tracked[k] = _Track(seen.sighting(k, stamp_ns, self._turned_rad))
                self._tracks.append(tracked[k])
        left = np.zeros(cloud.hit.size, dtype=np.bool_)
        slip = _slip(list(tracked.values()))
        # Where nothing moves what is new stands: left out, fr079 was 16 cm off on unmapped ground.
        crowded = not slip and any(track.moves for track in self._tracks)
        for k, track in tracked.items():
            new = not track.judged and track.since_ns > self._since_ns
            if crowded and (track.moves or (seen.whole[k] and new)):
                left |= things[k]
        return left


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """places_m: (n, 2) of things in the odometry's frame, far_m (n,) from the robot. whole: (n,)
    whether nothing before it hides a part of a thing. turn_rad: from beam to beam."""

    places_m: FloatArray
    far_m: FloatArray
    whole: BoolArray
    turn_rad: float

    @classmethod
    def of(cls, cloud: Cloud, things: list[BoolArray], prediction: Prediction) -> _Seen:
        beams_m = cloud.points_m - cloud.origins_m
        bearing_rad = np.arctan2(beams_m[:, 1], beams_m[:, 0])
        turns_rad = np.abs(np.diff(np.unwrap(bearing_rad[: cloud.own_beams])))
        turn_rad = float(np.median(turns_rad)) if turns_rad.size else 0.0
        far_m = np.where(cloud.hit, np.hypot(*beams_m.T), np.inf)
        middles_m = np.array([_middle(cloud, beams_m, thing) for thing in things]).reshape(-1, 2)
        whole = [_is_whole(thing, far_m, bearing_rad, FAN_ENDS * turn_rad) for thing in things]
        return cls(
            transform_points(prediction.T_odom_base, middles_m),
            np.hypot(*middles_m.T),
            np.array(whole, dtype=np.bool_),
            turn_rad,
        )

    def sighting(self, thing: int, stamp_ns: int, turned_rad: float) -> _Sighting:
        far_m = float(self.far_m[thing])
        return _Sighting(stamp_ns, self.places_m[thing], far_m, far_m * self.turn_rad, turned_rad)


def _middle(cloud: Cloud, beams_m: FloatArray, thing: BoolArray) -> FloatArray:
    """(2,) of a thing as deep as it is wide: that of what is seen of it moves as one drives by."""
    own = np.arange(thing.size) < (thing.size if cloud.own_beams is None else cloud.own_beams)
    one = thing & own  # of lidars beside each other only one looks from where it does
    one = one if 2 * one.sum() >= thing.sum() else thing & ~own
    points_m, beams_m = cloud.points_m[one], beams_m[one]
    wide_m = float(np.hypot(*(points_m[-1] - points_m[0])))
    direction = beams_m.mean(axis=0)
    direction = direction / max(float(np.hypot(*direction)), 1e-9)
    near_m = float(np.hypot(*beams_m.T).min())
    return np.asarray(cloud.origins_m[one][0] + direction * (near_m + 0.5 * wide_m))


def _is_whole(
    thing: BoolArray, far_m: FloatArray, bearing_rad: FloatArray, apart_rad: float
) -> bool:
    """Whether beams beside it, at either end, go on behind it."""
    beams, count = np.flatnonzero(thing), thing.size
    gaps = np.diff(np.append(beams, beams[0] + count))
    widest = int(np.argmax(gaps))  # across the first beam of the scan, if it lies there
    for end, beside in (
        (beams[(widest + 1) % beams.size], -1),
        (beams[widest], 1),
    ):
        other = (end + beside) % count
        turn_rad = abs((bearing_rad[other] - bearing_rad[end] + np.pi) % (2.0 * np.pi) - np.pi)
        if abs(other - end) > 1 and turn_rad > apart_rad:
            return False  # the end of the fan
        if far_m[other] < far_m[end] + BEHIND_M:
            return False
    return True


def _slip(tracks: list[_Track]) -> bool:
    """Whether all that could be judged moves by one step: then it is the odometry that does."""
    judged = [track for track in tracks if track.judged]
    if len(judged) < SLIP_THINGS or not all(track.moves for track in judged):
        return False
    m_s = np.array([track.moved_m / track.seconds for track in judged])
    off_m_s = np.hypot(*(m_s - m_s.mean(axis=0)).T)
    return bool(np.all(off_m_s <= SLIP_SHARE * np.hypot(*m_s.mean(axis=0))))


def _compared(matcher: Matcher, cloud: Cloud, rest: Cloud) -> tuple[bool, bool]:
    """Whether the rest of a scan tells most of what all of it does of the direction that the rest
    tells least of, and whether it tells the robot's turn."""
    whole, held = (_information(matcher.pieces_of_part(one)) for one in (cloud, rest))
    loosest = np.append(np.linalg.eigh(held[:2, :2])[1][:, 0], 0.0)
    tells_most = loosest @ held @ loosest >= REST_SHARE * (loosest @ whole @ loosest)
    return bool(tells_most), _of_turn(held) >= TURN_KEPT


def _information(pieces: FloatArray) -> FloatArray:
    """(3, 3) of a small step of the base in its own frame."""
    x_m, y_m, across, along = (pieces[:, field] for field in (X, Y, NORMAL_X, NORMAL_Y))
    rows = np.column_stack([across, along, along * x_m - across * y_m])
    return np.asarray((rows / pieces[:, [VARIANCE]]).T @ rows)


def _of_turn(information: FloatArray) -> float:
    """Of a turn, whatever the step."""
    step, both = information[:2, :2] + TINY * np.eye(2), information[:2, 2]
    return float(information[2, 2] - both @ np.linalg.solve(step, both))
