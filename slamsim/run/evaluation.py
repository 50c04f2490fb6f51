"""``slamsim evaluate``: score a finished run, or a lone trajectory, anew."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from slamsim.config.loading import load_model, load_world_config
from slamsim.config.run import RunConfig
from slamsim.evaluate.score import evaluate
from slamsim.logs.reader import read_truth
from slamsim.logs.relations import read_relations
from slamsim.logs.tum import read_tum
from slamsim.run.folder import CONFIG, ODOMETRY, TRAJECTORY, TRUTH, WORLD, log_of
from slamsim.safe.errors import NotFound, SlamsimError
from slamsim.sim.robot import build_robot
from slamsim.types import Grid, PlanarTrajectory, Trajectory
from slamsim.world.build import build_world
from slamsim.world.map_server import read_map


def evaluate_run(estimate: Path, truth: Path | None, relations: Path | None) -> dict[str, object]:
    """All scores under their stable keys.

    estimate: a run's folder, or a TUM file. truth: a TUM file, or a recording that knows it; a
    run's folder knows its own. Raises NotFound, InputRefused, and SlamsimError where there is
    nothing to compare with.
    """
    wanted = None if relations is None else read_relations(relations)
    run = _read_run(estimate, truth)
    true_grid, range_m = _true_grid(estimate, run.grid)
    scores = evaluate(run.trajectory, run.odometry, run.grid, run.truth, true_grid, wanted, range_m)
    if scores.trajectory is None and scores.relations is None:
        raise SlamsimError(
            f"{estimate}: there is nothing to compare with; name a --truth or --relations file"
        )
    return {**scores.numbers(), "relations": scores.relation_numbers()}


def _true_grid(run: Path, grid: Grid | None) -> tuple[Grid | None, float]:
    """The true occupancy for a run's map, if its world is known, and how far its lidar saw."""
    file = run / WORLD
    if grid is None or not file.is_file():
        return None, float("inf")
    config = load_model(RunConfig, run / CONFIG)
    height_m = float(build_robot(config.robot).T_base_laser[2, 3])
    world = build_world(load_world_config(str(file)), seed=0)
    return world.grid(grid.resolution_m, height_m), config.sensors.lidar.range_max_m


@dataclass(frozen=True, slots=True, eq=False)
class _FinishedRun:
    """What can be scored of a run that lies on the disk; None for what is not there."""

    trajectory: PlanarTrajectory
    odometry: PlanarTrajectory | None
    grid: Grid | None
    truth: Trajectory | None


def _read_run(estimate: Path, truth: Path | None) -> _FinishedRun:
    """A run's folder, or a lone TUM trajectory; truth: a TUM file or a recording that knows it.

    Raises NotFound for what is not there, InputRefused for what cannot be read.
    """
    if not estimate.exists():
        raise NotFound(f"{estimate}: there is no such run or trajectory")
    if not estimate.is_dir():
        return _FinishedRun(read_tum(estimate).planar(), None, None, _truth(truth))
    if not (estimate / TRAJECTORY).is_file():
        raise NotFound(f"{estimate}: holds no {TRAJECTORY}; is it the folder of a mapped run?")
    own_truth = estimate / TRUTH
    odometry = estimate / ODOMETRY
    return _FinishedRun(
        trajectory=read_tum(estimate / TRAJECTORY).planar(),
        odometry=read_tum(odometry).planar() if odometry.is_file() else None,
        grid=read_map(estimate / "map.yaml") if (estimate / "map.yaml").is_file() else None,
        truth=_truth(truth or (own_truth if own_truth.is_file() else None)),
    )


def _truth(path: Path | None) -> Trajectory | None:
    if path is None:
        return None
    if path.suffix == ".tum" or (path.is_file() and path.suffix == ".txt"):
        return read_tum(path)
    truth = read_truth(log_of(path))
    if truth is None:
        raise NotFound(f"{path}: this recording holds no truth")
    return truth
