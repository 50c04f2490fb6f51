"""Covariances of returned key frames, against dense matrices and drawn drives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.geometry import inverse as inverse_of
from slamsim.core.result import EdgeKind, GraphEdge, PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.models.supernodes import add_block, empty_system, make_panels
from slamsim.slam.backend.smoothing import Smoothed
from slamsim.slam.backend.surface_information import (
    MapInformation,
    SurfaceInformation,
    drift_between,
    smoothed_information,
    with_scatter,
)

SECOND_NS = 1_000_000_000


def spd(rng: np.random.Generator, *shape: int) -> FloatArray:
    """(*shape, 3, 3) positive definite."""
    root = rng.standard_normal((*shape, 3, 3))
    return np.asarray(root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(3))


def nothing_seen(poses: FloatArray) -> tuple[SurfaceInformation, FloatArray]:
    """Poses that see nothing in common, and how far odometry may be off: (count - 1, 3, 3)."""
    count = len(poses)
    rng = np.random.default_rng(count)
    number = np.append(count - 1, np.arange(count - 1))
    panels = make_panels(np.stack([number[:-1], number[1:]], axis=1), count - 1)
    drift = spd(rng, count - 1)
    nowhere = np.zeros((0, 2), dtype=np.int64)
    seen = empty_system(panels)
    closures = nowhere, np.zeros((0, 3, 3))
    of_surfaces = panels, seen, nowhere
    return SurfaceInformation.of(of_surfaces, drift, closures, poses, np.zeros_like(poses)), drift


def driven(poses: FloatArray, drift: FloatArray, covariances: FloatArray) -> Smoothed:
    """A drive of one scan a second."""
    stamps_ns = np.arange(len(poses)) * SECOND_NS
    return Smoothed(PlanarTrajectory(stamps_ns, poses), covariances, drift, 1.0, np.ones(3))


def graph_of(drive: Smoothed, every: int, kinds: dict[int, EdgeKind]) -> PoseGraph:
    """Every so many scans a key frame; kinds: of the edges to some of them."""
    track = drive.track
    keyframes = PlanarTrajectory(track.stamps_ns[::every], track.poses[::every])
    edges = [
        GraphEdge(k - 1, k, np.zeros(3), np.eye(3), kinds.get(k, "match"))
        for k in range(1, len(keyframes))
    ]
    return PoseGraph(keyframes, np.zeros((len(keyframes), 3, 3)), tuple(edges))


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 7))
def test_covariances_are_the_dense_inverse_of_all_that_was_seen_and_driven(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    number = np.append(count - 1, np.arange(count - 1))
    pairs = np.array([(a, b) for a in range(count) for b in range(a)])
    panels = make_panels(number[pairs], count - 1)
    seen, drift = empty_system(panels), spd(rng, count - 1)
    poses, T_base_view = rng.normal(size=(2, count, 3))
    dense = np.zeros((3 * count, 3 * count))
    for k in range(1, count):
        block = spd(rng)
        add_block(panels, seen, number[k], number[k], block)
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += block
    loop, loose = np.array([[0, count - 1]]), spd(rng, 1)
    steps = [*((k, k + 1, drift[k]) for k in range(count - 1)), (0, count - 1, loose[0])]
    for first, second, covariance in steps:
        ends = np.zeros((3, 3 * count))
        ends[:, 3 * first : 3 * first + 3] = -adjoint(between(poses[second], poses[first]))
        ends[:, 3 * second : 3 * second + 3] = np.eye(3)
        dense += ends.T @ np.linalg.inv(covariance) @ ends
    inverse = np.asarray(np.linalg.inv(dense[3:, 3:]), np.float64)
    information = SurfaceInformation.of(
        (panels, seen, pairs), drift, (loop, loose), poses, T_base_view
    )
    found = information.covariances()
    assert not found[0].any()
    for k in range(1, count):
        own = adjoint(T_base_view[k])
        block = inverse[3 * k - 3 : 3 * k, 3 * k - 3 : 3 * k]
        np.testing.assert_allclose(found[k], own @ block @ own.T, rtol=1e-8, atol=1e-12)
    scatter, joint = spd(rng, count), np.zeros((3 * count, 3 * count))
    to_base = block_diag(*adjoint(T_base_view))
    joint[3:, 3:] = inverse
    joint = to_base @ joint @ to_base.T + block_diag(*scatter)
    base = compose(poses, inverse_of(T_base_view))
    same_within(information.smoothed(scatter).in_map, by_least_squares(base, joint))


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), count=st.integers(3, 9))
def test_within_the_map_bridges_count_as_they_lie(seed: int, count: int) -> None:
    """A chain with one loop somewhere: what is joined by odometry alone is not solved for."""
    rng = np.random.default_rng(seed)
    poses, drift, scatter = rng.normal(size=(count, 3)), spd(rng, count - 1), spd(rng, count)
    a, b = np.sort(rng.choice(count, 2, replace=False))
    loop, loose = np.array([[a, b]]), spd(rng, 1)
    number = np.append(count - 1, np.arange(count - 1))
    ends = np.concatenate([np.stack([np.arange(count - 1), np.arange(1, count)], axis=1), loop])
    panels = make_panels(number[ends], count - 1)
    nowhere = np.zeros((0, 2), dtype=np.int64)
    seen, level = empty_system(panels), np.zeros_like(poses)
    information = SurfaceInformation.of((panels, seen, nowhere), drift, (loop, loose), poses, level)
    dense = np.zeros((3 * count, 3 * count))
    for (source, target), covariance in zip(ends, [*drift, *loose], strict=True):
        row = np.zeros((3, 3 * count))
        row[:, 3 * source : 3 * source + 3] = -adjoint(between(poses[target], poses[source]))
        row[:, 3 * target : 3 * target + 3] = np.eye(3)
        dense += row.T @ np.linalg.inv(covariance) @ row
    joint = block_diag(*scatter)
    joint[3:, 3:] += np.linalg.inv(dense[3:, 3:])
    for first in {0, count - 3}:  # the drive alone is laid onto the truth, as for the ATE
        found = information.smoothed(scatter, first).in_map
        same_within(found, by_least_squares(poses[first:], joint[3 * first :, 3 * first :]))


def test_a_map_of_one_place_says_nothing_of_its_turn() -> None:
    poses = np.random.default_rng(4).normal(size=(5, 3)) * [1e-3, 1e-3, 1.0]
    assert nothing_seen(poses)[0].smoothed(np.tile(np.eye(3), (5, 1, 1))).in_map is None


def by_least_squares(poses: FloatArray, joint: FloatArray) -> FloatArray:
    """(n, 3, 3) what is left of errors of a joint covariance (3 n, 3 n), each pose's in its own
    frame, after the rigid motion of all poses that fits their positions best, in the map frame."""
    count = len(poses)
    turn = np.zeros((3 * count, 3 * count))
    whole = np.zeros((3 * count, 3))
    for k, (x, y, yaw) in enumerate(poses):
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
        whole[3 * k : 3 * k + 3] = [[1, 0, -y], [0, 1, x], [0, 0, 1]]
    positions = np.arange(3 * count) % 3 < 2
    fit = np.zeros((3, 3 * count))
    fit[:, positions] = np.linalg.pinv(whole[positions])
    left = turn.T @ (np.eye(3 * count) - whole @ fit) @ turn
    found = left @ joint @ left.T
    return np.stack([found[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)])


def same_within(found: FloatArray | None, expected: FloatArray) -> None:
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_drift_between_key_frames_is_that_of_drawn_steps() -> None:
    rng = np.random.default_rng(1)
    steps = rng.normal(size=(6, 3)) * [0.5, 0.1, 0.4]
    drift = 1e-6 * spd(rng, 6)
    roots = np.linalg.cholesky(drift)
    poses = [np.array([3.0, -2.0, 1.0])]
    for step in steps:
        poses.append(compose(poses[-1], step))
    drive = driven(np.array(poses), drift, np.zeros((7, 3, 3)))
    found = drift_between(drive, np.array([0, 2, 6]) * SECOND_NS)
    ends = np.tile(poses[2], (20_000, 1))
    for k in range(2, 6):
        noise = rng.standard_normal((20_000, 3)) @ roots[k].T
        ends = compose(ends, compose(np.tile(steps[k], (20_000, 1)), noise))
    assert found.shape == (2, 3, 3)
    drawn = np.cov(between(poses[6], ends).T)
    np.testing.assert_allclose(drawn, found[1], atol=0.05 * np.abs(found[1]).max())


def test_scatter_of_the_first_pose_is_in_all_others() -> None:
    rng = np.random.default_rng(2)
    poses = rng.normal(size=(3, 3)) * [5.0, 5.0, 2.0]
    scatter = 1e-6 * spd(rng, 3)
    roots = np.linalg.cholesky(scatter)
    drawn = [
        compose(np.tile(pose, (20_000, 1)), rng.standard_normal((20_000, 3)) @ root.T)
        for pose, root in zip(poses, roots, strict=True)
    ]
    found = with_scatter(poses, np.zeros((3, 3, 3)), scatter)
    assert not found[0].any()
    for k in (1, 2):
        error = between(between(poses[0], poses[k]), between(drawn[0], drawn[k]))
        np.testing.assert_allclose(np.cov(error.T), found[k], atol=0.05 * found[k].max())


@pytest.mark.parametrize("first", [0, 2])
def test_where_a_guess_joins_two_key_frames_the_drive_makes_them_no_surer(first: int) -> None:
    poses = np.random.default_rng(3).normal(size=(6, 3))
    information, drift = nothing_seen(poses)
    tiny = np.tile(1e-7 * np.eye(3), (5, 1, 1))
    whole = graph_of(driven(poses, tiny, np.zeros((6, 3, 3))), 1, {4: "odometry"})
    drive = driven(poses[first:], tiny[first:], np.zeros((6 - first, 3, 3)))
    stamps_ns = np.append(np.arange(first) - 10, np.arange(6 - first)) * SECOND_NS
    graph = PoseGraph(PlanarTrajectory(stamps_ns, poses), whole.covariances, whole.edges)
    found = smoothed_information(information, graph, first, drive).covariances().relative
    expected = np.zeros((3, 3))
    for k in [*range(first), 3]:
        carry = adjoint(between(poses[5], poses[k + 1]))
        expected += carry @ drift[k] @ carry.T
    assert found.shape == (6 - first, 3, 3)
    np.testing.assert_allclose(found[-1], expected, atol=1e-4)


def test_the_way_from_an_earlier_maps_frame_was_not_driven() -> None:
    poses = np.random.default_rng(5).normal(size=(5, 3)) * [50.0, 50.0, 2.0]
    information, scatter = nothing_seen(poses)[0], np.zeros((5, 3, 3))
    steps = MapInformation(information, scatter, 2, held=False).steps()
    assert [(e.source, e.target, e.kind) for e in steps] == [
        (-1, 0, "match"),
        (0, 1, "odometry"),
        (1, 2, "odometry"),
    ]
    np.testing.assert_allclose(steps[0].T_source_target, poses[2])
