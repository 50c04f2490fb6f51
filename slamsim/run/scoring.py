"""All scores of a run, for a new run and for one read from disk; the verdict on a map in one
sentence, and its warnings in order of weight."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.core.components import components
from slamsim.core.quantiles import chi_square
from slamsim.core.result import Event, EventKind, PoseGraph, SlamResult
from slamsim.core.types import BoolArray, FloatArray, Grid, PlanarTrajectory, Trajectory
from slamsim.evaluate.bound import TrajectoryBound, trajectory_bound
from slamsim.evaluate.budget import error_budget
from slamsim.evaluate.consistency import nees, nees_in_map
from slamsim.evaluate.score import Scores, evaluate
from slamsim.guard.quantities import as_count, as_lengths, as_number
from slamsim.io.text.relations import Relations
from slamsim.recording.frames import AT_BASE
from slamsim.run.stages import Stages
from slamsim.slam.mapping.joints import closures_agree, is_elsewhere
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
_SIGMAS = float(np.sqrt(chi_square(0.95, 2)))
"""Radius of the circle that holds 95 % of normal positions in the plane."""


def positions_95_m(graph: PoseGraph, told: BoolArray) -> FloatArray:
    """(k,) within which the position of each key frame in the map is, with 95 % each.

    told: (n,) of which key frames. Where nothing joins parts of the map, nothing is known of how
    they lie to each other: those of the first part count, relative to where it began. A single one
    is where the map begins, and tells nothing of the path.
    """
    if len(graph.keyframes) < 2:
        return np.zeros(0)
    ends = [(e.source, e.target) for e in graph.edges if e.weight > 0.0 and not is_elsewhere(e)]
    part = components(np.array(ends, dtype=np.int64).reshape(-1, 2), len(graph.keyframes))
    here = part == part[:1]
    sure = graph.position_covariances if here.all() else graph.covariances[:, :2, :2]
    variances = np.linalg.eigvalsh(sure[told & here])[:, -1]
    return np.asarray(_SIGMAS * np.sqrt(np.maximum(variances, 0.0)))


def verdict(
    result: SlamResult, path_m: float, ate_m: float | None, warnings: Sequence[str] = ()
) -> str:
    """How good, how sure, what to look at. path_m: driven. ate_m: RMSE, None without a truth.
    warnings: about the recording.

    How sure is told of what needs no look, and on a condition: a covariance knows nothing of a
    place that is torn, or of what lies beyond it.
    """
    if path_m < _STILL_M:
        return "The robot did not move: this is what it saw from one place, not a map."
    doubts = [event for event in result.events if _is_doubtful(event, result.graph)]
    plain = _outside(doubts, result.graph)
    within_m = positions_95_m(result.graph, plain)
    sure_m = [float(within_m.max()), float(np.median(within_m))] if within_m.size else []
    told = as_lengths(*([] if ate_m is None else [ate_m]), *sure_m)
    parts = [_how_well_it_fits(result) if ate_m is None else f"{told[0]} from the truth (RMSE)"]
    if doubts:
        parts.append(f"places to look at: {_places(doubts, result.graph)}")
        if sure_m:
            rest = as_number(100.0 * float(np.mean(plain)), 2)
            parts.append(
                f"if it holds together there, the rest of its path ({rest} %) is sure within "
                f"{told[-2]}, half of that within {told[-1]} (95 %)"
            )
        return f"A map with doubts: {'; '.join(parts)}."
    if sure_m:
        parts.append(f"every position is sure within {told[-2]} (95 %)")
    return f"A whole map: {'; '.join([*parts, _checked(result, warnings)])}."


def _is_doubtful(event: Event, graph: PoseGraph) -> bool:
    """Whether the map needs a look where something happened. Scans that fitted nowhere leave it as
    it is if loops that pass over them find the robot where it was said to be."""
    if event.kind == "lost":
        spell_ns = [event.start_ns, event.end_ns]
        first, last = np.searchsorted(graph.keyframes.stamps_ns, spell_ns).tolist()
        return not all(closures_agree(graph, number) for number in range(first, last + 1))
    return event.kind in _DOUBTFUL


def _outside(events: Sequence[Event], graph: PoseGraph) -> BoolArray:
    """(n,) whether each key frame was taken in none of these events."""
    at_ns = graph.keyframes.stamps_ns
    inside = [(one.start_ns <= at_ns) & (at_ns <= one.end_ns) for one in events]
    return np.asarray(~np.any([np.zeros(len(at_ns), dtype=np.bool_), *inside], axis=0))


def _places(doubts: Sequence[Event], graph: PoseGraph) -> str:
    """How many of each kind, and where the longest of the gravest kind is in the map."""
    of_kind = [[one for one in doubts if one.kind == kind] for kind in _DOUBTFUL]
    told = [
        f"{len(alike)} {words}"
        for alike, words in zip(of_kind, _DOUBTFUL.values(), strict=True)
        if alike
    ]
    gravest = next(alike for alike in of_kind if alike)
    longest = max(gravest, key=lambda one: one.end_ns - one.start_ns)
    middle_ns = (longest.start_ns + longest.end_ns) // 2
    at = int(np.argmin(np.abs(graph.keyframes.stamps_ns - middle_ns)))
    x_m, y_m = graph.keyframes.poses[at, :2]
    told[0] += f"{', the longest' if len(gravest) > 1 else ''} near ({x_m:.1f}, {y_m:.1f}) m"
    return ", ".join(told)


def _how_well_it_fits(result: SlamResult) -> str:
    if not result.match_quality.size:
        return "no scan was matched"
    return (
        f"{as_number(100.0 * float(np.mean(result.match_quality)), 3)} % of what scans see fits it"
    )


def _checked(result: SlamResult, warnings: Sequence[str]) -> str:
    count = result.closures_accepted
    if not count:
        return "no place was seen twice, so no loop checks it"
    agree = f"{as_count(count, 'loop closure')} agree{'s' * (count == 1)}"
    if any(event.kind == "open loop" for event in result.events):
        return f"{agree}, but none checks a part of the path (see the warning)"
    if any(words.endswith(AT_BASE) for words in warnings):
        return f"{agree}, but where the laser sits is not known (see the warning)"
    return f"{agree} and nothing needs a look"
