"""Whether two scans from nearly the same place can have been taken in the same surroundings.

Between two moments only that may come into view which an edge hid before, and it comes into view
beside that edge. Whatever else is seen nearer or farther than before was not there before: a few
beams are people and doors, most of them are another place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, inverse, transform_points
from slamsim.core.jit import kernel
from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.matching.base import Match

STRANGE_SHARE = 0.25
"""Scans one after the other that contradict each other more than this are of different places,
until those that were placed where odometry had them show that here it is more. Between walls it is
at most 0.16 (three real logs), and at least 0.36 where a robot was carried in small worlds whose
rooms and corridors look alike; among trees, and where beams meet sloping ground, 0.3 is usual."""

FALSE_ALARMS = 0.01
"""Share of the scans placed where odometry had them that may contradict the one before so much."""

LEARN_GAIN = 0.1
"""Share by which what is usual follows each scan: the last ten or so tell what it is."""

KIDNAP_WITHIN_NS, KIDNAP_WITHIN_INTERVALS = 1_000_000_000, 3.0
"""In a longer time much may have changed, and the robot may have come far. From a scan to the one
after the next is no long time, however seldom scans come: a single one may be lost."""

MOST_BEAMS = 360
MOST_APART_M = 0.5
TOLERANCE_M, TOLERANCE_SHARE = 0.1, 0.03
SLACK_M = 0.05
"""The scans may be farther apart than the poses say by so much."""

GONE_SHARE, GONE_BEAMS = 0.03, 3
"""The end of a corridor that takes up less of a scan, 2 m wide and 10 m off, or fewer beams, is not
missed. On aces, fr079 and intel one scan of 26,000 that lost its hold from one moment to the next
sees so much behind what the scan before saw."""

LOST_TOGETHER = 1e-3
"""Neighbouring beams that come back so seldom by chance saw that nothing is there."""

LOST_WIDTH_M = 0.4
"""Half of a door: farther apart, two returns do not tell of the beams between them."""

WIDEST_RAD = np.pi / 4.0
LEAST_KNOWN = 12
"""Beams of each scan that must meet beams of the other before the two can be compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A scan and where it was taken, T_map_base: (3,)."""

    cloud: Cloud
    T_map_base: FloatArray


class Surroundings:
    """Holds each scan against the last that was placed.

    One scan that contradicts it may be bad; two that agree with each other, and not with it,
    say that the robot was carried.
    """

    def __init__(self) -> None:
        self._placed: Sighting | None = None
        self._strange: Sighting | None = None
        self._usual_share = STRANGE_SHARE
        self._interval_ns = 0.0

    @property
    def kidnap_within_ns(self) -> float:
        """Up to how long after a scan that was placed another place is a sudden change."""
        return max(float(KIDNAP_WITHIN_NS), KIDNAP_WITHIN_INTERVALS * self._interval_ns)

    def placed(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """A scan that was placed, for the next ones to be held against. T_map_base: (3,)."""
        if self._placed is not None:
            lasted_ns = min(cloud.stamp_ns - self._placed.cloud.stamp_ns, KIDNAP_WITHIN_NS)
            self._interval_ns += LEARN_GAIN * (lasted_ns - self._interval_ns)
        self._placed, self._strange = Sighting(cloud, T_map_base), None

    def agree(self, cloud: Cloud, match: Match, expected: bool) -> bool:
        """Whether a scan can have been taken where it was matched, so shortly after the last.

        expected: whether that is where odometry has it."""
        if match.fit >= 1.0 - STRANGE_SHARE:
            return True
        share = self._contradicted(cloud, match.T_map_base)
        agrees = not share > self._usual_share
        if expected and np.isfinite(share):
            step = math.exp(LEARN_GAIN * ((share > self._usual_share) - FALSE_ALARMS))
            self._usual_share = max(self._usual_share * step, STRANGE_SHARE)
        return agrees

    def left(self, cloud: Cloud, T_map_base: FloatArray, others: Sequence[FloatArray]) -> bool:
        """Whether a scan that was not placed shows that the robot was carried.

        T_map_base: (3,) where it was predicted. others: where else it might have been taken.
        """
        shares = [self._contradicted(cloud, T) for T in (T_map_base, *others)]
        if not all(share > self._usual_share for share in shares):
            self._strange = None
            return False
        before, self._strange = self._strange, Sighting(cloud, T_map_base)
        if before is None:
            return False
        return contradiction(before, self._strange) <= self._usual_share

    def _contradicted(self, cloud: Cloud, T_map_base: FloatArray) -> float:
        """How much a scan contradicts the last that was placed, nan where nothing is known."""
        if self._placed is None:
            return np.nan
        late = cloud.stamp_ns - self._placed.cloud.stamp_ns > self.kidnap_within_ns
        if late and self._strange is None:
            return np.nan
        return contradiction(self._placed, Sighting(cloud, T_map_base))


def contradiction(one: Sighting, other: Sighting) -> float:
    """Share of the returns of one scan that cannot be seen where the other was taken.

    The smaller of both shares, one for each scan against the other; nan where the two are too far
    apart to tell, or know too little of the same directions.
    """
    T_one_other = between(one.T_map_base, other.T_map_base)
    if np.hypot(T_one_other[0], T_one_other[1]) > MOST_APART_M:
        return np.nan
    forth = _share(one.cloud, other.cloud, T_one_other)
    if not forth > STRANGE_SHARE:
        return forth
    return float(np.minimum(forth, _share(other.cloud, one.cloud, inverse(T_one_other))))


def is_gone(before: Sighting, now: Sighting) -> bool:
    """Whether something that stood where one scan was taken is gone where the next was: returns
    come from behind it. A person or a door that comes into view is nearer, not farther. False where
    the two are too far apart to tell, or know too little of the same directions."""
    T_before_now = between(before.T_map_base, now.T_map_base)
    if np.hypot(T_before_now[0], T_before_now[1]) > MOST_APART_M:
        return False
    known, _, behind = _compared(before.cloud, now.cloud, T_before_now)
    return known >= LEAST_KNOWN and behind >= max(GONE_BEAMS, GONE_SHARE * known)


def _share(view: Cloud, other: Cloud, T_view_other: FloatArray) -> float:
    """Share of the other scan's returns that contradict what is seen from ``view``."""
    known, before, behind = _compared(view, other, T_view_other)
    return (before + behind) / known if known >= LEAST_KNOWN else np.nan


