"""All scores of a run, under stable names that carry their units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from slamsim.core.types import Grid, PlanarTrajectory, Trajectory
from slamsim.evaluate.bound import TrajectoryBound
from slamsim.evaluate.budget import PartErrors
from slamsim.evaluate.consistency import DEGREES_OF_FREEDOM, Consistency
from slamsim.evaluate.grid import MapScores, compare_grids
from slamsim.evaluate.relations import RelationScores, score_relations
from slamsim.evaluate.trajectory import TrajectoryErrors, compare, relative_errors, statistics
from slamsim.evaluate.visibility import require_range
from slamsim.io.text.relations import Relations

Number = float | int | None

_TRAJECTORY_KEYS = (
    "ate_rmse_m",
    "ate_mean_m",
    "ate_median_m",
    "ate_max_m",
    "ate_rot_rmse_deg",
    "ate_rot_max_deg",
    "rpe_trans_percent",
    "rpe_rot_deg_per_m",
)
_BOUND_KEYS = (
    "bound_ate_m",
    "ate_over_bound",
    "bound_localisation_m",
    "bound_localisation_mrad",
    "bound_scan_m",
    "bound_scan_mrad",
    "bound_lost_share",
    "bound_mixed_share",
)


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """What is known of how good a run is; None where there is nothing to compare with.

    trajectory, odometry: the estimate and the prediction alone, each aligned with the truth by
    itself. map: against the true walls. relations: against hand-verified relative poses.
    odometry_relations: the same for the prediction alone. consistency: of the key frames' errors
    with their covariances, in_map: relative to the map as a whole. budget: errors after each part
    of SLAM. bound: what is possible.
    """

    trajectory: TrajectoryErrors | None = None
    odometry: TrajectoryErrors | None = None
    map: MapScores | None = None
    relations: RelationScores | None = None
    odometry_relations: RelationScores | None = None
    consistency: Consistency | None = None
    in_map: Consistency | None = None
    budget: Mapping[str, PartErrors] = field(default_factory=dict)
    bound: TrajectoryBound | None = None

    def numbers(self) -> dict[str, Number]:
        """Every score of trajectory and map under its stable key, None where it is unknown."""
        return {
            **_trajectory_numbers(self.trajectory, ""),
            **_trajectory_numbers(self.odometry, "odometry_"),
            **_map_numbers(self.map),
            **_bound_numbers(self.bound, self.trajectory),
            **_consistency_numbers(self.consistency, self.in_map),
            "evaluated_poses": 0 if self.trajectory is None else len(self.trajectory.truth),
            "unevaluated_poses": 0 if self.trajectory is None else self.trajectory.uncovered,
        }

    def budget_numbers(self) -> dict[str, dict[str, float]]:
        """The errors at key frames after each part, of all scans in the end, and of the map."""
        found = {part: asdict(errors) for part, errors in self.budget.items()}
        if found and self.trajectory is not None:
            found["all_scans"] = {
                "ate_rmse_m": statistics(self.trajectory.translation_m).rmse,
                "ate_rot_rmse_mrad": 1e3 * statistics(self.trajectory.rotation_rad).rmse,
            }
        if found and self.map is not None and self.map.wall_error_mean_m is not None:
            found["map"] = {"wall_error_mean_m": self.map.wall_error_mean_m}
        return found

    def relation_numbers(self) -> dict[str, object] | None:
        """The relation scores as nested dictionaries, None without a relations file."""
        if self.relations is None:
            return None
        odometry = self.odometry_relations
        return {
            **asdict(self.relations),
            "odometry": None if odometry is None else asdict(odometry),
        }


def evaluate(
    trajectory: PlanarTrajectory,
    odometry: PlanarTrajectory | None = None,
    grid: Grid | None = None,
    truth: Trajectory | None = None,
    truth_grid: Grid | None = None,
    relations: Relations | None = None,
    range_m: float = math.inf,
) -> Scores:
    """Score a run with whatever truth there is: none, a trajectory, true walls, relations.

    truth_grid: 1 solid, 0 free and reachable, nan not reachable; it needs truth as well, whose
    alignment it shares. range_m: how far the lidar sees; no walls further from the path than that
    are asked of the map. Raises SlamsimError if the truth and the run do not meet in time.
    """
    require_range(range_m)
    errors = drift = map_scores = None
    if truth is not None:
        planar = truth.planar()
        errors = compare(trajectory, planar, "the estimated trajectory")
        drift = None if odometry is None else compare(odometry, planar, "the odometry")
        if grid is not None and truth_grid is not None:
            map_scores = compare_grids(
                grid, truth_grid, errors.T_truth_estimate, errors.truth.poses[:, :2], range_m
            )
    return Scores(
        trajectory=errors,
        odometry=drift,
        map=map_scores,
        relations=_relations(trajectory, relations),
        odometry_relations=_relations(odometry, relations),
    )


def _relations(
    trajectory: PlanarTrajectory | None, relations: Relations | None
) -> RelationScores | None:
    if trajectory is None or relations is None:
        return None
    return score_relations(trajectory, relations.from_ns, relations.to_ns, relations.planar)


def _trajectory_numbers(errors: TrajectoryErrors | None, prefix: str) -> dict[str, Number]:
    if errors is None:
        return {prefix + key: None for key in _TRAJECTORY_KEYS}
    translation, rotation = statistics(errors.translation_m), statistics(errors.rotation_rad)
    relative = relative_errors(errors)
    values: tuple[Number, ...] = (
        translation.rmse,
        translation.mean,
        translation.median,
        translation.max,
        math.degrees(rotation.rmse),
        math.degrees(rotation.max),
        None if relative is None else relative.translation_percent,
        None if relative is None else relative.rotation_deg_per_m,
    )
    return {prefix + key: value for key, value in zip(_TRAJECTORY_KEYS, values, strict=True)}


def _map_numbers(scores: MapScores | None) -> dict[str, Number]:
    return {
        "map_wall_recall": None if scores is None else scores.wall_recall,
        "map_wall_coverage": None if scores is None else scores.wall_coverage,
        "map_wall_precision": None if scores is None else scores.wall_precision,
        "map_wall_error_mean_m": None if scores is None else scores.wall_error_mean_m,
        "map_doubled_wall_share": None if scores is None else scores.doubled_wall_share,
        "map_free_iou": None if scores is None else scores.free_iou,
        "map_free_coverage": None if scores is None else scores.free_coverage,
    }


def _bound_numbers(
    bound: TrajectoryBound | None, errors: TrajectoryErrors | None
) -> dict[str, Number]:
    if bound is None or errors is None:
        return dict.fromkeys(_BOUND_KEYS)
    ate_m = statistics(errors.translation_m).rmse
    values = (
        bound.ate_m,
        ate_m / bound.ate_m if bound.ate_m > 0.0 else None,
        bound.localisation_m,
        1e3 * bound.localisation_rad,
        bound.scan_m,
        1e3 * bound.scan_rad,
        bound.lost_share,
        bound.mixed_share,
    )
    return dict(zip(_BOUND_KEYS, values, strict=True))


def _consistency_numbers(
    consistency: Consistency | None, in_map: Consistency | None
) -> dict[str, Number]:
    return {
        "nees_mean": None if consistency is None else consistency.mean,
        "nees_expected": None if consistency is None else DEGREES_OF_FREEDOM,
        "nees_inside_95_share": None if consistency is None else consistency.inside_share,
        "nees_in_map_mean": None if in_map is None else in_map.mean,
        "nees_in_map_inside_95_share": None if in_map is None else in_map.inside_share,
    }
