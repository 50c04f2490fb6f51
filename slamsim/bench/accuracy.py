"""How good SLAM is over many seeds: each simulated, mapped and compared with its truth."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from slamsim.bench.alone import Children
from slamsim.bench.logs import kept_or_temporary, simulated_log
from slamsim.bench.tables import SEED_HEADER, seed_line, summary_rows
from slamsim.bench.truth import false_closures, revisits_closed
from slamsim.config.run import RunConfig
from slamsim.config.slam import SlamConfig
from slamsim.console import Reporter
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.logs.reader import read_log, read_truth
from slamsim.run.stages import peak_memory_mb
from slamsim.safe.errors import InputRefused, SlamsimError
from slamsim.slam.session import run_slam
from slamsim.types import Log, PlanarTrajectory, SlamResult

Figures = dict[str, object]


@dataclass(frozen=True, slots=True)
class Campaign:
    """What to run. seeds: one run each. workers: runs at a time. logs: where simulated logs are
    kept and found again; None makes them for this run alone."""

    config: RunConfig
    seeds: Sequence[int]
    workers: int
    logs: Path | None


def run_accuracy(campaign: Campaign, reporter: Reporter) -> Figures:
    """Every number per seed, and the summary over all seeds that could be run.

    A seed that fails, in the drive or in SLAM, is told and counted, and the others go on.
    """
    reporter.say(SEED_HEADER)
    runs: list[Figures] = []
    with kept_or_temporary(campaign.logs) as folder, reporter.stage("accuracy", "") as progress:
        for figures in _all_seeds(campaign, folder):
            runs.append(figures)
            reporter.say(seed_line(figures))
            progress(len(runs), len(campaign.seeds))
    runs.sort(key=lambda figures: int(str(figures["seed"])))
    summary = summarise(runs)
    reporter.table(f"Accuracy over {len(runs)} seeds", summary_rows(summary))
    return {"world": campaign.config.world.name, "summary": summary, "runs": runs}


def summarise(runs: Sequence[Figures]) -> Figures:
    """Medians, worst cases and sums over the seeds that were run to the end."""
    done = [run for run in runs if "error" not in run]
    summary: Figures = {"seeds": len(runs), "failed": len(runs) - len(done)}
    for key in _SPREAD:
        values = np.array([run[key] for run in done if run.get(key) is not None], dtype=float)
        if values.size:
            summary[key] = {
                "median": float(np.median(values)),
                "mean": float(values.mean()),
                "worst": float(values.max()),
            }
    for key in _COUNTED:
        summary[key] = sum(int(str(run[key])) for run in done)
    return summary


_SPREAD = (
    "ate_rmse_m",
    "ate_max_m",
    "ate_rot_rmse_deg",
    "ate_rot_max_deg",
    "front_end_ate_rmse_m",
    "odometry_ate_rmse_m",
    "path_length_m",
    "ms_per_scan",
    "cpu_ms_per_scan",
    "peak_memory_mb",
)
_COUNTED = (
    "scans",
    "scans_lost",
    "scans_unused",
    "closures",
    "closures_withdrawn",
    "closures_false",
    "closures_false_withdrawn",
    "revisits",
    "revisits_closed",
)


def _all_seeds(campaign: Campaign, folder: Path) -> Iterator[Figures]:
    """Figures of each seed, in the order in which they are done."""
    with ThreadPoolExecutor(campaign.workers) as threads, Children() as children:
        futures = [
            threads.submit(_one_seed, campaign.config, seed, folder, children)
            for seed in campaign.seeds
        ]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            threads.shutdown(wait=False, cancel_futures=True)


def _one_seed(config: RunConfig, seed: int, folder: Path, children: Children) -> Figures:
    seeded = config.model_copy(update={"seed": seed})
    try:
        log = simulated_log(seeded, folder, children)
        return {"seed": seed, **children.run(measure, log, config.slam)}
    except SlamsimError as error:
        return {"seed": seed, "error": str(error)}


def measure(folder: Path, config: SlamConfig) -> Figures:
    """All numbers of one run over a recording that knows its truth, in this process.

    Raises InputRefused for a recording without truth, and what SLAM raises.
    """
    log, truth = read_log(folder), read_truth(folder)
    if truth is None:
        raise InputRefused(folder, "this recording holds no truth")
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = run_slam(log, config)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    return {
        **_trajectory_figures(result, truth.planar()),
        **_scan_figures(log, result),
        **_closure_figures(result, truth.planar()),
        "ms_per_scan": 1e3 * wall_s / len(log.scans),
        "cpu_ms_per_scan": 1e3 * cpu_s / len(log.scans),
        "peak_memory_mb": peak_memory_mb(),
        "warnings": list(result.warnings),
    }


def _trajectory_figures(result: SlamResult, truth: PlanarTrajectory) -> Figures:
    errors = compare(result.trajectory, truth)
    off_m, off_rad = statistics(errors.translation_m), statistics(errors.rotation_rad)
    return {
        "path_length_m": errors.truth.path_length_m(),
        "ate_rmse_m": off_m.rmse,
        "ate_max_m": off_m.max,
        "ate_rot_rmse_deg": float(np.rad2deg(off_rad.rmse)),
        "ate_rot_max_deg": float(np.rad2deg(off_rad.max)),
        "front_end_ate_rmse_m": _ate_m(result.front_end, truth),
        "odometry_ate_rmse_m": _ate_m(result.odometry, truth),
    }


def _ate_m(trajectory: PlanarTrajectory | None, truth: PlanarTrajectory) -> float | None:
    if trajectory is None:
        return None
    return statistics(compare(trajectory, truth).translation_m).rmse


def _scan_figures(log: Log, result: SlamResult) -> Figures:
    unmatched = int(np.count_nonzero(result.match_quality == 0.0))
    return {
        "scans": len(log.scans),
        "scans_lost": max(unmatched - 1, 0),  # the first one begins the map
        "scans_unused": len(log.scans) - len(result.trajectory),
    }


def _closure_figures(result: SlamResult, truth: PlanarTrajectory) -> Figures:
    closures = [edge for edge in result.graph.edges if edge.kind == "closure"]
    false = false_closures(result.graph, truth)
    revisits, closed = revisits_closed(result.graph, truth)
    believed = sum(edge.weight > 0.0 for edge in closures)
    return {
        "closures": believed,
        "closures_withdrawn": len(closures) - believed,
        "closures_false": sum(check.believed for check in false),
        "closures_false_withdrawn": sum(not check.believed for check in false),
        "false_closures": [asdict(check) for check in false],
        "closure_refusals": result.closure_refusals,
        "revisits": revisits,
        "revisits_closed": closed,
    }
