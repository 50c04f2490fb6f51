"""``slamsim map``: maps a world or a recording and evaluates the map."""

from __future__ import annotations

import math
import shlex
import sys
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path

from slamsim.check.findings import CheckReport
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.loading import load_simulated_config, load_world_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.result import SlamResult
from slamsim.core.types import Grid, Log, Trajectory
from slamsim.core.weighing import all_weighed, weighed
from slamsim.guard.errors import SlamsimError
from slamsim.guard.files import own_file
from slamsim.guard.numbers import as_json
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io import LOG
from slamsim.io.open import open_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.io.text.relations import Relations, read_relations
from slamsim.process.children import MEMORY, return_freed_memory
from slamsim.recording import Recording
from slamsim.report.run_view import RunView, path_length_m, report_json
from slamsim.run import folder as run_folder
from slamsim.run.cameras import layers as run_layers
from slamsim.run.cameras.asked import (
    FromImages,
    from_images,
    refuse_unseen,
    refuse_wrong_files,
    require_returns,
)
from slamsim.run.cameras.without_lidar import WithoutLidar
from slamsim.run.checking import check_stage
from slamsim.run.continuing import Earlier, clouds_before
from slamsim.run.naming import log_of, recording_name
from slamsim.run.recording import record, require_finished
from slamsim.run.scoring import Estimated, Known, score, verdict
from slamsim.run.stages import Report, Stages
from slamsim.simulation.own_files import CONFIG, WORLD, write_config, write_world
from slamsim.slam.failures import Failures
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.mapping.saved_map import SavedMap, write_saved_map
from slamsim.slam.session import map_log, motion_of
from slamsim.world.build import build_world
from slamsim.world.model import World

LEAST_USED = 0.5
"""Share of a recording's scans below which a run has failed, though it is written."""


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
    calibrated = refuse_unseen(config)
    stages = Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        simulation = record(config, partial, stages)
        source = partial / LOG
        opened = open_recording(source)
        checked = _checked(opened.recording, stages)
        log = replace(opened.log(), name=config.world.name)
        known = _known(log, opened.truth(), wanted, (simulation.world, config))
        images = from_images(source, opened.recording, log, config, stages, calibrated)
        del opened
        return_freed_memory()
        report = _map(log, config, partial, stages, known, checked, images)
    require_finished(simulation, folder)
    return report


def map_recording(
    source: Path,
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    relations: Path | None = None,
    wanted: Selection = EVERYTHING,
    earlier: Earlier | None = None,
    without: WithoutLidar | None = None,
    overwrite: bool = False,
) -> Report:
    """Map, evaluate with whatever truth there is, show; earlier: a map to go on with. without: the
    recording to read in the place of the one at source, which has no scans of a lidar."""
    calibrated = refuse_wrong_files(config, None if earlier is None else earlier.saved.landmarks)
    path = log_of(source)
    opened = open_recording(path, wanted) if without is None else without.opened
    log = replace(opened.log(), name=recording_name(str(source)))
    require_returns(log)
    reporter.note(log.sources)
    wanted_relations = None if relations is None else read_relations(relations)
    origin = _origin_beside(path)
    known = _known(log, opened.truth(), wanted_relations, origin)
    stages, recording = Stages(reporter), opened.recording
    del opened  # with the truth as it was recorded
    return_freed_memory()
    checked = _checked(recording, stages)
    images = from_images(path, recording, log, config, stages, calibrated)
    del recording
    return_freed_memory()
    with partial_folder(folder, overwrite) as partial:
        if origin is not None:
            world, simulated = origin
            config = simulated.model_copy(update={"slam": config.slam, "mapping": config.mapping})
            write_world(partial, config, world)
        write_config(partial, config)
        if known.truth is not None:
            run_folder.write_truth(partial, known.truth)
        return _map(log, config, partial, stages, known, checked, images, earlier, without)


def require_used(report: Report, folder: Path) -> None:
    """Raises SlamsimError if less than half of the scans were used: a map of a part."""
    used, scans = report.numbers.get("scans_used"), report.numbers.get("scans")
    if not (isinstance(used, int) and isinstance(scans, int) and used < LEAST_USED * scans):
        return
    why = [words for words in report.warnings if "left out" in words or "skipped" in words]
    raise SlamsimError(
        f"only {used} of {scans} scans were used: {'; '.join(why) or 'the motion covers no more'}; "
        f"the map of these is in {folder}/"
    )


def _checked(recording: Recording, stages: Stages) -> CheckReport:
    """A quick look at the recording itself, before anything is made of it."""
    return check_stage(recording, stages, quick=True)


