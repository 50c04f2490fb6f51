"""Accuracy of SLAM over many seeds: each is simulated, mapped and compared with the truth."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.logs import Children, each_done, kept_or_temporary, simulated_log
from slamsim.bench.truth import false_closures, revisits_closed
from slamsim.config.loading import load_world_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.result import SlamResult
from slamsim.core.types import Log, PlanarTrajectory
from slamsim.evaluate.consistency import nees_band
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.io.open import read_log, read_truth
from slamsim.process.children import MEMORY
from slamsim.run.scoring import Estimated, Known, score
from slamsim.run.stages import Stages
from slamsim.simulation.own_files import WORLD
from slamsim.slam.session import run_slam
from slamsim.world.build import build_world


@dataclass(frozen=True, slots=True)
class AccuracyCampaign:
    """What to run. seeds: one run each. workers: runs at a time. logs: where simulated logs are
    kept and found again; None makes them for this run alone. bound: whether to compute what is
    possible at best, which takes some seconds for every minute driven."""

    config: RunConfig
    seeds: Sequence[int]
    workers: int
    logs: Path | None
    bound: bool = True


def run_accuracy(campaign: AccuracyCampaign, reporter: Reporter) -> Figures:
    """Every number per seed, and the summary over all seeds that could be run.

    A seed that fails, in the drive or in SLAM, is told and counted, and the others go on.
    """
    reporter.say(SEED_HEADER)
    runs: list[Figures] = []
    with (
        kept_or_temporary(campaign.logs) as folder,
        reporter.stage("accuracy") as progress,
        each_done(
            [partial(_one_seed, campaign, seed, folder) for seed in campaign.seeds],
            campaign.workers,
        ) as done,
    ):
        for figures in done:
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
    for key in SPREAD:
        values = np.array([run[key] for run in done if run.get(key) is not None], dtype=float)
        if values.size:
            summary[key] = {
                "median": float(np.median(values)),
                "mean": float(values.mean()),
                "worst": float(values.max()),
            }
    for key in COUNTED:
        summary[key] = sum(int(str(run[key])) for run in done)
    return {**summary, **_consistency(done)}


def _consistency(done: Sequence[Figures]) -> Figures:
    """The mean over the seeds of each run's mean NEES, and where it should lie."""
    means = [cast(float, run["nees_mean"]) for run in done if run.get("nees_mean") is not None]
    if not means:
        return {}
    low, high = nees_band(len(means))
    mean = float(np.mean(means))
    verdict = "too sure" if mean > high else "too unsure" if mean < low else "inside"
    return {"nees": {"mean": mean, "band": [low, high], "verdict": verdict}}


