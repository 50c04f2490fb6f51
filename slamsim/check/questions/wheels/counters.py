"""Faults of wheel counters: overflow, or no counts while the wheels turn."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.fault_groups import WHEELS
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.wheel_counts import counter_range
from slamsim.check.question import FaultKind, Question, anywhere, judge
from slamsim.core.types import BoolArray, FloatArray
from slamsim.recording import RawTicks
from slamsim.recording.repairs.base import Repair

MOVED_M, MOVED_RAD = 0.05, 0.1
"""In a second: less is standing."""
LEAST_FROZEN_S = 2
TURNS_OF_OTHER = 2.0
"""So far the other wheel has turned before one that never counts is taken to be broken."""

TICKS_FROZEN = FaultKind(
    "ticks_frozen",
    "a wheel counter stands still while the robot moves",
    (anywhere(*WHEELS, "odometry_frozen"),),
)
COUNTER = Question(
    "wheels.counter",
    "the counters never wrap",
    (
        FaultKind(
            "ticks_wrap",
            "the wheel counter wraps round",
            (anywhere("odometry_contradicts_wheels", "wheel_slip", "odometry_jump"),),
        ),
    ),
    consequence="an odometry that does not expect it jumps by the range of the counter",
    repairs=("unwrap_ticks",),
)
COUNTING = Question(
    "wheels.counting",
    "the counters count whenever the odometry moves",
    (TICKS_FROZEN,),
    limit=0.0,
    unit="s",
    consequence="an odometry made of the counters stands still, or goes round in circles",
    excitation_wanted="driving, with odometry and counters recorded",
)


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


def check_counting(wheels: IntegratedMotion, published: FloatArray, frozen: BoolArray) -> Finding:
    """The counters second by second beside the odometry (k, 2); frozen: (k,) ``counters_stand``."""
    seconds = int(frozen.sum())
    path_m = float(np.abs(published[frozen, 0]).sum())
    return judge(
        COUNTING,
        wheels.topic,
        {
            "ok": "the counters count whenever the odometry moves",
            "fault": f"the counters stand for {seconds} s while the odometry moves on, by "
            f"{path_m:.2f} m",
        },
        Measurement(float(seconds), 0.0, "s"),
        advice="Look for a loose cable or a driver of the counters that stalls.",
    )


def _wrap(ticks: RawTicks) -> Finding:
    whole = next(filter(None, (counter_range(wheel) for wheel in ticks.ticks.T)), None)
    if whole is None:
        return judge(COUNTER, ticks.topic, "the counters never wrap", verdict="ok")
    return judge(
        COUNTER,
        ticks.topic,
        f"the counters wrap round: they have {whole} different values",
        verdict="fault",
        advice="Take differences modulo that number, or count with 32 bits or more.",
        repairs=(Repair("unwrap_ticks", ticks.topic, {"modulus": float(whole)}),),
    )


def _dead_wheel(ticks: RawTicks) -> Iterator[Finding]:
    """One counter that never counts while the other one does."""
    counts = ticks.ticks.astype(np.float64)
    rolled = np.abs(np.diff(counts, axis=0)).sum(axis=0) / max(ticks.ticks_per_revolution, 1)
    if (rolled == 0.0).any() and rolled.max() > TURNS_OF_OTHER:
        side = ("left", "right")[int(np.argmin(rolled))]
        yield judge(
            COUNTING,
            ticks.topic,
            f"the {side} wheel never counts, while the other one makes {rolled.max():.1f} turns",
            verdict="fault",
            advice="Look for a loose cable: a robot that drives on one wheel goes round in "
            "circles.",
        )
