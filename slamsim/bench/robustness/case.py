"""One case: simulate, disturb, map, compare with the truth."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.bench.robustness.conditions import Conditions
from slamsim.bench.robustness.disturbances import disturbed
from slamsim.bench.robustness.verdict import (
    FALSE_CLOSURE_M,
    false_kidnappings,
    judge,
    kidnappings_told,
)
from slamsim.bench.truth import false_closures
from slamsim.config.run import RunConfig
from slamsim.core.result import SlamResult
from slamsim.core.types import Log, PlanarTrajectory
from slamsim.evaluate.bound import trajectory_bound
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.guard.errors import SlamsimError
from slamsim.io.open import read_log, read_truth
from slamsim.process.worker import time_limit
from slamsim.run.mapping import LEAST_USED
from slamsim.simulation.simulate import Simulation, simulate
from slamsim.slam.session import run_slam

Figures = dict[str, object]

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
