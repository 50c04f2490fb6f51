"""The pose graph and its solution; the only place that knows GTSAM.

GTSAM's Levenberg-Marquardt returns its initial values, without an error, when it meets a number
that is not finite, a covariance that is none, or poses that nothing holds. All of that is
therefore checked before and after each solve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from slamsim.config.back_end import GraphConfig
from slamsim.geometry import between, wrap_angle
from slamsim.safe.errors import SlamsimError
from slamsim.slam.marginals import rotation
from slamsim.types import FloatArray, GraphEdge

EIGENVALUE_BOUNDS = (1e-14, 1e12)
MAX_WITHDRAWALS = 10
RISE_ALLOWED = 1e-6


class GraphUnsound(SlamsimError):
    """A pose graph that has no solution: a number not finite, a covariance that is none, poses
    that nothing joins to the first, or a solver that did not make it better."""


def solve(
    poses: FloatArray, edges: Sequence[GraphEdge], cauchy_width: float | None = None
) -> FloatArray:
    """(n, 3) ``T_map_base`` of least squares, the first pose held where it is.

    poses: (n, 3) to begin with. Edges of weight 0 are left out. cauchy_width: closures are
    weighed by Cauchy's estimator of this width in standard deviations; None weighs them by
    ``GraphEdge.weight``. Raises GraphUnsound.
    """
    used = [edge for edge in edges if edge.weight > 0.0]
    check_graph(poses, used)
    if len(poses) == 1:
        return poses.copy()
    graph = _factor_graph(poses, used, cauchy_width)
    initial = gtsam.Values()
    for number, pose in enumerate(poses):
        initial.insert(number, gtsam.Pose2(*pose))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, initial, _parameters())
    before = graph.error(initial)
    values = optimizer.optimize()
    after = graph.error(values)
    solved = np.array([(p.x(), p.y(), p.theta()) for p in map(values.atPose2, range(len(poses)))])
    if not (np.isfinite(after) and np.isfinite(solved).all()):
        raise GraphUnsound(f"the solution of the pose graph is not finite (error {after})")
    if after > before * (1.0 + RISE_ALLOWED) + RISE_ALLOWED:
        raise GraphUnsound(f"solving raised the error of the pose graph: {before} to {after}")
    return solved


def solve_robustly(
    poses: FloatArray, edges: Sequence[GraphEdge], config: GraphConfig
) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
    """The solution that false closures do not bend, and the edges with the weights it left them.

    First Cauchy's estimator, which recovers from many false closures at once; then closures
    beyond ``withdraw_sigmas`` are withdrawn, and the rest solved again by least squares, until
    it is the same ones that fit. A closure may come back. Raises GraphUnsound.
    """
    solved = solve(poses, [replace(edge, weight=1.0) for edge in edges], config.cauchy_width)
    weights = _fitting(solved, edges, config.withdraw_sigmas)
    weighed = _reweighed(edges, weights)
    for _ in range(MAX_WITHDRAWALS):
        solved = solve(solved, weighed)
        again = _fitting(solved, edges, config.withdraw_sigmas)
        if np.array_equal(again, weights):
            break
        weights = again
        weighed = _reweighed(edges, weights)
    return solved, weighed


def residual_sigmas(poses: FloatArray, edges: Sequence[GraphEdge]) -> FloatArray:
    """(m,) how many standard deviations each edge is away from what it measured."""
    if not edges:
        return np.zeros(0)
    sources, targets = [e.source for e in edges], [e.target for e in edges]
    measured = np.array([edge.T_source_target for edge in edges])
    error = between(poses[sources], poses[targets]) - measured
    error[:, 2] = wrap_angle(error[:, 2])
    covariances = np.array([edge.covariance for edge in edges])
    weighted = np.linalg.solve(covariances, error[..., None])[..., 0]
    return np.asarray(np.sqrt(np.maximum((error * weighted).sum(axis=1), 0.0)))


def check_graph(poses: FloatArray, edges: Sequence[GraphEdge]) -> None:
    """Raise GraphUnsound unless all is finite, covariances are such, and all poses are joined."""
    if len(poses) == 0:
        raise GraphUnsound("a pose graph without poses")
    if not np.isfinite(poses).all():
        raise GraphUnsound(f"pose {_first_bad(poses)} of the graph is not finite")
    ends = np.array([(edge.source, edge.target) for edge in edges], dtype=np.int64).reshape(-1, 2)
    if ((ends < 0) | (ends >= len(poses))).any() or (ends[:, 0] == ends[:, 1]).any():
        raise GraphUnsound("an edge of the graph leads to no pose, or to its own")
    measured = np.array([edge.T_source_target for edge in edges]).reshape(-1, 3)
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 3, 3)
    if not (np.isfinite(measured).all() and np.isfinite(covariances).all()):
        bad = _first_bad(np.concatenate([measured, covariances.reshape(-1, 9)], axis=1))
        raise GraphUnsound(f"edge {ends[bad].tolist()} of the graph is not finite")
    if not np.allclose(covariances, np.swapaxes(covariances, 1, 2), rtol=1e-6, atol=1e-12):
        raise GraphUnsound("a covariance of the graph is not symmetric")
    values = np.linalg.eigvalsh(covariances) if len(edges) else np.ones((1, 3))
    if values.min() < EIGENVALUE_BOUNDS[0] or values.max() > EIGENVALUE_BOUNDS[1]:
        raise GraphUnsound(
            f"covariances of the graph have eigenvalues {values.min():.3g} to {values.max():.3g}, "
            f"allowed are {EIGENVALUE_BOUNDS[0]:.0e} to {EIGENVALUE_BOUNDS[1]:.0e}"
        )
    _check_joined(len(poses), ends)


def _first_bad(rows: FloatArray) -> int:
    return int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])


def _check_joined(count: int, ends: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> None:
    """Union-find: all poses hang together with the first."""
    parent = list(range(count))

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for source, target in ends.tolist():
        parent[root(target)] = root(source)
    home = root(0)
    loose = sum(root(node) != home for node in range(count))
    if loose:
        raise GraphUnsound(f"{loose} of {count} poses of the graph are not joined to the first")


def _factor_graph(
    poses: FloatArray, edges: Sequence[GraphEdge], cauchy_width: float | None
) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-4))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0]), held))
    for edge in edges:
        # GTSAM's covariances are those of a step in the frame of the target.
        turn = rotation(-edge.T_source_target[2])
        covariance = turn @ edge.covariance @ turn.T / edge.weight
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(
            0.5 * (covariance + covariance.T)
        )
        if edge.kind == "closure" and cauchy_width is not None:
            estimator = gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy_width)
            noise = gtsam.noiseModel.Robust.Create(estimator, noise)
        measured = gtsam.Pose2(*edge.T_source_target)
        graph.add(gtsam.BetweenFactorPose2(edge.source, edge.target, measured, noise))
    return graph


def _parameters() -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(100)
    parameters.setRelativeErrorTol(1e-6)
    return parameters


def _fitting(poses: FloatArray, edges: Sequence[GraphEdge], sigmas: float) -> FloatArray:
    """(m,) 1 for the edges to believe: the chain, and closures that fit the poses."""
    closure = np.array([edge.kind == "closure" for edge in edges])
    return np.where(closure & (residual_sigmas(poses, edges) > sigmas), 0.0, 1.0)


def _reweighed(edges: Sequence[GraphEdge], weights: FloatArray) -> tuple[GraphEdge, ...]:
    return tuple(
        replace(edge, weight=float(weight)) for edge, weight in zip(edges, weights, strict=True)
    )
