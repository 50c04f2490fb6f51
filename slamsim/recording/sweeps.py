"""The points of a cloud, and when each was measured, from what its messages say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, IntArray

_USUAL_PERIOD_S = 0.1
_INSTANT_S = 1e-6
_STRAIGHT = 0.02
"""Of the angle swept: by more a lidar that turns evenly is never off."""
_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))
"""Units in which times of points in a cloud are found."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """One cloud. xyz_m: (n, 3) finite, in the sensor's frame. ring, time: (n,) as recorded."""

    stamp_ns: int
    received_ns: int
    xyz_m: FloatArray
    ring: IntArray | None = None
    time: FloatArray | None = None

    def __getitem__(self, which: BoolArray) -> Points:
        ring = None if self.ring is None else self.ring[which]
        time = None if self.time is None else self.time[which]
        return replace(self, xyz_m=self.xyz_m[which], ring=ring, time=time)


@dataclass(frozen=True, slots=True)
class Sweep:
    """How a lidar turns. unit_s: of the times; is_absolute: they are no offsets from the stamp.

    direction: 1 counter-clockwise seen from above, -1 clockwise. s_per_rad: 0 if it is no sweep.
    """

    unit_s: float
    is_absolute: bool
    direction: int = 1
    s_per_rad: float = 0.0

    def after_stamp_s(self, times: FloatArray, stamp_ns: int) -> FloatArray:
        """(n,) seconds after the stamp of the cloud."""
        return times * self.unit_s - (1e-9 * stamp_ns if self.is_absolute else 0.0)


def sweep_of(clouds: Sequence[Points]) -> tuple[Sweep | None, str]:
    """(when the points of a lidar are measured, in words), from some clouds of it.

    The unit is the one in which a cloud lasts about as long as the time from one to the next.
    """
    timed = [cloud for cloud in clouds if cloud.time is not None and cloud.time.size > 1]
    instants = "each cloud counts as one instant"
    if not timed:
        return None, f"no time of the points: {instants}"
    times = [np.asarray(cloud.time, dtype=np.float64) for cloud in timed]
    span = float(np.median([np.ptp(each) for each in times]))
    if not (math.isfinite(span) and span > 0.0):
        return None, f"all times of the points are alike: {instants}"
    stamps_ns = np.array([cloud.stamp_ns for cloud in clouds], dtype=np.int64)
    steps_s = 1e-9 * np.diff(stamps_ns)
    steps_s = steps_s[steps_s > 0.0]
    period_s = float(np.median(steps_s)) if steps_s.size else _USUAL_PERIOD_S
    unit_s, unit = min(_UNITS, key=lambda each: abs(math.log(span * each[0] / period_s)))
    if span * unit_s < _INSTANT_S:
        return None, f"all times of the points are alike: {instants}"
    middle_s, stamp_s = float(np.median(times[0])) * unit_s, 1e-9 * timed[0].stamp_ns
    sweep = Sweep(unit_s, abs(middle_s - stamp_s) < abs(middle_s))
    words = f"beam times from the points', in {unit}"
    turns = [_turn(cloud.xyz_m, each * unit_s) for cloud, each in zip(timed, times, strict=True)]
    rates = [rate for rate in turns if rate is not None]
    if 2 * len(rates) <= len(turns):
        return sweep, f"{words}, which are no sweep: {instants}, the middle one"
    rate = float(np.median(rates))
    direction = 1 if rate > 0.0 else -1
    return Sweep(unit_s, sweep.is_absolute, direction, 1.0 / abs(rate)), words


def _turn(xyz_m: FloatArray, times_s: FloatArray) -> float | None:
    """rad/s, None if the points do not lie on an even turn."""
    order = np.argsort(times_s, kind="stable")
    times_s = times_s[order] - times_s[order[0]]
    angles_rad = np.unwrap(np.arctan2(xyz_m[order, 1], xyz_m[order, 0]))
    swept_rad = float(np.ptp(angles_rad))
    if angles_rad.size < 3 or swept_rad == 0.0 or times_s[-1] == 0.0:
        return None
    rate, offset = np.polyfit(times_s, angles_rad, 1)
    off_rad = angles_rad - rate * times_s - offset
    return float(rate) if off_rad.std() < _STRAIGHT * swept_rad and rate != 0.0 else None
