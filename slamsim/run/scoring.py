"""All scores of a run, for a new run and for one read from disk; the verdict on a map in one
sentence, and its warnings in order of weight."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from scipy.stats import chi2

from slamsim.config.run import RunConfig
from slamsim.core.result import EventKind, PoseGraph, SlamResult
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory, Trajectory
from slamsim.evaluate.bound import TrajectoryBound, trajectory_bound
from slamsim.evaluate.budget import error_budget
from slamsim.evaluate.consistency import nees, nees_in_map
from slamsim.evaluate.score import Scores, evaluate
from slamsim.guard.quantities import as_count, as_lengths, as_number
from slamsim.io.text.relations import Relations
from slamsim.run.stages import Stages
from slamsim.world.model import World

_log = logging.getLogger(__name__)
Score = TypeVar("Score")


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """What SLAM made of a log; None for what was not kept.

    parts: the path after each part of SLAM. covariances: (n, 3, 3) of keyframes, relative to the
    first of them; in_map: relative to the map as a whole.
    """

    trajectory: PlanarTrajectory
    odometry: PlanarTrajectory | None = None
    grid: Grid | None = None
    parts: Mapping[str, PlanarTrajectory] = field(default_factory=dict)
    keyframes: PlanarTrajectory | None = None
    covariances: FloatArray | None = None
    in_map: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What it can be compared with; None for what is unknown.

    world, config: where and how the log was simulated. T_base_laser: 4 x 4. range_m: how far the
    lidar sees.
    """

    truth: Trajectory | None
    relations: Relations | None = None
    world: World | None = None
    config: RunConfig | None = None
    T_base_laser: FloatArray | None = None
    range_m: float = math.inf

    def true_grid(self, resolution_m: float) -> Grid | None:
        """The true occupancy at the height of the lidar."""
        if self.world is None or self.T_base_laser is None:
            return None
        return self.world.grid(resolution_m, float(self.T_base_laser[2, 3]))


def score(estimated: Estimated, known: Known, true_grid: Grid | None, stages: Stages) -> Scores:
    """All scores. Raises what ``evaluate`` raises."""
    with stages.stage("evaluate"):
        scores = evaluate(
            estimated.trajectory,
            estimated.odometry,
            estimated.grid,
            known.truth,
            true_grid,
            known.relations,
            known.range_m,
        )
        scores = _with_parts(scores, estimated, known)
    if known.truth is None or known.world is None:
        return scores
    with stages.stage("bound"):
        return replace(scores, bound=_if_sound("bound", lambda: _bound(estimated, known)))


def _with_parts(scores: Scores, estimated: Estimated, known: Known) -> Scores:
    """With what the key frames tell: how true their covariances are, what each part costs."""
    if known.truth is None or estimated.keyframes is None or estimated.covariances is None:
        return scores
    truth = known.truth.planar()
    parts = dict(estimated.parts)
    if estimated.odometry is not None:
        parts["odometry"] = estimated.odometry
    keyframes, covariances, in_map = estimated.keyframes, estimated.covariances, estimated.in_map
    return replace(
        scores,
        consistency=_if_sound("NEES", lambda: nees(keyframes, covariances, truth)),
        in_map=None
        if in_map is None
        else _if_sound("NEES within the map", lambda: nees_in_map(keyframes, in_map, truth)),
        budget=error_budget(parts, keyframes.stamps_ns, truth),
    )


def _if_sound(what: str, compute: Callable[[], Score | None]) -> Score | None:
    """A score, or None, with a warning, where its matrices have no inverse: a map is worth having
    all the same."""
    try:
        return compute()
    except np.linalg.LinAlgError as error:
        _log.warning("the %s is unknown: %s", what, error)
        return None


def _bound(estimated: Estimated, known: Known) -> TrajectoryBound | None:
    world, config, odometry = known.world, known.config, estimated.odometry
    if world is None or config is None or known.T_base_laser is None:
        return None
    if known.truth is None or odometry is None:
        return None
    return trajectory_bound(
        world.solids.section(float(known.T_base_laser[2, 3])),
        known.truth.planar(),
        odometry,
        known.T_base_laser,
        config.sensors,
        config.robot.drive_wheels.track_m,
    )


_DOUBTFUL: dict[EventKind, str] = {
    "kidnapped": "where the robot may have been carried",
    "torn": "where it may be torn",
    "joined": "where little joins its parts",
    "lost": "where scans fitted nowhere",
}
_STILL_M = 0.1
"""A path that is shorter than a pose counts as a step (``report.numbers``) is none."""
_SIGMAS = float(np.sqrt(chi2.ppf(0.95, 2)))
"""Radius of the circle that holds 95 % of normal positions in the plane."""


def position_95_m(graph: PoseGraph) -> float | None:
    """Within which every key frame's position in the map is, with 95 % each."""
    if len(graph.keyframes) == 0:
        return None
    variances = np.linalg.eigvalsh(graph.position_covariances)[:, -1]
    return float(_SIGMAS * np.sqrt(max(float(variances.max()), 0.0)))


def verdict(result: SlamResult, path_m: float, ate_m: float | None) -> str:
    """How good, how sure, what to look at. path_m: driven. ate_m: RMSE, None without a truth."""
    if path_m < _STILL_M:
        return "The robot did not move: this is what it saw from one place, not a map."
    kinds = [event.kind for event in result.events]
    looks = [f"{kinds.count(k)} {words}" for k, words in _DOUBTFUL.items() if k in kinds]
    within_m = position_95_m(result.graph)
    lengths_m = [length_m for length_m in (ate_m, within_m) if length_m is not None]
    told = as_lengths(*lengths_m)
    parts = [_how_well_it_fits(result) if ate_m is None else f"{told[0]} from the truth (RMSE)"]
    if within_m is not None:
        parts.append(f"every position is sure within {told[-1]} (95 %)")
    parts.append(f"places to look at: {', '.join(looks)}" if looks else _checked(result))
    return f"{'A map with doubts' if looks else 'A whole map'}: {'; '.join(parts)}."


def _how_well_it_fits(result: SlamResult) -> str:
    if not result.match_quality.size:
        return "no scan was matched"
    return (
        f"{as_number(100.0 * float(np.mean(result.match_quality)), 3)} % of what scans see fits it"
    )


def _checked(result: SlamResult) -> str:
    count = result.closures_accepted
    if not count:
        return "no place was seen twice, so no loop checks it"
    agree = f"{as_count(count, 'loop closure')} agree{'s' * (count == 1)}"
    if any(event.kind == "open loop" for event in result.events):
        return f"{agree}, but none checks a part of the path (see the warning)"
    return f"{agree} and nothing needs a look"
