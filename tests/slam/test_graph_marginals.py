"""Uncertainties of the graph against dense inverses and drawn samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamsim.core.geometry import adjoint, between, compose, rotation
from slamsim.core.result import EdgeKind, GraphEdge
from slamsim.core.types import FloatArray, OutsideTimeRange, PlanarTrajectory
from slamsim.slam.backend.correction import correct, densify
from slamsim.slam.backend.estimate import Estimate
from slamsim.slam.backend.marginals import edge_covariances, relative_covariances


def random_covariance(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(3, 3)) * [[0.03], [0.03], [0.01]]
    return np.asarray(root @ root.T + np.diag([1e-5, 1e-5, 1e-6]))


def random_graph(seed: int, count: int, loops: int) -> tuple[FloatArray, list[GraphEdge]]:
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    pairs = [(i, i + 1) for i in range(count - 1)]
    pairs += [tuple(sorted(rng.choice(count, 2, replace=False).tolist())) for _ in range(loops)]
    edges = [
        GraphEdge(a, b, between(poses[a], poses[b]), random_covariance(rng), "match")
        for a, b in pairs
    ]
    return poses, edges


def dense_inverse(poses: FloatArray, edges: list[GraphEdge], fixed: int) -> FloatArray:
    """(n, 3, 3) diagonal blocks by forming and inverting the whole system."""
    count = len(poses)
    system = np.zeros((3 * count, 3 * count))
    for edge, covariance in zip(edges, edge_covariances(edges), strict=True):
        rows = np.zeros((3, 3 * count))
        a, b = edge.source, edge.target
        rows[:, 3 * a : 3 * a + 3] = -adjoint(between(poses[b], poses[a]))
        rows[:, 3 * b : 3 * b + 3] = np.eye(3)
        system += edge.weight * rows.T @ np.linalg.inv(covariance) @ rows
    kept = np.delete(np.arange(3 * count), np.arange(3 * fixed, 3 * fixed + 3))
    inverse = np.zeros_like(system)
    inverse[np.ix_(kept, kept)] = np.linalg.inv(system[np.ix_(kept, kept)])
    return np.array([inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)])


@pytest.mark.parametrize(
    ("count", "loops", "fixed"), [(2, 0, 0), (15, 0, 7), (40, 30, 39), (60, 90, 0)]
)
def test_the_selected_inverse_is_the_inverse(count: int, loops: int, fixed: int) -> None:
    poses, edges = random_graph(count + loops, count, loops)
    found = relative_covariances(poses, edges, fixed)
    expected = dense_inverse(poses, edges, fixed)
    assert np.allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert np.array_equal(found[fixed], np.zeros((3, 3)))


def test_a_grid_of_streets_leaves_no_hole_in_the_pattern() -> None:
    """Right angles make many entries of the system exactly zero; none may be missed for it."""
    count = 64
    poses = np.array([(k % 8, k // 8, (k % 4) * np.pi / 2) for k in range(count)], dtype=float)
    pairs = [(i, i + 1) for i in range(count - 1)] + [(i, i + 8) for i in range(count - 8)]
    covariance = np.diag([1e-4, 1e-4, 1e-5])
    edges = [GraphEdge(a, b, between(poses[a], poses[b]), covariance, "match") for a, b in pairs]
    found = relative_covariances(poses, edges, 0)
    assert np.allclose(found, dense_inverse(poses, edges, 0), rtol=1e-7, atol=1e-12)


def test_withdrawn_edges_tell_nothing() -> None:
    poses, edges = random_graph(3, 20, 15)
    withdrawn = [replace(edge, kind="closure", weight=0.0) for edge in edges[19:]]
    with_them = relative_covariances(poses, edges[:19] + withdrawn, 0)
    assert np.allclose(with_them, relative_covariances(poses, edges[:19], 0))


def test_a_system_that_is_not_definite_is_said_to_be_so() -> None:
    poses, edges = random_graph(4, 5, 0)
    bad = GraphEdge(3, 4, edges[3].T_source_target, -np.eye(3), "match")
    with pytest.raises(np.linalg.LinAlgError):
        relative_covariances(poses, [*edges[:3], bad], 0)


def test_the_adjoint_carries_small_steps_between_frames() -> None:
    rng = np.random.default_rng(0)
    T_a_b, step_b = rng.normal(size=3), 1e-7 * rng.normal(size=3)
    step_a = adjoint(T_a_b) @ step_b
    assert np.allclose(compose(step_a, T_a_b), compose(T_a_b, step_b), atol=1e-12)
    assert np.allclose(rotation(np.array(0.3)) @ step_b, adjoint(np.array([0, 0, 0.3])) @ step_b)


def test_the_chain_of_the_estimate_has_the_spread_of_samples() -> None:
    rng = np.random.default_rng(9)
    steps = rng.normal(size=(25, 3)) * [0.5, 0.5, 0.6]
    edges = [
        GraphEdge(k, k + 1, step, 0.01 * random_covariance(rng), "match")
        for k, step in enumerate(steps)
    ]
    estimate = Estimate()
    estimate.begin(np.array([4.0, -2.0, 1.0]))
    for edge in edges:
        estimate.extend(edge)
    claimed = estimate.covariance(6, 25)

    drawn = np.zeros((4000, 3))
    for edge in edges[6:]:
        noise = rng.multivariate_normal(np.zeros(3), edge.covariance, size=4000)
        drawn = compose(drawn, edge.T_source_target + noise)
    off = between(between(estimate.poses[6], estimate.poses[25]), drawn)
    assert np.allclose(np.cov(off.T), claimed, rtol=0.1, atol=0.05 * np.abs(claimed).max())


def test_closures_make_the_estimate_surer_and_never_surer_than_the_dense_answer() -> None:
    poses, edges = random_graph(11, 30, 25)
    kinds: list[EdgeKind] = ["match"] * 29
    kinds += ["closure"] * 25
    edges = [replace(edge, kind=kind) for edge, kind in zip(edges, kinds, strict=True)]
    estimate = Estimate()
    estimate.begin(poses[0])
    for edge in edges[:29]:
        estimate.extend(edge)
    before = estimate.covariances(np.arange(29), 29)
    estimate.move(poses)
    estimate.renew_covariances(edges)
    after = estimate.covariances(np.arange(29), 29)
    carry = adjoint(between(poses[29], poses[:29]))
    exact = carry @ dense_inverse(poses, edges, 29)[:29] @ np.swapaxes(carry, 1, 2)
    assert np.allclose(after, exact, rtol=1e-6, atol=1e-9)
    assert np.trace(after[0]) < np.trace(before[0])
    for earlier in (0, 5, 10):
        bound = estimate.covariance(earlier, 20)
        dense = dense_inverse(poses, edges, earlier)[20]
        assert np.trace(bound) >= np.trace(dense) * (1.0 - 1e-9)


def smooth_motion() -> PlanarTrajectory:
    stamps_ns = np.arange(0, 10_000, 100, dtype=np.int64)
    t = stamps_ns / 1000.0
    return PlanarTrajectory(stamps_ns, np.column_stack([t, np.sin(t), 0.5 * np.cos(t)]))


def test_correction_passes_through_its_anchors_and_keeps_the_motion_between() -> None:
    motion = smooth_motion()
    moved = compose(np.array([3.0, -1.0, 0.7]), motion.poses)
    anchors = PlanarTrajectory(motion.stamps_ns[10:90:20], moved[10:90:20])
    fixed = correct(motion, anchors)
    assert np.allclose(fixed.poses, moved, atol=1e-9)

    bent = PlanarTrajectory(anchors.stamps_ns, anchors.poses + [[0.1, 0.0, 0.02]] * len(anchors))
    again = correct(motion, bent)
    assert np.allclose(again.at(bent.stamps_ns), bent.poses, atol=1e-9)
    assert np.abs(np.diff(again.poses, 2, axis=0)).max() < 0.02


def test_correction_does_not_reach_beyond_what_was_measured() -> None:
    anchors = PlanarTrajectory(np.array([-5, 100]), np.zeros((2, 3)))
    with pytest.raises(OutsideTimeRange):
        correct(smooth_motion(), anchors)


def test_densifying_keeps_the_given_poses_and_adds_the_motion_between_and_after() -> None:
    motion = smooth_motion()
    coarse = PlanarTrajectory(motion.stamps_ns[5:50:9] + 3, motion.at(motion.stamps_ns[5:50:9] + 3))
    fine = densify(coarse, motion)
    assert np.allclose(fine.at(coarse.stamps_ns), coarse.poses, atol=1e-12)
    assert fine.stamps_ns[0] == coarse.stamps_ns[0] and fine.stamps_ns[-1] == motion.stamps_ns[-1]
    assert np.allclose(fine.poses, motion.at(fine.stamps_ns), atol=1e-9)

    apart = PlanarTrajectory(np.array([20_000, 30_000]), np.zeros((2, 3)))
    assert densify(apart, motion) is apart