def _map(
    log: Log,
    config: RunConfig,
    partial: Path,
    stages: Stages,
    known: Known,
    checked: CheckReport,
    images: FromImages,
    earlier: Earlier | None = None,
    without: WithoutLidar | None = None,
) -> Report:
    """What SLAM made of it is written before anything is drawn of it, so that it stays whatever
    fails then."""
    result, saved = _slam(log, config, stages, earlier, images)
    return_freed_memory()
    log = result.log or log
    log = replace(log, warnings=(*log.warnings, *images.layers.told))
    unjoined = "" if earlier is None else earlier.unjoined(saved, result, log)
    run_folder.write_slam(partial, result, sure=not unjoined)
    write_saved_map(partial / run_folder.SAVED_MAP, saved)
    failures = Failures(result.failed)
    numbers: dict[str, object] = {"name": log.name}
    doubts: tuple[str, ...] = ()
    last = len(result.graph.keyframes) - 1
    with failures.caught("map", last):
        grid = _grid(log, result, saved, config, stages)
        del saved  # its key frames take 0.1 GB of a drive of two hours
        return_freed_memory()
        run_folder.write_map(partial, grid)
        sources = images.layers
        layers = run_layers.map_layers(sources, log, result, grid, config.mapping, stages, failures)
        run_layers.write_layers(partial, layers, known.world)
        with failures.caught("report", last):
            view = _scored(log, result, grid, config, stages, known, sure=not unjoined)
            view = run_layers.with_layers(view, layers, known.world, config.mapping.layers)
            view = replace(view, checked=checked, verdict=_verdict(view, unjoined))
            doubts = view.doubts
            with stages.stage("report"):
                numbers = report_json(view)
                if without is not None:
                    numbers |= without.numbers(result.trajectory, known.truth)
                    view = replace(view, verdict=without.verdict(view.verdict, numbers))
                    numbers["verdict"] = view.verdict
                _write_pages(partial, view)
    failed = tuple(failures)
    complete = not {"map", "report"} & {one.stage for one in failed}
    if config.slam.back_end.closures.images:
        numbers["places_seen_again"] = len(images.again)
    numbers["failed_stages"] = [asdict(one) for one in failed]
    write_atomic(partial / run_folder.REPORT_JSON, as_json(run_folder.REPORT_JSON, numbers))
    of_recording = (*doubts, *log.warnings)
    return Report(
        numbers,
        warnings=all_weighed(result, of_recording),
        weighed=weighed(result, of_recording),
        verdict=str(numbers.get("verdict", "")),
        mapped=complete,
        failed=failed,
        unjoined=unjoined,
    )


def _write_pages(partial: Path, view: RunView) -> None:
    """Imported only now: Rerun and Matplotlib hold 110 MB, which SLAM of a long log needs."""
    from slamsim.report.pages.run import write_report
    from slamsim.report.viewer.run import write_recording

    write_recording(partial / run_folder.RECORDING, view)
    write_report(partial / run_folder.REPORT, view)


def _verdict(view: RunView, unjoined: str) -> str:
    """In one sentence, what became of a map; unjoined: why it does not continue an earlier one."""
    if unjoined:
        return f"{unjoined[:1].upper()}{unjoined[1:]}."
    ate_m = view.scores.numbers()["ate_rmse_m"]
    return verdict(view.result, path_length_m(view.result.trajectory), ate_m, view.warnings)


def _slam(
    log: Log, config: RunConfig, stages: Stages, earlier: Earlier | None, images: FromImages
) -> tuple[SlamResult, SavedMap]:
    saved_map, start = (None, None) if earlier is None else (earlier.saved, earlier.start)
    with stages.stage("slam", "scans/s") as progress:
        return map_log(
            log, config.slam, progress, saved_map, start, tags=images.tags, again=images.again
        )


def _grid(log: Log, result: SlamResult, saved: SavedMap, config: RunConfig, stages: Stages) -> Grid:
    with stages.stage("map", "scans/s") as progress:
        motion = motion_of(log, result.calibration)
        return build_grid(
            log.scans,
            result.trajectory,
            log.T_base_laser,
            config.mapping,
            motion,
            progress,
            clouds_before(saved, result),
        )


def _scored(
    log: Log,
    result: SlamResult,
    grid: Grid,
    config: RunConfig,
    stages: Stages,
    known: Known,
    *,
    sure: bool = True,
) -> RunView:
    """sure: whether its covariances say anything of where it lies."""
    true_grid = known.true_grid(config.mapping.resolution_m)
    estimated = Estimated(
        result.trajectory,
        result.odometry,
        grid,
        result.parts,
        result.graph.keyframes,
        result.graph.covariances if sure else None,
        result.graph.in_map if sure else None,
    )
    scores = score(estimated, known, true_grid, stages)
    world = known.world
    return RunView(
        log=log,
        result=result,
        grid=grid,
        scores=scores,
        truth=known.truth,
        walls=None if world is None else world.mesh,
        truth_grid=true_grid,
        seconds=stages.so_far(),
        peak_memory_mb=MEMORY.peak_mb(),
        command=typed_command(),
        config_yaml=dump_commented_yaml(config),
        sure=sure,
    )


def typed_command() -> str:
    """The command as it was typed; none in a Python program, whose arguments are its own."""
    ours = Path(sys.argv[0]).name in ("slamsim", "__main__.py") and "slamsim.entry" in sys.modules
    return shlex.join(["slamsim", *sys.argv[1:]]) if ours else ""


def _known(
    log: Log,
    truth: Trajectory | None,
    relations: Relations | None,
    origin: tuple[World, RunConfig] | None,
) -> Known:
    world, config = (None, None) if origin is None else origin
    range_m = max((scan.geometry.range_max_m for scan in islice(log.scans, 1)), default=math.inf)
    return Known(truth, relations, world, config, log.T_base_laser, range_m)


def _origin_beside(log_path: Path) -> tuple[World, RunConfig] | None:
    """Where and how a simulated log was made, if its folder still tells."""
    world, config = log_path.parent / WORLD, log_path.parent / CONFIG
    if log_path.name != LOG or not (world.is_file() and config.is_file()):
        return None
    world, config = own_file(world.parent, world.name), own_file(config.parent, config.name)
    return build_world(load_world_config(str(world)), seed=0), load_simulated_config(config)
