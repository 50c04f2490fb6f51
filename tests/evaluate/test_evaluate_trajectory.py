"""Trajectory errors: against evo, against known motions, and where they must be refused."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.geometry import compose, wrap_angle, xyzw_from_yaw
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.evaluate.trajectory import (
    align_se2,
    compare,
    pair_errors,
    relative_errors,
    segments,
    statistics,
)
from slamsim.guard.errors import SlamsimError


def wandering(rng: np.random.Generator, count: int = 200, dt_ns: int = 50_000_000) -> FloatArray:
    """(count, 3) poses of a robot that drives forward and turns at random."""
    turn = np.cumsum(rng.normal(0.0, 0.02, count))
    yaw = np.cumsum(turn * 0.05)
    step = 0.05 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.column_stack([np.cumsum(step, axis=0), wrap_angle(yaw)])


def trajectory(poses: FloatArray, start_ns: int = 0, dt_ns: int = 50_000_000) -> PlanarTrajectory:
    return PlanarTrajectory(start_ns + np.arange(len(poses), dtype=np.int64) * dt_ns, poses)


def disturbed(rng: np.random.Generator, truth: FloatArray) -> FloatArray:
    """The truth moved rigidly, with noise and a slow drift."""
    noise = rng.normal(0.0, 1.0, truth.shape) * [0.02, 0.02, 0.01]
    drift = np.cumsum(rng.normal(0.0, 1.0, truth.shape) * [0.003, 0.003, 0.001], axis=0)
    poses = compose(rng.uniform(-3.0, 3.0, 3), truth + noise + drift)
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def evo_pair(estimate: PlanarTrajectory, truth: PlanarTrajectory):  # type: ignore[no-untyped-def]
    from evo.core.trajectory import PoseTrajectory3D

    made = []
    for part in (truth, estimate):
        xyz = np.column_stack([part.poses[:, :2], np.zeros(len(part))])
        wxyz = np.roll(xyzw_from_yaw(part.poses[:, 2]), 1, axis=1)
        made.append(PoseTrajectory3D(xyz, wxyz, part.stamps_ns * 1e-9))
    return tuple(made)


@pytest.mark.parametrize("seed", range(5))
def test_ate_agrees_with_evo(seed: int) -> None:
    from evo.core.metrics import APE, PoseRelation

    rng = np.random.default_rng(seed)
    truth = trajectory(wandering(rng))
    estimate = trajectory(disturbed(rng, truth.poses))
    errors = compare(estimate, truth)

    reference, candidate = evo_pair(estimate, truth)
    candidate.align(reference, correct_scale=False)
    for relation, ours in (
        (PoseRelation.translation_part, errors.translation_m),
        (PoseRelation.rotation_angle_deg, np.rad2deg(errors.rotation_rad)),
    ):
        ape = APE(relation)
        ape.process_data((copy.deepcopy(reference), copy.deepcopy(candidate)))
        theirs, mine = ape.get_all_statistics(), statistics(ours)
        assert mine.rmse == pytest.approx(theirs["rmse"], abs=1e-6)
        assert mine.max == pytest.approx(theirs["max"], abs=1e-5)
        assert mine.mean == pytest.approx(theirs["mean"], abs=1e-6)
        assert mine.median == pytest.approx(theirs["median"], abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_relative_errors_agree_with_evo_on_the_same_pairs(seed: int) -> None:
    from evo.core.metrics import RPE, PoseRelation, Unit

    rng = np.random.default_rng(seed)
    truth = trajectory(wandering(rng))
    estimate = trajectory(disturbed(rng, truth.poses))
    for delta in (1, 20):
        starts = np.arange(len(truth) - delta)
        ours = pair_errors(estimate.poses, truth.poses, starts, starts + delta)
        for relation, values in (
            (PoseRelation.translation_part, np.linalg.norm(ours[:, :2], axis=1)),
            (PoseRelation.rotation_angle_rad, np.abs(ours[:, 2])),
        ):
            rpe = RPE(relation, delta, Unit.frames, all_pairs=True)
            rpe.process_data(evo_pair(estimate, truth))
            np.testing.assert_allclose(values, rpe.error, atol=1e-6)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_rigid_motion_is_no_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = trajectory(wandering(rng))
    moved = trajectory(compose(rng.uniform(-10.0, 10.0, 3), truth.poses))
    errors = compare(moved, truth)
    assert statistics(errors.translation_m).max < 1e-9
    assert statistics(errors.rotation_rad).max < 1e-9
    relative = relative_errors(errors)
    assert relative is not None
    assert relative.translation_percent < 1e-6
    assert relative.rotation_deg_per_m < 1e-6


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_other_rigid_motion_brings_the_positions_closer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = wandering(rng)
    estimate = disturbed(rng, truth)
    best = align_se2(estimate, truth)

    def cost(T_truth_estimate: FloatArray) -> float:
        moved = compose(T_truth_estimate, estimate)
        return float(np.sum((moved[:, :2] - truth[:, :2]) ** 2))

    for step in rng.normal(0.0, 0.01, (20, 3)):
        assert cost(best) <= cost(best + step)


def test_the_truth_is_interpolated_to_the_estimates_instants() -> None:
    truth = trajectory(np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)]))
    stamps_ns = truth.stamps_ns[:-1] + 20_000_000
    poses = np.column_stack([np.arange(10.0) + 0.4, np.zeros(10), np.zeros(10)])
    errors = compare(PlanarTrajectory(stamps_ns, poses), truth)
    np.testing.assert_allclose(errors.T_truth_estimate, 0.0, atol=1e-12)
    np.testing.assert_allclose(errors.translation_m, 0.0, atol=1e-12)


def test_poses_beyond_the_truth_or_in_a_gap_of_it_are_left_out_and_counted() -> None:
    poses = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    dense = trajectory(poses, dt_ns=500_000_000)
    keep = np.array([0, 1, 2, 3, 7, 8, 9])
    truth = PlanarTrajectory(dense.stamps_ns[keep], dense.poses[keep])
    errors = compare(dense, truth)
    assert errors.uncovered == 4
    np.testing.assert_array_equal(errors.truth.stamps_ns, truth.stamps_ns)


def test_without_common_instants_both_spans_are_named() -> None:
    poses = wandering(np.random.default_rng(0), count=20)
    with pytest.raises(SlamsimError, match=r"100\.000 s to 100\.950 s, the truth 0\.000 s to"):
        compare(trajectory(poses, start_ns=100_000_000_000), trajectory(poses))
    empty = PlanarTrajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    with pytest.raises(SlamsimError, match="nothing"):
        compare(empty, trajectory(poses))
    with pytest.raises(SlamsimError, match="nothing"):
        compare(trajectory(poses), empty)


def test_a_pose_that_is_not_finite_is_refused() -> None:
    poses = wandering(np.random.default_rng(0), count=20)
    broken = poses.copy()
    broken[3, 1] = np.nan
    with pytest.raises(SlamsimError, match="not finite"):
        compare(trajectory(broken), trajectory(poses))


def test_a_robot_that_stands_still_is_aligned_by_its_heading() -> None:
    rng = np.random.default_rng(1)
    truth = np.column_stack([np.full((50, 2), 2.0), np.full(50, 3.0)])
    estimate = np.column_stack([rng.normal(0.0, 0.001, (50, 2)), np.full(50, -3.0)])
    errors = compare(trajectory(estimate), trajectory(truth))
    assert statistics(errors.rotation_rad).max < 1e-9
    assert statistics(errors.translation_m).max < 0.01
    assert relative_errors(errors) is None


def test_a_known_scale_and_turn_error_reads_as_per_cent_and_degrees_per_metre() -> None:
    x = np.arange(0.0, 30.0, 0.05)
    truth = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    longer = truth * [1.02, 1.0, 1.0]
    relative = relative_errors(compare(trajectory(longer), trajectory(truth)))
    assert relative is not None
    assert relative.translation_percent == pytest.approx(2.0, abs=1e-6)

    turning = truth + np.column_stack([0 * x, 0 * x, np.deg2rad(0.5) * x])
    relative = relative_errors(compare(trajectory(turning), trajectory(truth)))
    assert relative is not None
    assert relative.rotation_deg_per_m == pytest.approx(0.5, abs=1e-6)


def test_segments_are_those_of_a_slow_search() -> None:
    rng = np.random.default_rng(2)
    path_m = np.cumsum(rng.uniform(0.0, 0.1, 300))
    starts, ends = segments(path_m, (1.0, 5.0, 1000.0))
    expected = []
    for length_m in (1.0, 5.0, 1000.0):
        for start in range(300):
            reached = [k for k in range(start, 300) if path_m[k] >= path_m[start] + length_m]
            if reached:
                expected.append((start, reached[0]))
    assert list(zip(starts.tolist(), ends.tolist(), strict=True)) == expected
