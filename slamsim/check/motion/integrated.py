"""Integrated motion of gyroscope and wheels, interpolated at any instant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from slamsim.check.motion.wheel_counts import unwrapped
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import BoolArray, FloatArray, IntArray, PlanarTrajectory
from slamsim.guard.numbers import (
    MOST,
    MOST_NS,
    is_sound,
    require_finite,
    require_number,
    require_stamps,
)
from slamsim.models.differential_drive import (
    arcs_between,
    forward_and_turn,
    left_and_right,
    lever_m2,
    metres_per_tick,
    pose_reading,
)
from slamsim.models.wheel_gyro import turn_at_midpoints
from slamsim.recording import RawImu, RawOdometry, RawTicks
from slamsim.recording.cleaning.scans import MOVING_M_S, MOVING_RAD_S

GAP_PERIODS = 4.0
"""A pause this many times the usual period is a gap, across which there is no motion."""

LEAST_SAMPLES = 8
MOST_M_S, MOST_RAD_S = 20.0, 60.0
"""No robot indoors is faster: the counter has been reset, the pose set anew; unless it is always
so, in another unit."""

USUAL_TIMES = 10.0
"""Nor does any robot make a step this many times as fast as nine tenths of its steps are."""

COMPARED_S = 0.2
"""Sideways motion is compared with turns over so long: single poses are rounded, and noisy."""
LEAST_AHEAD_M = 0.002
"""No brackets are better."""
MOST_UNEXPLAINED, MOST_OF_LATE_HEADING = 0.1, 0.5
"""Of what a frame moves sideways, squared: what turns leave, and that over what a late heading
leaves."""

USUAL_TRACK_M = 0.35
"""Of robots indoors, where poses do not tell it: most have 0.2 to 0.5 m."""


@dataclass(frozen=True, slots=False, eq=False)
class IntegratedMotion:
    """Motion of one stream, integrated from its start, by its own clock.

    stamps_ns: (n,) strictly increasing. totals: (n, k): of a gyroscope (turn,) in the units it
    reports, of wheels (path m, turn rad) by the numbers that their driver uses. reading: (k,)
    standard deviation that reading adds to any total. track_m: 0 unless there are two counters.
    axis: of the base, about which a gyroscope turns. aside_m: (n - 1,) how far each step of poses
    leads to the left. sideways_m: the same where it is believed, as of a frame that is plainly not
    at the axle; None where it is not.
    """

    topic: str
    stamps_ns: IntArray
    totals: FloatArray
    reading: FloatArray
    track_m: float = 0.0
    axis: str = "z"
    aside_m: FloatArray | None = None
    sideways_m: FloatArray | None = None

    def __post_init__(self) -> None:
        require_stamps(f"totals of {self.topic}", self.stamps_ns)
        require_finite(f"totals of {self.topic}", self.totals, (len(self.stamps_ns), None), MOST**4)
        require_finite(f"errors of {self.topic}", self.reading, (None,), MOST**4)
        require_number(f"the track of {self.topic} in m", self.track_m, 0.0)
        shape = (len(self.stamps_ns) - 1,)
        for aside_m in (self.aside_m, self.sideways_m):
            if aside_m is not None:
                require_finite(f"sideways steps of {self.topic}", aside_m, shape, MOST**4)

    @property
    def wired(self) -> bool:
        """Whether these are counters of two wheels, not poses that a driver made of them."""
        return self.track_m > 0.0

    @property
    def lever_m2(self) -> float:
        """How far unequal wheels drive forward per radian and curvature of theirs."""
        return lever_m2(self.likely_track_m)

    @property
    def likely_track_m(self) -> float:
        """Of poses, which do not tell it, the usual one."""
        return self.track_m or USUAL_TRACK_M

    @property
    def origin_ns(self) -> int:
        """The first stamp."""
        return int(self.stamps_ns[0])

    @cached_property
    def period_s(self) -> float:
        """The median time between samples."""
        return float(np.median(np.diff(self.stamps_ns))) * 1e-9

    @cached_property
    def times_s(self) -> FloatArray:
        """(n,) since ``origin_ns``."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9)

    @cached_property
    def _curve(self) -> CubicHermiteSpline:
        return smooth_curve(self.times_s, self.totals)

    def at(self, times_s: FloatArray) -> FloatArray:
        """(m, k) totals at times (m,) since ``origin_ns``; constant beyond the ends."""
        inside = np.clip(times_s, 0.0, self.times_s[-1])
        return np.asarray(self._curve(inside))

    def covers(self, start_s: FloatArray, end_s: FloatArray) -> BoolArray:
        """(m,) whether the stream has no gap between these times since ``origin_ns``."""
        gaps = np.flatnonzero(np.diff(self.times_s) > GAP_PERIODS * self.period_s)
        begins, ends = self.times_s[gaps], self.times_s[gaps + 1]
        inside = (start_s >= 0.0) & (end_s <= self.times_s[-1])
        return np.asarray(
            inside & (np.searchsorted(ends, start_s) == np.searchsorted(begins, end_s))
        )


