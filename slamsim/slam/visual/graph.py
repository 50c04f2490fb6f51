"""A pose graph in space and its solution; here alone GTSAM's poses in space are known.

As for the graph in the plane, GTSAM returns its first guess without an error for what it cannot
solve, so that all is checked before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from slamsim.core.spatial import SpatialEdge
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.errors import SlamsimError

CAUCHY_SIGMAS = 1.0
WITHDRAW_SIGMAS = 4.5
"""Six degrees of freedom: a right closure is farther off once in 3,000."""
PATIENCE = (4.0, 2.0, 1.0, 1.0, 1.0)
"""How many times ``WITHDRAW_SIGMAS`` a closure may be off, round by round."""
DOUBTED = ("closure", "tag")
_ORDER = np.array([3, 4, 5, 0, 1, 2])
"""GTSAM has radians before metres."""
_ANCHOR_SIGMA = 1e-4
"""In metres and radians, of the first key frame, which is where the map begins: far below all
others."""


@dataclass(frozen=True, slots=True, eq=False)
class SpatialSolution:
    """poses: (n, 4, 4). edges: with weights. covariances: (n, 6, 6) of a small step of each pose in
    its own frame, metres, then radians, the first being exact."""

    poses: FloatArray
    edges: tuple[SpatialEdge, ...]
    covariances: FloatArray


def solve_in_space(poses: FloatArray, edges: Sequence[SpatialEdge]) -> SpatialSolution:
    """The solution that false closures and tags do not bend, beginning at poses (n, 4, 4), of
    which the first stays where it is.

    First Cauchy's estimator; then what does not fit is withdrawn, and may come back. Raises
    SlamsimError where there is none.
    """
    doubted = np.array([edge.kind in DOUBTED for edge in edges], dtype=np.bool_)
    everything = np.ones(len(edges), dtype=np.bool_)
    solved = _least_squares(poses, edges, everything, robust=False)
    solved = _least_squares(solved, edges, everything, robust=True)
    believed = everything
    for patience in PATIENCE:
        off = sigmas_off(solved, edges)
        believed = ~doubted | (off <= patience * WITHDRAW_SIGMAS)
        solved = _least_squares(solved, edges, believed, robust=False)
    weighed = [replace(e, weight=float(w)) for e, w in zip(edges, believed, strict=True)]
    covariances = _covariances(solved, edges, believed)
    return SpatialSolution(solved, tuple(weighed), covariances)


def sigmas_off(poses: FloatArray, edges: Sequence[SpatialEdge]) -> FloatArray:
    """(m,) standard deviations by which each edge is off from what it measured."""
    found = []
    for edge in edges:
        source = np.eye(4) if edge.kind == "floor" else poses[edge.source]
        there = np.linalg.inv(source @ edge.T_source_target) @ poses[edge.target]
        off = np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(there)))[_ORDER]
        found.append(np.sqrt(max(float(off @ np.linalg.solve(edge.covariance, off)), 0.0)))
    return np.array(found)


def _least_squares(
    poses: FloatArray, edges: Sequence[SpatialEdge], used: BoolArray, *, robust: bool
) -> FloatArray:
    graph, initial = _graph(poses, edges, used, robust=robust), _values(poses)
    before = graph.error(initial)
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph, initial, _parameters()).optimize()
    except RuntimeError as error:
        raise SlamsimError(f"the graph of the camera's path has no solution: {error}") from None
    solved = np.array([values.atPose3(k).matrix() for k in range(len(poses))])
    after = graph.error(values)
    if not (np.isfinite(solved).all() and after <= before * (1.0 + 1e-6) + 1e-6):
        raise SlamsimError(f"the graph of the camera's path has no solution: {before} to {after}")
    return solved


def _graph(
    poses: FloatArray, edges: Sequence[SpatialEdge], used: BoolArray, *, robust: bool
) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    graph.push_back(gtsam.PriorFactorPose3(0, gtsam.Pose3(poses[0]), fixed))
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SIGMAS)
    for number in np.flatnonzero(used).tolist():
        edge = edges[number]
        noise: gtsam.noiseModel.Base
        noise = gtsam.noiseModel.Gaussian.Covariance(_symmetric(edge.covariance))
        if robust and edge.kind in DOUBTED:
            noise = gtsam.noiseModel.Robust.Create(cauchy, noise)
        T = gtsam.Pose3(edge.T_source_target)
        if edge.kind == "floor":
            graph.push_back(gtsam.PriorFactorPose3(edge.target, T, noise))
        else:
            graph.push_back(gtsam.BetweenFactorPose3(edge.source, edge.target, T, noise))
    return graph


def _covariances(poses: FloatArray, edges: Sequence[SpatialEdge], used: BoolArray) -> FloatArray:
    graph, values = _graph(poses, edges, used, robust=False), _values(poses)
    try:
        marginals = gtsam.Marginals(graph, values)
        found = [marginals.marginalCovariance(k)[np.ix_(_ORDER, _ORDER)] for k in range(len(poses))]
    except (RuntimeError, IndexError) as error:
        raise SlamsimError(f"nothing holds some of the camera's path: {error}") from None
    return np.array(found)


def _symmetric(covariance: FloatArray) -> FloatArray:
    found = covariance[np.ix_(_ORDER, _ORDER)]
    return np.asarray(0.5 * (found + found.T))


def _values(poses: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for number, pose in enumerate(poses):
        values.insert(number, gtsam.Pose3(pose))
    return values


def _parameters() -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(50)
    parameters.setRelativeErrorTol(1e-6)
    return parameters
