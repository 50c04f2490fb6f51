"""``slamsim localise``: where a recording was driven, in the frame of a map that is finished."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.console import Reporter
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.geometry import compose
from slamsim.logs.reader import read_log, read_truth
from slamsim.logs.tum import read_tum, write_tum
from slamsim.progress import Progress
from slamsim.run import folder as run_folder
from slamsim.run.naming import log_of, recording_name
from slamsim.run.stages import Report, Stages, peak_memory_mb
from slamsim.safe.errors import NotFound
from slamsim.safe.files import own_file
from slamsim.safe.numbers import as_json
from slamsim.safe.output import partial_folder, write_atomic
from slamsim.simulation.own_files import write_config
from slamsim.slam.failures import Failures
from slamsim.slam.known_map import KnownMap, map_of_grid, map_of_keyframes
from slamsim.slam.laser.estimate import laser_of
from slamsim.slam.localise import Localised, Localiser
from slamsim.slam.odometry import FrontEnd
from slamsim.slam.online.samples import WholeMotion
from slamsim.slam.saved_map import read_saved_map
from slamsim.slam.session import odometry_of
from slamsim.types import FloatArray, Log, PlanarTrajectory, Trajectory
from slamsim.world.map_server import read_map

UNPLACED_SHARE_TO_TELL = 0.01


def localise_recording(
    source: Path,
    known: Path,
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    *,
    start: FloatArray | None = None,
    scan_topic: str | None = None,
    overwrite: bool = False,
) -> Report:
    """Localise every scan of a recording in the map of a run, or in a ROS ``map.yaml``.

    start: (3,) T_map_base at the first scan, None if nobody knows. Raises NotFound and
    InputRefused for what cannot be read, SlamsimError if no scan could be placed.
    """
    path = log_of(source)
    log, truth = read_log(path, scan_topic), read_truth(path)
    stages = Stages(reporter)
    surfaces = read_known_map(known)
    with partial_folder(folder, overwrite) as partial:
        write_config(partial, config)
        with stages.stage("localise", "scans/s") as progress:
            localised, step_ms = _localised(log, surfaces, config, start, progress)
        write_tum(partial / run_folder.TRAJECTORY, localised.trajectory)
        write_tum(partial / run_folder.ODOMETRY, localised.odometry)
        if truth is not None:
            run_folder.write_truth(partial, truth)
        numbers = {
            "name": recording_name(str(source)),
            "map": str(known),
            **_numbers(localised, step_ms),
            **_errors(localised.trajectory, truth, known),
            "seconds": stages.so_far(),
            "peak_memory_mb": peak_memory_mb(),
        }
        write_atomic(partial / run_folder.REPORT_JSON, as_json(run_folder.REPORT_JSON, numbers))
    return Report(numbers, (*log.warnings, *_warnings(localised)))


def read_known_map(path: Path) -> KnownMap:
    """The map of a run's folder or of a ROS map_server file. Raises NotFound or InputRefused."""
    if not path.is_dir():
        return map_of_grid(read_map(path))
    saved = own_file(path, run_folder.SAVED_MAP)
    if saved.is_file():
        earlier = read_saved_map(saved)
        return map_of_keyframes(earlier.keyframes, earlier.poses)
    if (path / "map.yaml").is_file():
        return map_of_grid(read_map(own_file(path, "map.yaml")))
    raise NotFound(
        f"{path}: holds neither {run_folder.SAVED_MAP} nor map.yaml; is it a mapped run?"
    )


def _localised(
    log: Log, known: KnownMap, config: RunConfig, start: FloatArray | None, progress: Progress
) -> tuple[Localised, FloatArray]:
    """What came of it, and how long each scan took once the robot was found."""
    log = laser_of(log, config.slam, Failures()).applied(log)
    odometry = odometry_of(log)
    front_end = FrontEnd(config.slam.front_end, odometry, log.T_base_laser)
    localiser = Localiser(config.slam, known, front_end, WholeMotion(odometry), start)
    step_ms = []
    for number, scan in enumerate(log.scans):
        begun_ns = time.perf_counter_ns()
        step = localiser.step(scan)
        if step is not None and step.status == "tracking":
            step_ms.append((time.perf_counter_ns() - begun_ns) * 1e-6)
        progress(number + 1, len(log.scans))
    return localiser.result(), np.array(step_ms)


def _numbers(localised: Localised, step_ms: FloatArray) -> dict[str, object]:
    stamps_ns = localised.trajectory.stamps_ns
    return {
        "scans": localised.scans,
        "scans_placed": len(localised.trajectory),
        "duration_s": float(stamps_ns[-1] - stamps_ns[0]) * 1e-9,
        "path_length_m": localised.trajectory.path_length_m(),
        "step_p50_ms": float(np.percentile(step_ms, 50)) if len(step_ms) else None,
        "step_p99_ms": float(np.percentile(step_ms, 99)) if len(step_ms) else None,
    }


def _errors(
    trajectory: PlanarTrajectory, truth: Trajectory | None, known: Path
) -> dict[str, object]:
    """ATE after an alignment of its own and, where the map's run knew the truth, in its frame."""
    if truth is None:
        return {}
    true = truth.planar()
    own = statistics(compare(trajectory, true).translation_m)
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


def _warnings(localised: Localised) -> tuple[str, ...]:
    missing = localised.scans - len(localised.trajectory)
    if missing <= UNPLACED_SHARE_TO_TELL * localised.scans:
        return ()
    return (f"{missing} of {localised.scans} scans could not be placed in the map",)
