"""``slamsim map``: from a world or a recording to a map, and how good it is."""

from __future__ import annotations

import json
import math
import shlex
import sys
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from slamsim.config.dump import dump_commented_yaml
from slamsim.config.loading import load_world_config
from slamsim.config.run import RunConfig
from slamsim.console import Reporter
from slamsim.evaluate.score import evaluate
from slamsim.logs.reader import read_log, read_truth
from slamsim.logs.relations import Relations, read_relations
from slamsim.run import folder as run_folder
from slamsim.run.recording import record, require_finished
from slamsim.run.stages import Report, Stages, peak_memory_mb
from slamsim.safe.output import partial_folder, write_atomic
from slamsim.slam.mapping import build_grid
from slamsim.slam.session import motion_of, run_slam
from slamsim.types import Grid, Log, SlamResult, Trajectory
from slamsim.view.numbers import report_json
from slamsim.view.recording import write_recording
from slamsim.view.report import write_report
from slamsim.view.run_view import RunView
from slamsim.world.build import World, build_world


@dataclass(frozen=True, slots=True)
class _Known:
    """What a result can be compared with; None for what nobody knows."""

    truth: Trajectory | None
    world: World | None
    relations: Relations | None


def map_world(
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    relations: Path | None = None,
    overwrite: bool = False,
) -> Report:
    """Simulate, map, evaluate, show.

    Raises SlamsimError after a drive that ended early; what was driven is mapped all the same.
    """
    wanted = None if relations is None else read_relations(relations)
    stages = Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        simulation = record(config, partial, stages)
        source = partial / run_folder.LOG
        log = replace(read_log(source), name=config.world.name)
        known = _Known(read_truth(source), simulation.world, wanted)
        report = _map(log, config, partial, stages, known)
    require_finished(simulation, folder)
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
    """Map, evaluate with whatever truth there is, show."""
    path = run_folder.log_of(source)
    log = replace(read_log(path, scan_topic), name=run_folder.recording_name(str(source)))
    wanted = None if relations is None else read_relations(relations)
    known = _Known(read_truth(path), _world_beside(path), wanted)
    stages = Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        run_folder.write_config(partial, config)
        if known.truth is not None:
            run_folder.write_truth(partial, known.truth)
        return _map(log, config, partial, stages, known)


def _map(log: Log, config: RunConfig, partial: Path, stages: Stages, known: _Known) -> Report:
    result, grid = _slam(log, config, stages)
    view = _scored(log, result, grid, config, stages, known)
    run_folder.write_slam(partial, result, grid)
    with stages.stage("report"):
        numbers = report_json(view)
        write_recording(partial / run_folder.RECORDING, view)
        write_report(partial / run_folder.REPORT, view)
        write_atomic(partial / run_folder.REPORT_JSON, json.dumps(numbers, indent=2).encode())
    return Report(numbers, (*log.warnings, *result.warnings), mapped=True)


def _slam(log: Log, config: RunConfig, stages: Stages) -> tuple[SlamResult, Grid]:
    with stages.stage("slam", "scans/s") as progress:
        result = run_slam(log, config.slam, progress)
    with stages.stage("map", "scans/s") as progress:
        motion = motion_of(log)
        grid = build_grid(
            log.scans, result.trajectory, log.T_base_laser, config.mapping, motion, progress
        )
    return result, grid


def _scored(
    log: Log, result: SlamResult, grid: Grid, config: RunConfig, stages: Stages, known: _Known
) -> RunView:
    world, height_m = known.world, float(log.T_base_laser[2, 3])
    true_grid = None if world is None else world.grid(config.mapping.resolution_m, height_m)
    with stages.stage("evaluate"):
        scores = evaluate(
            result.trajectory,
            result.odometry,
            grid,
            known.truth,
            true_grid,
            known.relations,
            _range_m(log),
        )
    return RunView(
        log=log,
        result=result,
        grid=grid,
        scores=scores,
        truth=known.truth,
        walls=None if world is None else world.mesh,
        truth_grid=true_grid,
        seconds=stages.so_far(),
        peak_memory_mb=peak_memory_mb(),
        command=shlex.join(["slamsim", *sys.argv[1:]]),
        config_yaml=dump_commented_yaml(config),
    )


def _range_m(log: Log) -> float:
    """How far the lidar sees."""
    return max((scan.geometry.range_max_m for scan in islice(log.scans, 1)), default=math.inf)


def _world_beside(log_path: Path) -> World | None:
    """The world that a simulated log was made in, if its file lies beside the log."""
    file = log_path.parent / run_folder.WORLD
    if log_path.name != run_folder.LOG or not file.is_file():
        return None
    return build_world(load_world_config(str(file)), seed=0)