def _compared(view: Cloud, other: Cloud, T_view_other: FloatArray) -> tuple[int, int, int]:
    """How many of the other scan's returns are in directions that ``view`` knows, and how many of
    these are nearer, and farther, than all that it saw there."""
    hits = other.points_m[other.hit]
    hits = hits[:: max(1, -(-len(hits) // MOST_BEAMS))]
    if not len(hits) or not len(view.points_m):
        return 0, 0, 0
    centre_m = view.origins_m.mean(axis=0)
    apart_m = transform_points(T_view_other, other.origins_m.mean(axis=0)) - centre_m
    bearing_rad, range_m = _polar(view.points_m - centre_m)
    range_m = np.where(view.hit, range_m, np.inf)
    order = np.argsort(bearing_rad, kind="stable")
    bearing_rad, range_m = bearing_rad[order], _without_losses(bearing_rad[order], range_m[order])
    seen_rad, seen_m = _polar(transform_points(T_view_other, hits) - centre_m)
    reach_m = float(np.hypot(apart_m[0], apart_m[1])) + SLACK_M
    return _compare(bearing_rad, range_m, seen_rad, seen_m, reach_m)


def _polar(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.arctan2(points_m[:, 1], points_m[:, 0]), np.hypot(points_m[:, 0], points_m[:, 1])


@kernel
def _without_losses(bearing_rad: FloatArray, range_m: FloatArray) -> FloatArray:
    """Ranges (n,) of sorted beams, inf without a return, in which beams between two returns of one
    surface are on it if so many in a row are lost by chance: a lidar that loses each fifth return
    would know of no direction, as among its neighbours there is always one that saw nothing."""
    inner = lost = 0
    for i in range(1, range_m.size - 1):
        if range_m[i - 1] < np.inf and range_m[i + 1] < np.inf:
            inner += 1
            lost += range_m[i] == np.inf
    if not 0 < lost < inner:
        return range_m
    longest = int(np.log(LOST_TOGETHER) / np.log(lost / inner))
    filled, last = range_m.copy(), -1
    for i in range(range_m.size):
        if range_m[i] == np.inf:
            continue
        if 0 <= last < i - 1 <= last + longest:
            turn_rad, step_m = bearing_rad[i] - bearing_rad[last], range_m[i] - range_m[last]
            apart_m = np.hypot(step_m, min(range_m[i], range_m[last]) * turn_rad)
            if apart_m <= LOST_WIDTH_M:
                for k in range(last + 1, i):
                    share = (bearing_rad[k] - bearing_rad[last]) / max(turn_rad, 1e-9)
                    filled[k] = range_m[last] + share * step_m
        last = i
    return filled


@kernel
def _compare(
    bearing_rad: FloatArray,
    range_m: FloatArray,
    seen_rad: FloatArray,
    seen_m: FloatArray,
    apart_m: float,
) -> tuple[int, int, int]:
    """How many of the points seen are in a direction that the sorted beams know, and how many of
    these nearer, and farther, than all beams of that direction."""
    beams = bearing_rad.size
    known, before, behind = 0, 0, 0
    for k in range(seen_rad.size):
        middle = np.searchsorted(bearing_rad, seen_rad[k])
        low, high = np.inf, 0.0
        reached = True
        for side in (-1, 1):
            i = middle if side == 1 else middle - 1
            count = 0
            while 0 <= i < beams:
                wide = min(apart_m / max(min(range_m[i], seen_m[k]), 1e-3), WIDEST_RAD)
                if count >= 2 and abs(bearing_rad[i] - seen_rad[k]) > wide:
                    break
                low, high = min(low, range_m[i]), max(high, range_m[i])
                count += 1
                i += side
            reached = reached and count > 0
        if not reached or high == np.inf:
            continue
        known += 1
        slack_m = TOLERANCE_M + TOLERANCE_SHARE * seen_m[k]
        before += seen_m[k] < low - slack_m
        behind += seen_m[k] > high + slack_m
    return known, before, behind
