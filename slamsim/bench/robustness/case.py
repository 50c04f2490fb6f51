"""One case: simulate, disturb, map, compare with the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.robustness.conditions import Conditions
from slamsim.bench.robustness.disturbances import disturbed
from slamsim.bench.truth import false_closures
from slamsim.config.run import RunConfig
from slamsim.core.geometry import compose
from slamsim.core.result import Event, EventKind, SlamResult
from slamsim.core.types import Log, PlanarTrajectory
from slamsim.evaluate.bound import trajectory_bound
from slamsim.evaluate.trajectory import align_se2, compare, statistics
from slamsim.guard.errors import SlamsimError
from slamsim.io.open import read_log, read_truth
from slamsim.process.worker import time_limit
from slamsim.run.mapping import LEAST_USED
from slamsim.simulation.simulate import Simulation, simulate
from slamsim.slam.session import run_slam

LIMIT_S = 600.0
"""A case that takes longer is ended; the largest take a minute."""


def run_case(conditions: Conditions) -> Figures:
    """Conditions and figures of one case, in this process."""
    known: Figures = {**asdict(conditions), "repeat": conditions.repeat}
    began_s = time.process_time()
    with time_limit(LIMIT_S), TemporaryDirectory() as folder:
        try:
            config = conditions.config()
            simulation = simulate(config, Path(folder) / "log")
        except SlamsimError as error:
            return {**known, "error": str(error)}
        plain, truth = read_log(Path(folder) / "log"), read_truth(Path(folder) / "log")
        assert truth is not None
        log, true_path, carried_ns = disturbed(plain, truth.planar(), conditions)
        known |= {
            "scans": len(log.scans),
            "driven_m": true_path.path_length_m(),
            "kidnappings": len(carried_ns),
        }
        simulated_s = time.process_time() - began_s
        try:
            result = run_slam(log, config.slam)
        except SlamsimError as error:
            return {**known, "outcome": "told", "why": str(error)}
        mapped_s = time.process_time() - began_s - simulated_s
        return {
            **known,
            **_compared(result, log, true_path, carried_ns, config, simulation),
            "cpu_s": {"simulate": simulated_s, "slam": mapped_s},
        }


def _compared(
    result: SlamResult,
    log: Log,
    truth: PlanarTrajectory,
    carried_ns: tuple[int, ...],
    config: RunConfig,
    simulation: Simulation,
) -> Figures:
    def bound_m() -> float | None:
        if carried_ns:  # the bound does not know of kidnappings
            return None
        outline_m = simulation.world.solids.section(float(log.T_base_laser[2, 3]))
        track_m = config.robot.drive_wheels.track_m
        bound = trajectory_bound(
            outline_m, truth, result.odometry, log.T_base_laser, config.sensors, track_m
        )
        return None if bound is None else bound.ate_m

    verdict = judge(result, truth, _failure(result, log), bound_m)
    false = false_closures(result.graph, truth, FALSE_CLOSURE_M)
    first_ns = int(truth.stamps_ns[0])
    return {
        **asdict(verdict),
        "odometry_ate_m": statistics(compare(result.odometry, truth).translation_m).rmse,
        "closures": result.closures_accepted,
        "false_closures": sum(check.believed for check in false),
        "false_kidnappings": false_kidnappings(result.events, carried_ns),
        "kidnappings_told": kidnappings_told(result.events, carried_ns),
        "carried_s": [(at_ns - first_ns) * 1e-9 for at_ns in carried_ns],
        "events": [
            f"{(e.start_ns - first_ns) * 1e-9:.1f}-{(e.end_ns - first_ns) * 1e-9:.1f} s {e.kind}"
            for e in result.events
        ],
        "warnings": list(result.warnings),
    }


def _failure(result: SlamResult, log: Log) -> str | None:
    """Why ``slamsim map`` ends with 1 after such a result, None if it ends with 0."""
    if result.failed:
        return "; ".join(map(str, result.failed))
    used, scans = len(result.trajectory), max(len(log.scans), log.recorded_scans)
    if used < LEAST_USED * scans:
        return f"only {used} of {scans} scans were used"
    return None


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
