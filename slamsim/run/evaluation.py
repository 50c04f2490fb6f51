"""``slamsim evaluate``: scores a finished run, or a single trajectory, again."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from slamsim.config.loading import load_simulated_config, load_world_config
from slamsim.console.reporter import Reporter
from slamsim.core.types import PlanarTrajectory, Trajectory
from slamsim.guard.errors import NotFound, SlamsimError
from slamsim.guard.files import own_file
from slamsim.io.open import read_truth
from slamsim.io.text.keyframes import read_keyframes
from slamsim.io.text.relations import Relations, read_relations
from slamsim.io.text.tum import read_tum
from slamsim.run.folder import (
    KEYFRAMES,
    ODOMETRY,
    PARTS,
    TRAJECTORY,
    TRUTH,
)
from slamsim.run.naming import log_of
from slamsim.run.scoring import Estimated, Known, score
from slamsim.run.stages import Stages
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.own_files import CONFIG, WORLD
from slamsim.world.build import build_world
from slamsim.world.map_server import read_map


def evaluate_run(
    estimate: Path, truth: Path | None, relations: Path | None, reporter: Reporter
) -> dict[str, object]:
    """All scores under their stable keys.

    estimate: a run's folder, or a TUM file. truth: a TUM file, or a recording that knows it; a
    run's folder knows its own. Raises NotFound, InputRefused, and SlamsimError where there is
    nothing to compare with.
    """
    wanted = None if relations is None else read_relations(relations)
    run = _read_run(estimate)
    own_truth = own_file(estimate, TRUTH)
    true = _truth(truth or (own_truth if own_truth.is_file() else None))
    known = _known(estimate, true, wanted)
    true_grid = None if run.grid is None else known.true_grid(run.grid.resolution_m)
    scores = score(run, known, true_grid, Stages(reporter))
    if scores.trajectory is None and scores.relations is None:
        raise SlamsimError(f"{estimate}: no ground truth; give --truth or --relations")
    return {
        **scores.numbers(),
        "error_budget": scores.budget_numbers(),
        "relations": scores.relation_numbers(),
    }


def _known(run: Path, truth: Trajectory | None, relations: Relations | None) -> Known:
    """With the world and how it was sensed, for the folder of a run that knows them."""
    file = own_file(run, WORLD)
    if not file.is_file():
        return Known(truth, relations)
    config = load_simulated_config(own_file(run, CONFIG))
    world = build_world(load_world_config(str(file)), seed=0)
    T_base_laser = build_robot(config.robot).T_base_laser
    range_m = config.sensors.lidar.range_max_m
    return Known(truth, relations, world, config, T_base_laser, range_m)


def _read_run(estimate: Path) -> Estimated:
    """A run's folder, or a lone TUM trajectory.

    Raises NotFound for what is not there, InputRefused for what cannot be read.
    """
    if not estimate.exists():
        raise NotFound(f"{estimate}: no such run or trajectory")
    if not estimate.is_dir():
        return Estimated(read_tum(estimate).planar())
    own = partial(own_file, estimate)
    if not own(TRAJECTORY).is_file():
        raise NotFound(f"{estimate}: holds no {TRAJECTORY}; is it the folder of a mapped run?")
    keyframes = covariances = in_map = None
    if own(KEYFRAMES).is_file():
        keyframes, covariances, in_map = read_keyframes(own(KEYFRAMES))
    return Estimated(
        trajectory=read_tum(own(TRAJECTORY)).planar(),
        odometry=_planar(own(ODOMETRY)),
        grid=read_map(own("map.yaml")) if own("map.yaml").is_file() else None,
        parts={
            file.stem: read_tum(own(f"{PARTS}/{file.name}")).planar()
            for file in sorted(own(PARTS).glob("*.tum"))
        },
        keyframes=keyframes,
        covariances=covariances,
        in_map=in_map,
    )


def _planar(path: Path) -> PlanarTrajectory | None:
    return read_tum(path).planar() if path.is_file() else None


def _truth(path: Path | None) -> Trajectory | None:
    if path is None:
        return None
    if path.suffix == ".tum" or (path.is_file() and path.suffix == ".txt"):
        return read_tum(path)
    truth = read_truth(log_of(path))
    if truth is None:
        raise NotFound(f"{path}: this recording has no ground truth")
    return truth
