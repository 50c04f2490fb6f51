"""Recordings of one drive, the correct one and the faulty ones of the study: each checked, mapped,
scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.motion.disagreement import covered
from slamsim.config.run import RunConfig
from slamsim.config.scenarios.slam_case import SlamCaseConfig
from slamsim.core.geometry import compose, inverse, xyzw_from_yaw
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray, Grid, IntArray, Trajectory
from slamsim.evaluate.score import evaluate
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_log
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.edits.base import is_odometry_edge
from slamsim.scenarios.base import BodyMotion, Outcome, Row, Solid
from slamsim.sensors.faults.registry import load_fault
from slamsim.simulation.driven import Driven
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.session import run_slam

_SHOWN_EVERY = 2
_WALL_M = 0.03
"""Thickness of a wall that is drawn of a line."""
_SCORES = (
    "ate_rmse_m",
    "ate_max_m",
    "odometry_ate_rmse_m",
    "map_wall_recall",
    "map_wall_precision",
    "map_doubled_wall_share",
)
_DELAY = "time.offset.lidar"


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """What SLAM makes of a recording; laid: its scans along the odometry as it is."""

    result: SlamResult
    grid: Grid
    laid: Grid
    scores: Row


def slam_trial(config: SlamCaseConfig, seed: int, number: int) -> Outcome:
    """The variant of that number: recorded, checked, mapped if that can be, scored."""
    variant = VARIANTS[number]
    driven = _drive(_run_config(config, seed).model_dump_json())
    recording = variant.record(driven, config)
    report = check_recording(recording)
    refused, mapped = "", None
    try:
        mapped = _map(recording, driven, config)
    except SlamsimError as error:
        refused = str(error).partition(": ")[2]
    scores: Row = dict.fromkeys(_SCORES) if mapped is None else mapped.scores
    values = {
        "variant": variant.name,
        "scans": len(recording.scans[0]),
        "scans_with_transform_share": _usable_share(recording),
        **scores,
        **_delay(report),
        "faults": ", ".join(dict.fromkeys(str(finding.fault) for finding in report.faults)),
        "slam_refused": refused,
    }
    if mapped is None:
        return Outcome(values)
    motions = _motions(driven, mapped.result) if variant.name in (RIGHT, BUG) else ()
    return Outcome(values, motions, _arrays(mapped))


def as_grid(arrays: Mapping[str, NDArray[Any]], name: str) -> Grid:
    """What ``_arrays`` has taken apart. occupancy is (rows, columns)."""
    x_m, y_m, resolution_m = arrays[f"{name}_place"].tolist()
    return Grid(arrays[name], resolution_m, (x_m, y_m))


def _run_config(config: SlamCaseConfig, seed: int) -> RunConfig:
    shared = {name: getattr(config, name) for name in ("world", "robot", "drive", "sensors")}
    return RunConfig(seed=seed, slam=config.slam, mapping=config.mapping, **shared)


@lru_cache(maxsize=1)
def _drive(run_config: str) -> Driven:
    """Driven once in each worker; the configuration as JSON, which can be compared."""
    return Driven(RunConfig.model_validate_json(run_config, strict=False))


def _usable_share(recording: Recording) -> float:
    """Of the scans, those whose instant odom -> base covers: what a SLAM can use that asks the
    transform tree where the robot was, as gmapping does; the others it drops as too old."""
    stamps_ns: IntArray = recording.scans[0].stamps_ns
    edges = [edge for edge in recording.transforms if is_odometry_edge(edge)]
    shares = [float(covered(stamps_ns, np.sort(edge.stamps_ns)).mean()) for edge in edges]
    return min(shares, default=0.0)


def _delay(report: CheckReport) -> Row:
    """What the checker has measured of the lidar's delay, if it is sure of one."""
    found: Finding | None = next((f for f in report.faults if f.check == _DELAY), None)
    if found is None or found.estimate is None:
        return {"delay_s": None, "delay_least_s": None, "delay_most_s": None}
    scale = 1e-3 if found.estimate.unit == "ms" else 1.0
    least, most = found.estimate.interval
    return {
        "delay_s": scale * found.estimate.value,
        "delay_least_s": scale * least,
        "delay_most_s": scale * most,
    }


def _map(recording: Recording, driven: Driven, config: SlamCaseConfig) -> _Mapped:
    """Written and read as any other recording; raises SlamsimError where SLAM refuses it."""
    truth = driven.truth()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        write_recording(recording, path)
        log = read_log(path)
        result = run_slam(log, config.slam)
        log = result.log or log  # with the scans that the poses belong to
        grid, laid = (
            build_grid(log.scans, way, log.T_base_laser, config.mapping)
            for way in (result.trajectory, result.odometry)
        )
    true_grid = driven.simulation.world.grid(
        config.mapping.resolution_m, float(log.T_base_laser[2, 3])
    )
    scores = evaluate(
        result.trajectory,
        result.odometry,
        grid,
        truth,
        true_grid,
        range_m=config.sensors.lidar.range_max_m,
    ).numbers()
    return _Mapped(result, grid, laid, {name: scores[name] for name in _SCORES})


