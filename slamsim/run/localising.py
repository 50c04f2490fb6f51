"""``slamsim localise``: localises a recording in a finished map."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import compose
from slamsim.core.progress import Progress
from slamsim.core.types import FloatArray, Grid, Log, PlanarTrajectory, Trajectory
from slamsim.core.weighing import all_weighed, weighed
from slamsim.evaluate.score import Scores
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.guard.errors import NotFound
from slamsim.guard.files import own_file
from slamsim.guard.numbers import as_json
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io.open import open_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.io.text.tum import decimal_from_stamp_ns, read_tum, write_tum
from slamsim.process.children import MEMORY
from slamsim.report.pages.run import write_report
from slamsim.report.run_view import RunView
from slamsim.report.viewer.run import write_recording
from slamsim.run import folder as run_folder
from slamsim.run.continuing import again
from slamsim.run.mapping import typed_command
from slamsim.run.naming import log_of, recording_name
from slamsim.run.stages import Report, Stages
from slamsim.simulation.own_files import write_config
from slamsim.slam.failures import Failures
from slamsim.slam.localise import STATES, UNKNOWN, Localised, NotPlaced, localise_log
from slamsim.slam.mapping.known_map import map_of_grid
from slamsim.slam.mapping.saved_map import SavedMap, read_saved_map
from slamsim.world.map_server import read_map

STATE_HEADER = "time_s,state,sigma_x_m,sigma_y_m,sigma_yaw_rad"


def localise_recording(
    source: Path,
    known: Path,
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    start: FloatArray | None = None,
    wanted: Selection = EVERYTHING,
    overwrite: bool = False,
) -> Report:
    """Localise every scan of a recording in the map of a run, or in a ROS ``map.yaml``.

    start: (3,) T_map_base at the first scan, None if unknown. Raises NotFound and
    InputRefused for what cannot be read, SlamsimError if no scan could be placed.
    """
    path = log_of(source)
    opened = open_recording(path, wanted)
    log, truth = opened.log(), opened.truth()
    reporter.note(log.sources)
    stages, saved, grid = Stages(reporter), read_known_map(known), _known_grid(known)
    with partial_folder(folder, overwrite) as partial:
        write_config(partial, config)
        with stages.stage("localise", "scans/s") as progress:
            timed = _TimedPoses(progress, len(log.scans))
            localised = _localised(log, config, saved, start, timed)
        write_tum(partial / run_folder.TRAJECTORY, localised.trajectory)
        write_tum(partial / run_folder.ODOMETRY, _odometry(localised))
        _write_states(partial / run_folder.STATES, localised)
        if truth is not None:
            run_folder.write_truth(partial, truth)
        failures = Failures(localised.slam.failed)
        verdict, scores = _verdict(localised, known), _scores(localised, truth)
        if grid is not None:
            with failures.caught("report", len(localised.states)), stages.stage("report"):
                _draw(partial, _view(log, localised, grid, truth, scores, verdict, stages))
        numbers = {
            "name": recording_name(str(source)),
            "map": str(known),
            **report_numbers(localised),
            **timed.numbers(),
            **_errors(localised.trajectory, truth, scores, known),
            "seconds": stages.so_far(),
            "peak_memory_mb": MEMORY.peak_mb(),
        }
        write_atomic(partial / run_folder.REPORT_JSON, as_json(run_folder.REPORT_JSON, numbers))
    told = all_weighed(localised.slam, log.warnings)
    failed = tuple(failures)
    mapped = grid is not None and "report" not in {one.stage for one in failed}
    short = weighed(localised.slam, log.warnings)
    return Report(numbers, told, short, verdict=verdict, mapped=mapped, failed=failed)


def read_known_map(path: Path) -> SavedMap:
    """The map of a run's folder or of a ROS map_server file. Raises NotFound or InputRefused."""
    if not path.is_dir():
        return map_of_grid(read_map(path))
    saved = own_file(path, run_folder.SAVED_MAP)
    if saved.is_file():
        return read_saved_map(saved)
    if (path / "map.yaml").is_file():
        return map_of_grid(read_map(own_file(path, "map.yaml")))
    raise NotFound(
        f"{path}: holds neither {run_folder.SAVED_MAP} nor map.yaml; is it a mapped run?"
    )


def _known_grid(path: Path) -> Grid | None:
    """What the drive is drawn in; None where a run's folder holds no ``map.yaml`` any more."""
    file = own_file(path, "map.yaml") if path.is_dir() else path
    return read_map(file) if file.is_file() else None


def _localised(
    log: Log, config: RunConfig, saved: SavedMap, start: FloatArray | None, progress: Progress
) -> Localised:
    """Raises SlamsimError if nothing could be placed, with what a user can do about it."""
    try:
        return localise_log(log, config.slam, saved, start, progress)
    except NotPlaced as error:
        raise NotPlaced(f"{error}{again(log)}") from None


