"""What each command does, from its input to a folder that is whole."""

from __future__ import annotations

import json
import math
import resource
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from slamsim import run_folder
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.loading import load_model, load_world_config
from slamsim.config.run import RunConfig
from slamsim.console import Reporter
from slamsim.evaluate.score import evaluate
from slamsim.logs.reader import read_log, read_truth
from slamsim.logs.relations import Relations, read_relations
from slamsim.progress import Progress
from slamsim.safe.errors import SlamsimError
from slamsim.safe.output import partial_folder, write_atomic
from slamsim.sim.robot import build_robot
from slamsim.simulate import Simulation, simulate
from slamsim.slam.mapping import build_grid
from slamsim.slam.motion import predict_motion
from slamsim.slam.session import run_slam
from slamsim.types import Grid, Log, SlamResult, Trajectory
from slamsim.view.numbers import report_json
from slamsim.view.recording import write_recording
from slamsim.view.report import write_report
from slamsim.view.run_view import RunView
from slamsim.world.build import World, build_world
from slamsim.world.export import stl_bytes, world_facts
from slamsim.world.preview import preview_png


@dataclass(frozen=True, slots=True)
class Report:
    """The numbers of a run under stable, unit-bearing keys, and what a person should be told."""

    numbers: dict[str, object]
    warnings: tuple[str, ...] = ()
    mapped: bool = False


@dataclass(frozen=True, slots=True)
class _Stages:
    """Shows each stage to the user and keeps how long it took."""

    reporter: Reporter
    seconds: dict[str, float] = field(default_factory=dict)
    started_s: float = field(default_factory=time.perf_counter)

    @contextmanager
    def stage(self, name: str, unit: str) -> Iterator[Progress]:
        begun_s = time.perf_counter()
        with self.reporter.stage(name, unit) as progress:
            yield progress
        self.seconds[name] = time.perf_counter() - begun_s

    def total(self) -> dict[str, float]:
        return {**self.seconds, "total": time.perf_counter() - self.started_s}


def export_world(config: RunConfig, folder: Path, *, overwrite: bool = False) -> dict[str, object]:
    """``slamsim world``: preview, mesh and true map of a world, and its figures."""
    world = build_world(config.world, config.seed)
    height_m = float(build_robot(config.robot).T_base_laser[2, 3])
    with partial_folder(folder, overwrite) as partial:
        run_folder.write_world(partial, config, world)
        write_atomic(partial / "preview.png", preview_png(world))
        write_atomic(partial / "world.stl", stl_bytes(world.mesh))
        run_folder.write_map(partial, world.grid(config.mapping.resolution_m, height_m))
    return world_facts(world)


def simulate_world(
    config: RunConfig, folder: Path, reporter: Reporter, *, overwrite: bool = False
) -> Report:
    """``slamsim simulate``: a recording, the world it was made in and the truth."""
    stages = _Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        simulation = _simulate(config, partial, stages)
        seconds = stages.total()
    outcome = simulation.outcome
    _require_finished(simulation, folder)
    return Report(
        {
            "name": config.world.name,
            "duration_s": outcome.duration_s,
            "path_length_m": outcome.path_length_m,
            "seconds": seconds,
            "realtime_factor": {"simulate": outcome.duration_s / seconds["simulate"]},
            "peak_memory_mb": _peak_memory_mb(),
        }
    )


def map_world(
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    relations: Path | None = None,
    overwrite: bool = False,
) -> Report:
    """``slamsim map WORLD``: simulate, map, evaluate, show."""
    wanted = None if relations is None else read_relations(relations)
    stages = _Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        simulation = _simulate(config, partial, stages)
        source = partial / run_folder.LOG
        log = replace(read_log(source), name=config.world.name)
        report = _map(log, config, partial, stages, read_truth(source), simulation.world, wanted)
    _require_finished(simulation, folder)
    return report


def map_recording(
    source: Path,
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    relations: Path | None = None,
    scan_topic: str | None = None,
    overwrite: bool = False,
) -> Report:
    """``slamsim map RECORDING``: map, evaluate with whatever truth there is, show."""
    path = run_folder.log_of(source)
    log = replace(read_log(path, scan_topic), name=run_folder.recording_name(str(source)))
    wanted = None if relations is None else read_relations(relations)
    stages = _Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        run_folder.write_config(partial, config)
        world = _world_beside(path)
        return _map(log, config, partial, stages, read_truth(path), world, wanted)