SPREAD = (
    "ate_rmse_m",
    "ate_max_m",
    "ate_rot_rmse_deg",
    "ate_rot_max_deg",
    "ate_over_bound",
    "bound_ate_m",
    "nees_mean",
    "nees_in_map_mean",
    "front_end_ate_rmse_m",
    "odometry_ate_rmse_m",
    "path_length_m",
    "ms_per_scan",
    "cpu_ms_per_scan",
    "peak_memory_mb",
)
COUNTED = (
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


def _one_seed(campaign: AccuracyCampaign, seed: int, folder: Path, children: Children) -> Figures:
    seeded = campaign.config.model_copy(update={"seed": seed})
    try:
        log = simulated_log(seeded, folder, children)
        return {"seed": seed, **children.run(measure, log, seeded, campaign.bound)}
    except SlamsimError as error:
        return {"seed": seed, "error": str(error)}


def measure(folder: Path, config: RunConfig, bound: bool) -> Figures:
    """All numbers of one run over a simulated log, in this process.

    folder: as ``simulated_log`` leaves it. Raises InputRefused for a recording without truth, and
    what SLAM raises.
    """
    log, truth = read_log(folder), read_truth(folder)
    if truth is None:
        raise InputRefused(folder, "this recording holds no truth")
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = run_slam(log, config.slam)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    memory_mb = MEMORY.peak_mb()
    world = build_world(load_world_config(str(folder / WORLD)), seed=0) if bound else None
    known = Known(truth, world=world, config=config, T_base_laser=log.T_base_laser)
    return {
        **_scores(result, known),
        **_scan_figures(log, result),
        **_closure_figures(result, truth.planar()),
        "ms_per_scan": 1e3 * wall_s / len(log.scans),
        "cpu_ms_per_scan": 1e3 * cpu_s / len(log.scans),
        "peak_memory_mb": memory_mb,
        "warnings": list(result.warnings),
    }


def _scores(result: SlamResult, known: Known) -> Figures:
    """What ``slamsim evaluate`` tells of a run's trajectory, and of each part of the work."""
    estimated = Estimated(
        trajectory=result.trajectory,
        odometry=result.odometry,
        parts=result.parts,
        keyframes=result.graph.keyframes,
        covariances=result.graph.covariances,
        in_map=result.graph.in_map,
    )
    scores = score(estimated, known, None, Stages(Reporter(quiet=True)))
    assert scores.trajectory is not None
    front_end_m: float | None = None
    if known.truth is not None and result.front_end is not None:
        alone = compare(result.front_end, known.truth.planar())
        front_end_m = statistics(alone.translation_m).rmse
    return {
        **{key: value for key, value in scores.numbers().items() if not key.startswith("map_")},
        "path_length_m": scores.trajectory.truth.path_length_m(),
        "front_end_ate_rmse_m": front_end_m,
        "error_budget": scores.budget_numbers(),
    }


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


_MRAD_PER_DEG = 1e3 * math.pi / 180.0
"""Degrees as they are recorded, milliradians as they are shown."""

_COLUMNS = (
    ("ATE", "ATE, mm", "ate_rmse_m", 1e3, ".2f"),
    ("max", "largest error, mm", "ate_max_m", 1e3, ".1f"),
    ("mrad", "rotation, mrad", "ate_rot_rmse_deg", _MRAD_PER_DEG, ".2f"),
    ("bound", "times the bound", "ate_over_bound", 1.0, ".1f"),
    ("nees", "NEES of a run (3 expected)", "nees_mean", 1.0, ".1f"),
    ("front", "front end alone, mm", "front_end_ate_rmse_m", 1e3, ".2f"),
    ("odo", "wheels alone, m", "odometry_ate_rmse_m", 1.0, ".2f"),
    ("loops", "closures", "closures", 1.0, ".0f"),
    ("false", "false closures", "closures_false", 1.0, ".0f"),
    ("lost", "scans lost", "scans_lost", 1.0, ".0f"),
    ("ms", "ms per scan", "ms_per_scan", 1.0, ".2f"),
    ("MB", "peak memory, MB", "peak_memory_mb", 1.0, ".0f"),
)
"""Heading of the column, name in the summary, key, scale and format."""

_SEED_WIDTH, _LEAST_WIDTH = 4, 6

SEED_HEADER = "seed" + "".join(
    short.rjust(max(len(short) + 2, _LEAST_WIDTH)) for short, *_ in _COLUMNS
)


def seed_line(figures: Mapping[str, object]) -> str:
    """The figures of one seed under ``SEED_HEADER``, or why there are none."""
    seed = str(figures["seed"]).rjust(_SEED_WIDTH)
    if "error" in figures:
        return f"{seed}  failed: {figures['error']}"
    return seed + "".join(
        _shown(figures.get(key), scale, form).rjust(max(len(short) + 2, _LEAST_WIDTH))
        for short, _, key, scale, form in _COLUMNS
    )


def summary_rows(summary: Mapping[str, object]) -> dict[str, str]:
    """Name and value of what the summary holds."""
    rows: dict[str, str] = {}
    for _, name, key, scale, form in _COLUMNS:
        spread = summary.get(key)
        if isinstance(spread, Mapping):
            median, worst = (_shown(spread[what], scale, form) for what in ("median", "worst"))
            rows[name] = f"{median} median, {worst} worst"
    nees = summary.get("nees")
    if isinstance(nees, Mapping):
        low, high = nees["band"]
        rows["NEES over the seeds"] = (
            f"{nees['mean']:.2f}, {nees['verdict']} (95 % band {low:.2f} to {high:.2f})"
        )
    in_map = summary.get("nees_in_map_mean")
    if isinstance(in_map, Mapping):
        rows["NEES within the map"] = f"{in_map['mean']:.2f} (3 expected)"
    believed, false = summary["closures"], summary["closures_false"]
    rows["closures"] = f"{believed} believed, {summary['closures_withdrawn']} withdrawn"
    rows["false closures"] = f"{false} believed, {summary['closures_false_withdrawn']} withdrawn"
    rows["revisits closed"] = f"{summary['revisits_closed']} of {summary['revisits']}"
    rows["scans lost"] = f"{summary['scans_lost']} of {summary['scans']}"
    rows["failed seeds"] = f"{summary['failed']} of {summary['seeds']}"
    return rows


def _shown(value: object, scale: float, form: str) -> str:
    return "-" if value is None else format(scale * cast(float, value), form)
