"""Verdict on a run against the truth: tracked, failure reported, or silently wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slamsim.core.geometry import compose
from slamsim.core.result import Event, EventKind, SlamResult
from slamsim.core.types import PlanarTrajectory
from slamsim.evaluate.trajectory import align_se2, compare, statistics

Outcome = Literal["tracked", "told", "silently wrong"]

GOOD_M = 0.05
TIMES_BOUND = 10.0
"""A run is tracked whose ATE is within GOOD_M or so many times the Cramer-Rao bound."""

TELLING: frozenset[EventKind] = frozenset(
    ("kidnapped", "joined", "torn", "lost", "blind", "gap", "odometry", "open loop")
)
"""Events that say that poses before them and after them may not fit together."""

NOTICED_NS = 2_000_000_000
"""A kidnapping is told if an event about it begins or ends within so much of it."""

FALSE_CLOSURE_M = 0.3
"""A closure is false here beyond this (and 5 of its own sigmas, or beyond 3 degrees): ranges that
are 5 cm too long move views of a wall from its two sides 0.1 m apart without any place being
mistaken for another, and places that are mistaken are most of a door's width apart."""


@dataclass(frozen=True, slots=True)
class CaseVerdict:
    """tolerance_m: up to which ATE the run counts as tracked. why: what tells of the failure."""

    outcome: Outcome
    ate_m: float
    tolerance_m: float
    why: str = ""


def judge(
    result: SlamResult,
    truth: PlanarTrajectory,
    failure: str | None,
    bound_m: Callable[[], float | None],
) -> CaseVerdict:
    """How a run ended that gave a result.

    failure: why ``slamsim map`` ends with a code that is not 0, None if it does not. bound_m: the
    Cramer-Rao bound of the ATE, asked for only where it decides.
    """
    ate_m = statistics(compare(result.trajectory, truth).translation_m).rmse
    tolerance_m = GOOD_M
    if ate_m > GOOD_M:
        tolerance_m = max(GOOD_M, TIMES_BOUND * (bound_m() or 0.0))
    if failure is not None:
        return CaseVerdict("told", ate_m, tolerance_m, failure)
    if ate_m <= tolerance_m:
        return CaseVerdict("tracked", ate_m, tolerance_m)
    worst_m = worst_piece_m(result.trajectory, truth, result.events)
    if worst_m <= tolerance_m:
        kinds = sorted({event.kind for event in result.events if event.kind in TELLING})
        return CaseVerdict("told", ate_m, tolerance_m, f"events: {', '.join(kinds)}")
    return CaseVerdict("silently wrong", ate_m, tolerance_m)


def worst_piece_m(
    track: PlanarTrajectory, truth: PlanarTrajectory, events: Sequence[Event]
) -> float:
    """The largest ATE of the pieces that telling events cut a track into, each aligned alone.

    What lies within an event's time is part of no piece; without an event the piece is the whole.
    If events tell of all that is wrong, every piece is right in itself.
    """
    spans = [(e.start_ns, e.end_ns) for e in events if e.kind in TELLING]
    covered = (track.stamps_ns >= truth.stamps_ns[0]) & (track.stamps_ns <= truth.stamps_ns[-1])
    piece = np.zeros(len(track), dtype=np.int64)
    for start_ns, end_ns in spans:
        piece += track.stamps_ns >= start_ns
        covered &= (track.stamps_ns < start_ns) | (track.stamps_ns > end_ns)
    worst_m = 0.0
    for number in np.unique(piece[covered]).tolist():
        inside = covered & (piece == number)
        true_poses, poses = truth.at(track.stamps_ns[inside]), track.poses[inside]
        aligned = compose(align_se2(poses, true_poses), poses)
        off_m = np.hypot(*(aligned - true_poses)[:, :2].T)
        worst_m = max(worst_m, statistics(off_m).rmse)
    return worst_m


def false_kidnappings(events: Sequence[Event], carried_ns: Sequence[int]) -> int:
    """Events that say that the robot was carried when it was not."""
    said = [event for event in events if event.kind == "kidnapped"]
    return sum(not any(_about(event, at_ns) for at_ns in carried_ns) for event in said)


def kidnappings_told(events: Sequence[Event], carried_ns: Sequence[int]) -> int:
    """How many of the times that the robot was carried an event tells of."""
    said = [event for event in events if event.kind in ("kidnapped", "joined", "torn")]
    return sum(any(_about(event, at_ns) for event in said) for at_ns in carried_ns)


def _about(event: Event, at_ns: int) -> bool:
    return min(abs(event.start_ns - at_ns), abs(event.end_ns - at_ns)) <= NOTICED_NS