def _arrays(mapped: _Mapped) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    for name, grid, way in (
        ("map", mapped.grid, mapped.result.trajectory),
        ("laid", mapped.laid, mapped.result.odometry),
    ):
        found[name] = grid.occupancy
        found[f"{name}_place"] = np.array([*grid.origin_m, grid.resolution_m])
        found[f"{name}_path"] = way.poses[:, :2]
    return found


def _motions(driven: Driven, result: SlamResult) -> tuple[BodyMotion, ...]:
    """The robot where SLAM believes it, begun where it truly began, among the true walls."""
    robot, world = driven.simulation.robot, driven.simulation.world
    stamps_ns, poses = result.trajectory.stamps_ns, result.trajectory.poses
    begin = driven.truth().planar().at(stamps_ns[:1])[0]
    believed = compose(begin, compose(inverse(poses[0]), poses))[::_SHOWN_EVERY]
    walls = world.solids.section(robot.height_m)
    return (
        BodyMotion(
            "robot",
            Solid("robot", (robot.footprint_radius_m, robot.height_m)),
            _in_space(stamps_ns[::_SHOWN_EVERY], believed, 0.0),
        ),
        *(_wall(f"wall {k}", ends, robot.height_m) for k, ends in enumerate(walls)),
    )


def _wall(name: str, ends: FloatArray, height_m: float) -> BodyMotion:
    """A piece of an outline, (2, 2), as a thin board."""
    along = ends[1] - ends[0]
    size_m = (float(np.hypot(*along)), _WALL_M, height_m)
    pose = np.array([[*ends.mean(axis=0), np.arctan2(along[1], along[0])]])
    at_start: IntArray = np.zeros(1, dtype=np.int64)
    return BodyMotion(name, Solid("box", size_m), _in_space(at_start, pose, 0.5 * height_m))


def _in_space(stamps_ns: IntArray, poses: FloatArray, height_m: float) -> Trajectory:
    """Planar poses (n, 3) at a height."""
    places = np.column_stack([poses[:, :2], np.full(len(poses), height_m)])
    return Trajectory(stamps_ns, places, xyzw_from_yaw(poses[:, 2]))


RIGHT, BUG, CLOCKS, BYPASS, NO_ODOM, SIMULATOR = (
    "right",
    "rotation bug",
    "two clocks",
    "clock bypassed",
    "no odom frame",
    "tree from the simulator",
)


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to record the drive. expects: what the checker must call it, empty for nothing."""

    name: str
    words: str
    expects: str
    record: Callable[[Driven, SlamCaseConfig], Recording]


def _right(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording()


def _rotation_bug(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("laser_world_fixed")])


def _two_clocks(driven: Driven, config: SlamCaseConfig) -> Recording:
    """The simulator's scans count from its start, the transforms of the SLAM side from 1970."""
    return driven.recording([load_fault("epoch_mismatch").model_copy(update={"stream": "wheels"})])


def _bypassed(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("lidar_late").with_size(config.delay_s)])


def _no_odom(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("tf_missing_odometry")])


def _from_simulator(driven: Driven, config: SlamCaseConfig) -> Recording:
    """The simulator places the robot itself, as transform and as odometry: where it truly is."""
    recording, truth = driven.recording(), driven.truth()

    def true_poses(stamps_ns: IntArray) -> dict[str, Any]:
        way = truth.at(np.clip(stamps_ns, truth.stamps_ns[0], truth.stamps_ns[-1]))
        return {"positions_m": way.positions_m, "quats_xyzw": way.quats_xyzw}

    return replace(
        recording.changed(RawOdometry, lambda o: replace(o, **true_poses(o.stamps_ns))),
        transforms=tuple(
            replace(edge, **true_poses(edge.stamps_ns)) if is_odometry_edge(edge) else edge
            for edge in recording.transforms
        ),
    )


VARIANTS = (
    Variant(RIGHT, "one clock, odom from the wheels, rays relative to the laser", "", _right),
    Variant(BUG, "rays keep their directions in the world", "laser_world_fixed", _rotation_bug),
    Variant(
        CLOCKS,
        "scans count from the simulator's start, transforms from 1970",
        "epoch_mismatch",
        _two_clocks,
    ),
    Variant(BYPASS, "scans stamped on arrival, late", "time_offset_lidar", _bypassed),
    Variant(NO_ODOM, "no transform from odom to base", "tf_missing_link", _no_odom),
    Variant(SIMULATOR, "odom to base is the simulator's true pose", "", _from_simulator),
)