class _TimedPoses:
    """Progress, and how long each of the scans took while it was tracked."""

    def __init__(self, progress: Progress, scans: int) -> None:
        self._progress, self._scans = progress, scans
        self._at_ns: list[int] = []

    def __call__(self, done: float, whole: float) -> None:
        if len(self._at_ns) < self._scans:
            self._at_ns.append(time.perf_counter_ns())
        self._progress(done, whole)

    def numbers(self) -> dict[str, object]:
        step_ms = np.diff(self._at_ns) * 1e-6
        median, most = np.percentile(step_ms, [50, 99]).tolist() if len(step_ms) else (None, None)
        return {"step_p50_ms": median, "step_p99_ms": most}


def _verdict(localised: Localised, known: Path) -> str:
    """In one sentence, how much of the drive was placed."""
    states = Counter(localised.states.tolist())
    share = 1.0 - states[UNKNOWN] / len(localised.states)
    whole = "All scans are" if share == 1.0 else f"{100.0 * share:.0f} % of the scans are"
    return f"{whole} placed in {known}."


def _scores(localised: Localised, truth: Trajectory | None) -> Scores:
    """Of the estimate and of the odometry alone, each aligned with the truth by itself."""
    if truth is None:
        return Scores()
    true = truth.planar()
    return Scores(compare(localised.trajectory, true), compare(_odometry(localised), true))


def _view(
    log: Log,
    localised: Localised,
    grid: Grid,
    truth: Trajectory | None,
    scores: Scores,
    verdict: str,
    stages: Stages,
) -> RunView:
    """The drive in the known map, as a person sees it."""
    result = replace(localised.slam, trajectory=localised.trajectory, odometry=_odometry(localised))
    return RunView(
        log=result.log or log,
        result=result,
        grid=grid,
        scores=scores,
        truth=truth,
        seconds=stages.so_far(),
        peak_memory_mb=MEMORY.peak_mb(),
        command=typed_command(),
        verdict=verdict,
    )


def _draw(partial: Path, view: RunView) -> None:
    write_recording(partial / run_folder.RECORDING, view)
    write_report(partial / run_folder.REPORT, view)


def _odometry(localised: Localised) -> PlanarTrajectory:
    return localised.slam.odometry.select(localised.known)


def _write_states(path: Path, localised: Localised) -> None:
    """One line for each tracked scan: what is known of it, and standard deviations of its base in
    its own frame, inf where nothing is."""
    sigmas = np.sqrt(np.diagonal(localised.covariances, axis1=1, axis2=2))
    rows = zip(localised.stamps_ns.tolist(), localised.states.tolist(), sigmas, strict=True)
    lines = [
        f"{decimal_from_stamp_ns(stamp_ns)},{STATES[state]},{','.join(f'{s:.6g}' for s in sigma)}"
        for stamp_ns, state, sigma in rows
    ]
    write_atomic(path, ("\n".join([STATE_HEADER, *lines]) + "\n").encode())


def report_numbers(localised: Localised) -> dict[str, object]:
    """How many scans are in which state, and when: ``spans`` in seconds from the first scan."""
    trajectory, scans = localised.trajectory, Counter(localised.states.tolist())
    begin_ns = int(localised.stamps_ns[0])
    spans = [
        {
            "state": STATES[state],
            "scans": last - first + 1,
            "from_s": (int(localised.stamps_ns[first]) - begin_ns) * 1e-9,
            "to_s": (int(localised.stamps_ns[last]) - begin_ns) * 1e-9,
        }
        for state, first, last in localised.spans()
    ]
    return {
        "scans": len(localised.states),
        **{f"scans_{name}": scans[number] for number, name in enumerate(STATES)},
        "spans": spans,
        "duration_s": float(trajectory.stamps_ns[-1] - trajectory.stamps_ns[0]) * 1e-9,
        "path_length_m": trajectory.path_length_m(),
    }


def _errors(
    trajectory: PlanarTrajectory, truth: Trajectory | None, scores: Scores, known: Path
) -> dict[str, object]:
    """ATE after an alignment of its own and, where the map's run knew the truth, in its frame."""
    if truth is None or scores.trajectory is None:
        return {}
    true = truth.planar()
    own = statistics(scores.trajectory.translation_m)
    numbers: dict[str, object] = {"ate_rmse_m": own.rmse, "ate_max_m": own.max}
    names = run_folder.TRAJECTORY, run_folder.TRUTH
    mapped, mapped_truth = (own_file(known, name) for name in names)
    if known.is_dir() and mapped.is_file() and mapped_truth.is_file():
        earlier = compare(read_tum(mapped).planar(), read_tum(mapped_truth).planar())
        poses = compose(earlier.T_truth_estimate, trajectory.poses)
        covered = (trajectory.stamps_ns >= true.stamps_ns[0]) & (
            trajectory.stamps_ns <= true.stamps_ns[-1]
        )
        off = poses[covered] - true.at(trajectory.stamps_ns[covered])
        there = statistics(np.hypot(off[:, 0], off[:, 1]))
        numbers |= {"in_map_rmse_m": there.rmse, "in_map_max_m": there.max}
    return numbers