def rearranged(wheels: IntegratedMotion, wiring: str) -> IntegratedMotion:
    """The same counters with left and right exchanged or reversed: see ``alignment.Wiring``."""
    left, right = left_and_right(wheels.totals[:, 0], wheels.totals[:, 1], wheels.track_m)
    if wiring == "swapped":
        left, right = right, left
    if wiring in ("left reversed", "both reversed"):
        left = -left
    if wiring in ("right reversed", "both reversed"):
        right = -right
    return replace(wheels, totals=forward_and_turn(np.column_stack([left, right]), wheels.track_m))


def smooth_curve(times_s: FloatArray, values: FloatArray) -> CubicHermiteSpline:
    """Through (n, k) values, with slopes by central differences."""
    return CubicHermiteSpline(times_s, values, np.gradient(values, times_s, axis=0))


def integrated_gyro(imu: RawImu, axis_imu: FloatArray, axis: str = "z") -> IntegratedMotion | None:
    """The turn about an axis (3,) of the unit's frame, by its name in the base; None for fewer
    than ``LEAST_SAMPLES``.
    """
    rates = imu.angular_velocity_rad_s @ axis_imu
    good = _in_order(imu.stamps_ns, is_sound(rates))
    if good.size < LEAST_SAMPLES:
        return None
    stamps, rates = imu.stamps_ns[good], rates[good]
    middle, totals = turn_at_midpoints(stamps, rates)
    return IntegratedMotion(imu.topic, middle, totals[:, None], np.zeros(1), axis=axis)


def integrated_wheels(ticks: RawTicks) -> IntegratedMotion | None:
    """Path, m, and turn, rad, by the nominal radius and track; None for fewer than
    ``LEAST_SAMPLES`` or nominal sizes that are no positive numbers."""
    nominal = np.array([ticks.ticks_per_revolution, ticks.wheel_radius_m, ticks.track_m])
    if not (is_sound(nominal).all() and (nominal > 0.0).all()):
        return None
    good = _in_order(ticks.stamps_ns, np.ones(len(ticks), dtype=np.bool_))
    if good.size < LEAST_SAMPLES:
        return None
    tick_m = metres_per_tick(ticks.ticks_per_revolution, ticks.wheel_radius_m)
    counts = np.column_stack([unwrapped(wheel) for wheel in ticks.ticks[good].T])
    steps = forward_and_turn(np.diff(counts, axis=0) * tick_m, ticks.track_m)
    in_time = _stamped_in_time(steps, ticks.stamps_ns[good])
    stamps, counts = ticks.stamps_ns[good][in_time], counts[in_time]
    totals = _possible(forward_and_turn(np.diff(counts, axis=0) * tick_m, ticks.track_m), stamps)
    # Counts are rounded down: errors of one reading are uniform over a tick.
    reading = tick_m / np.sqrt(12.0) * np.array([np.sqrt(0.5), np.sqrt(2.0) / ticks.track_m])
    return IntegratedMotion(ticks.topic, stamps, totals, reading, ticks.track_m)


