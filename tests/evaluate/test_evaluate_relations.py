"""Relation scores: the published table of real logs, and the metric against 4 x 4 matrices."""

from __future__ import annotations

import numpy as np
import pytest
from real_logs import needs_radish, radish

from slamsim.core.geometry import between, wrap_angle
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory, Trajectory
from slamsim.evaluate.relations import score_relations
from slamsim.evaluate.score import evaluate
from slamsim.guard.errors import SlamsimError
from slamsim.io.open import read_log
from slamsim.io.text.relations import Relations, read_relations


@pytest.mark.long
@needs_radish
@pytest.mark.parametrize(
    ("name", "count", "metres", "degrees"),
    [
        ("aces", 1279, 0.549, 2.33),
        pytest.param("intel", 2984, 7.37, 39.2, marks=pytest.mark.slow),
        pytest.param("fr079", 1685, 6.50, 30.3, marks=pytest.mark.slow),
    ],
)
def test_odometry_alone_has_its_known_error_on_real_logs(
    name: str, count: int, metres: float, degrees: float
) -> None:
    path, relations_path = radish(name)
    log, relations = read_log(path), read_relations(relations_path)
    assert log.odometry is not None
    scores = score_relations(log.odometry, relations.from_ns, relations.to_ns, relations.planar)
    assert (scores.all.count, scores.skipped) == (count, 0)
    assert scores.all.translation_mean_m == pytest.approx(metres, rel=2e-3)
    assert scores.all.rotation_mean_deg == pytest.approx(degrees, rel=2e-3)


def matrix(pose: FloatArray) -> FloatArray:
    x, y, yaw = pose
    return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0, 0, 1]])


def random_case(seed: int) -> tuple[PlanarTrajectory, Relations]:
    """A run of 200 s and relations over 1 s to 150 s; their errors are large and known."""
    rng = np.random.default_rng(seed)
    stamps_ns = np.arange(0, 200_000_000_001, 1_000_000_000, dtype=np.int64)
    poses = np.column_stack([rng.normal(0, 5, (201, 2)), rng.uniform(-3, 3, 201)])
    first, second = rng.integers(0, 200, (2, 60))
    T_from_to = np.tile(np.eye(4), (60, 1, 1))
    yaw = rng.uniform(-3, 3, 60)
    T_from_to[:, 0, 0], T_from_to[:, 1, 0] = np.cos(yaw), np.sin(yaw)
    T_from_to[:, 0, 1], T_from_to[:, 1, 1] = -np.sin(yaw), np.cos(yaw)
    T_from_to[:, :2, 3] = rng.normal(0, 5, (60, 2))
    trajectory = PlanarTrajectory(stamps_ns, poses)
    return trajectory, Relations(stamps_ns[first], stamps_ns[second], T_from_to)


@pytest.mark.parametrize("seed", range(4))
def test_the_metric_is_that_of_matrices(seed: int) -> None:
    trajectory, relations = random_case(seed)
    metres, degrees, apart_s = [], [], []
    for start, end, relation in zip(
        relations.from_ns, relations.to_ns, relations.planar, strict=True
    ):
        first = matrix(trajectory.poses[start // 1_000_000_000])
        second = matrix(trajectory.poses[end // 1_000_000_000])
        error = np.linalg.inv(matrix(relation)) @ (np.linalg.inv(first) @ second)
        metres.append(np.hypot(error[0, 2], error[1, 2]))
        degrees.append(np.rad2deg(abs(np.arctan2(error[1, 0], error[0, 0]))))
        apart_s.append(abs(end - start) / 1e9)
    scores = score_relations(trajectory, relations.from_ns, relations.to_ns, relations.planar)
    for part, chosen in (
        (scores.all, np.full(60, True)),
        (scores.near, np.array(apart_s) < 5.0),
        (scores.far, np.array(apart_s) > 60.0),
    ):
        assert part is not None
        assert part.count == chosen.sum()
        assert part.translation_mean_m == pytest.approx(np.mean(np.array(metres)[chosen]))
        assert part.translation_std_m == pytest.approx(np.std(np.array(metres)[chosen]))
        assert part.rotation_mean_deg == pytest.approx(np.mean(np.array(degrees)[chosen]))
        assert part.rotation_std_deg == pytest.approx(np.std(np.array(degrees)[chosen]))


def test_relations_outside_the_trajectory_are_counted_and_none_at_all_is_refused() -> None:
    trajectory, relations = random_case(0)
    short = PlanarTrajectory(trajectory.stamps_ns[:100], trajectory.poses[:100])
    scores = score_relations(short, relations.from_ns, relations.to_ns, relations.planar)
    beyond = (relations.from_ns > 99e9) | (relations.to_ns > 99e9)
    assert (scores.skipped, scores.all.count) == (beyond.sum(), 60 - beyond.sum())

    late = relations.from_ns + 10**15
    with pytest.raises(SlamsimError, match="none of the 60 relations"):
        score_relations(trajectory, late, late, relations.planar)


def test_without_truth_every_score_is_there_and_unknown() -> None:
    trajectory, _ = random_case(0)
    scores = evaluate(trajectory, trajectory)
    numbers = scores.numbers()
    assert {"ate_rmse_m", "odometry_ate_rmse_m", "map_wall_recall", "map_free_iou"} <= set(numbers)
    assert numbers["ate_rmse_m"] is None
    assert numbers["map_wall_recall"] is None
    assert scores.relation_numbers() is None


def test_estimate_odometry_map_and_relations_are_scored_together() -> None:
    trajectory, relations = random_case(1)
    moving = np.column_stack([np.linspace(0, 40, 201), np.zeros(201), np.zeros(201)])
    truth = PlanarTrajectory(trajectory.stamps_ns, moving)
    bent = moving + np.column_stack([np.zeros(201), 0.001 * moving[:, 0] ** 2, np.zeros(201)])
    cells = np.ones((10, 10), dtype=np.float32)
    cells[2:8, 2:8] = 0.0
    room = Grid(cells, 0.1, (-0.5, -0.5))
    spatial = Trajectory(
        truth.stamps_ns,
        np.column_stack([moving[:, :2], np.zeros(201)]),
        np.tile([0.0, 0.0, 0.0, 1.0], (201, 1)),
    )
    odometry = PlanarTrajectory(truth.stamps_ns, bent)
    scores = evaluate(truth, odometry, room, spatial, room, relations)
    numbers = scores.numbers()
    assert numbers["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert numbers["ate_rot_max_deg"] == pytest.approx(0.0, abs=1e-6)
    assert isinstance(numbers["odometry_ate_rmse_m"], float)
    assert numbers["odometry_ate_rmse_m"] > 0.05
    assert (numbers["map_wall_recall"], numbers["map_free_iou"]) == (1.0, 1.0)
    nested = scores.relation_numbers()
    assert nested is not None
    assert set(nested) == {"all", "near", "far", "skipped", "odometry"}


def test_a_relation_equal_to_the_motion_is_no_error() -> None:
    trajectory, _ = random_case(2)
    start, end = trajectory.stamps_ns[:100], trajectory.stamps_ns[100:200]
    motion = between(trajectory.poses[:100], trajectory.poses[100:200])
    motion[:, 2] = wrap_angle(motion[:, 2])
    scores = score_relations(trajectory, start, end, motion)
    assert scores.all.translation_mean_m == pytest.approx(0.0, abs=1e-9)
    assert scores.all.rotation_mean_deg == pytest.approx(0.0, abs=1e-6)