def _simulate(config: RunConfig, partial: Path, stages: _Stages) -> Simulation:
    run_folder.write_config(partial, config)
    with stages.stage("simulate", "x real time") as progress:
        simulation = simulate(config, partial / run_folder.LOG, progress)
    run_folder.write_world(partial, config, simulation.world)
    truth = read_truth(partial / run_folder.LOG)
    if truth is not None:
        run_folder.write_truth(partial, truth)
    return simulation


def _map(
    log: Log,
    config: RunConfig,
    partial: Path,
    stages: _Stages,
    truth: Trajectory | None,
    world: World | None,
    relations: Relations | None,
) -> Report:
    result, grid = _slam(log, config, stages)
    true_grid = _true_grid(world, log, config)
    with stages.stage("evaluate", "") as _:
        scores = evaluate(
            result.trajectory, result.odometry, grid, truth, true_grid, relations, _range_m(log)
        )
    view = RunView(
        log=log,
        result=result,
        grid=grid,
        scores=scores,
        truth=truth,
        walls=None if world is None else world.mesh,
        truth_grid=true_grid,
        seconds=stages.total(),
        peak_memory_mb=_peak_memory_mb(),
        command=shlex.join(["slamsim", *sys.argv[1:]]),
        config_yaml=dump_commented_yaml(config),
    )
    run_folder.write_slam(partial, result, grid)
    if truth is not None:
        run_folder.write_truth(partial, truth)
    with stages.stage("report", "") as _:
        write_recording(partial / run_folder.RECORDING, view)
        numbers = report_json(view)
        write_atomic(partial / run_folder.REPORT_JSON, json.dumps(numbers, indent=2).encode())
        write_report(partial / run_folder.REPORT, view)
    return Report(numbers, (*log.warnings, *result.warnings), mapped=True)


def _slam(log: Log, config: RunConfig, stages: _Stages) -> tuple[SlamResult, Grid]:
    with stages.stage("slam", "scans/s") as progress:
        result = run_slam(log, config.slam, progress)
    with stages.stage("map", "scans/s") as progress:
        motion = predict_motion(log)
        grid = build_grid(
            log.scans, result.trajectory, log.T_base_laser, config.mapping, motion, progress
        )
    return result, grid


def evaluate_run(estimate: Path, truth: Path | None, relations: Path | None) -> dict[str, object]:
    """``slamsim evaluate``: score a run's folder, or a trajectory, anew."""
    wanted = None if relations is None else read_relations(relations)
    run = run_folder.read_run(estimate, truth)
    true_grid = None if run.grid is None else _recorded_true_grid(estimate, run.grid)
    scores = evaluate(run.trajectory, run.odometry, run.grid, run.truth, true_grid, wanted)
    if scores.trajectory is None and scores.relations is None:
        raise SlamsimError(
            f"{estimate}: there is nothing to compare with; name a --truth or --relations file"
        )
    return {**scores.numbers(), "relations": scores.relation_numbers()}


def _true_grid(world: World | None, log: Log, config: RunConfig) -> Grid | None:
    """The true occupancy where the lidar looks."""
    if world is None:
        return None
    return world.grid(config.mapping.resolution_m, float(log.T_base_laser[2, 3]))


def _range_m(log: Log) -> float:
    """How far the lidar sees."""
    return max((scan.geometry.range_max_m for scan in islice(log.scans, 1)), default=math.inf)


def _recorded_true_grid(run: Path, grid: Grid) -> Grid | None:
    """The true occupancy for a finished run's map, if its world is known."""
    file = run / run_folder.WORLD
    if not file.is_file():
        return None
    config = load_model(RunConfig, run / run_folder.CONFIG)
    height_m = float(build_robot(config.robot).T_base_laser[2, 3])
    return build_world(load_world_config(str(file)), seed=0).grid(grid.resolution_m, height_m)


def _world_beside(log_path: Path) -> World | None:
    """The world that a simulated log was made in, if its file lies beside the log."""
    file = log_path.parent / run_folder.WORLD
    if log_path.name != run_folder.LOG or not file.is_file():
        return None
    return build_world(load_world_config(str(file)), seed=0)


def _require_finished(simulation: Simulation, folder: Path) -> None:
    outcome = simulation.outcome
    if not outcome.finished:
        raise SlamsimError(
            f"the drive ended early, after {outcome.duration_s:.1f} s and "
            f"{outcome.path_length_m:.1f} m: {outcome.reason}; what was driven is in {folder}/"
        )


def _peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
