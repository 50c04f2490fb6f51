"""What wheel counters show: that they overflow, or stand still while the wheels turn."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.course import Course
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.wheel_counts import counter_range
from slamsim.core.types import BoolArray, FloatArray
from slamsim.recording import RawTicks

MOVED_M, MOVED_RAD = 0.05, 0.1
"""In a second: less is standing."""
LEAST_FROZEN_S = 2
TURNS_OF_OTHER = 2.0
"""So far the other wheel has turned before one that never counts is taken to be broken."""


def check_counter(ticks: RawTicks) -> Iterator[Finding]:
    """The counters by themselves."""
    yield _wrap(ticks)
    yield from _dead_wheel(ticks)


def counters_stand(published: FloatArray, counted: FloatArray) -> BoolArray:
    """(k,) seconds in which nothing is counted while the odometry goes on; none of a single one,
    which may be where the robot starts, stops, or is set elsewhere."""
    moved = (np.abs(published) > np.array([MOVED_M, MOVED_RAD])).any(axis=1)
    frozen = moved & (np.abs(counted) < 1e-9).all(axis=1)
    return np.asarray(frozen & (int(frozen.sum()) >= LEAST_FROZEN_S))


def check_counting(wheels: Course, published: FloatArray, frozen: BoolArray) -> Finding:
    """The counters second by second beside the odometry (k, 2); frozen: (k,) ``counters_stand``."""
    seconds = int(frozen.sum())
    estimate = Estimate(float(seconds), 0.0, "s")
    if not seconds:
        words = "the counters count whenever the odometry moves"
        return Finding("wheels.counting", wheels.topic, "ok", words, None, "", estimate, 0.0)
    way_m = float(np.abs(published[frozen, 0]).sum())
    words = f"the counters stand for {seconds} s while the odometry moves on, by {way_m:.2f} m"
    advice = "Look for a loose cable or a driver of the counters that stalls."
    return Finding(
        *("wheels.counting", wheels.topic, "bad", words, "ticks_frozen", advice),
        *(estimate, 0.0),
    )


def _wrap(ticks: RawTicks) -> Finding:
    whole = next(filter(None, (counter_range(wheel) for wheel in ticks.ticks.T)), None)
    if whole is None:
        return Finding("wheels.counter", ticks.topic, "ok", "the counters never wrap")
    words = f"the counters wrap round: they have {whole} different values"
    advice = "Take differences modulo that number, or count with 32 bits or more."
    mend = Mend("unwrap_ticks", ticks.topic, {"modulus": float(whole)})
    return Finding("wheels.counter", ticks.topic, "bad", words, "ticks_wrap", advice, mends=(mend,))


def _dead_wheel(ticks: RawTicks) -> Iterator[Finding]:
    """One counter that never counts while the other one does."""
    counts = ticks.ticks.astype(np.float64)
    rolled = np.abs(np.diff(counts, axis=0)).sum(axis=0) / max(ticks.ticks_per_revolution, 1)
    if (rolled == 0.0).any() and rolled.max() > TURNS_OF_OTHER:
        side = ("left", "right")[int(np.argmin(rolled))]
        words = f"the {side} wheel never counts, while the other one makes {rolled.max():.1f} turns"
        yield Finding(
            *("wheels.counting", ticks.topic, "bad", words, "ticks_frozen"),
            "Look for a loose cable: a robot that drives on one wheel goes round in circles.",
        )