def integrated_odometry(odometry: RawOdometry) -> IntegratedMotion | None:
    """Poses taken as wheels: the path, m, along the heading midway and the turn, rad, of each step;
    None for fewer than ``LEAST_SAMPLES``."""
    yaw = yaw_from_xyzw(odometry.quats_xyzw)
    poses = np.column_stack([odometry.positions_m[:, :2], yaw])
    good = _in_order(odometry.stamps_ns, is_sound(poses))
    if good.size < LEAST_SAMPLES:
        return None
    stamps, poses = odometry.stamps_ns[good], poses[good]
    in_time = _stamped_in_time(arcs_between(poses)[:, [0, 2]], stamps)
    stamps, poses = stamps[in_time], poses[in_time]
    arcs = arcs_between(poses)
    totals = _possible(arcs[:, [0, 2]], stamps)
    read = pose_reading(PlanarTrajectory(stamps, poses))
    reading = np.array([read.sigma_m, read.sigma_rad]) / np.sqrt(2.0)
    seconds = np.diff(stamps)[:, None] * 1e-9
    made = np.abs(arcs) < np.array([MOST_M_S, MOST_M_S, MOST_RAD_S]) * seconds
    made_arcs = np.where(made.all(axis=1, keepdims=True), arcs, 0.0)
    return IntegratedMotion(
        odometry.topic,
        stamps,
        totals,
        reading,
        aside_m=made_arcs[:, 1],
        sideways_m=made_arcs[:, 1] if _off_axle(made_arcs, seconds) else None,
    )


def _off_axle(arcs: FloatArray, seconds: FloatArray) -> bool:
    """Whether arcs (n, 3), each of so many seconds (n, 1), are plainly those of a frame ahead of
    the axle, or behind it.

    It moves sideways in turns, by its distance to the axle for each radian however fast it drives.
    A heading that comes late makes it seem so too, but by more the faster it drives.
    """
    starts = np.arange(0, len(arcs), max(round(COMPARED_S / float(np.median(seconds))), 1))
    rates = np.add.reduceat(arcs, starts) / np.add.reduceat(seconds, starts)
    speed, aside, turn = rates.T
    by_turn, by_late_heading = (_unexplained(aside, by) for by in (turn, turn * speed))
    ahead_m = abs(float(aside @ turn)) / max(float(turn @ turn), 1e-12)
    plain = by_turn < MOST_UNEXPLAINED and by_turn < MOST_OF_LATE_HEADING * by_late_heading
    return ahead_m > LEAST_AHEAD_M and plain


def _unexplained(values: FloatArray, by: FloatArray) -> float:
    """Share of the squares of values (n,) that no multiple of others (n,) explains."""
    squares = float((values @ values) * (by @ by))
    return 1.0 - float(values @ by) ** 2 / squares if squares > 0.0 else 1.0


def _stamped_in_time(steps: FloatArray, stamps_ns: IntArray) -> BoolArray:
    """(n,) which samples were not stamped late, right before the next one.

    The step (n - 1, 2) of a late one to the next is one that no robot makes in that time, and that
    any makes in the usual time between samples. Of samples that come together the last one is the
    least late.
    """
    own_s = np.diff(stamps_ns)[:, None] * 1e-9
    usual_s = np.maximum(own_s, np.median(own_s))
    speeds = zip((np.abs(steps) / usual_s).T, (MOVING_M_S, MOVING_RAD_S), strict=True)
    # Of steps that move: a robot that mostly stands is not fast where it drives.
    most = USUAL_TIMES * np.array(
        [np.quantile(np.append(speed[speed > least], least), 0.9) for speed, least in speeds]
    )
    by_own, by_usual = ((np.abs(steps) > most * each).any(axis=1) for each in (own_s, usual_s))
    late = by_own & ~by_usual
    return np.append(~late, True)


def _possible(steps: FloatArray, stamps_ns: IntArray) -> FloatArray:
    """(n, 2) path and turn added up, without (n - 1, 2) steps that no robot makes."""
    seconds = np.diff(stamps_ns)[:, None] * 1e-9
    usual = USUAL_TIMES * np.quantile(np.abs(steps) / seconds, 0.9, axis=0)
    fast = np.abs(steps) >= np.maximum(np.array([MOST_M_S, MOST_RAD_S]), usual) * seconds
    made = np.where(fast.any(axis=1, keepdims=True), 0.0, steps)
    return np.vstack([np.zeros(2), np.cumsum(made, axis=0)])


def _in_order(stamps_ns: IntArray, good: BoolArray) -> IntArray:
    """Places of the good samples by ascending stamp, of those with one stamp the first."""
    places = np.flatnonzero(good & (stamps_ns >= -MOST_NS) & (stamps_ns <= MOST_NS))
    return np.asarray(places[np.unique(stamps_ns[places], return_index=True)[1]])
