"""The pose graph and its solution; the only place that knows GTSAM.

GTSAM's Levenberg-Marquardt returns its initial values, without an error, when it meets a number
that is not finite, a covariance that is none, or poses that nothing holds. All of that is
therefore checked before and after each solve.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace
from itertools import compress

import gtsam
import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from slamsim.config.back_end import GraphConfig
from slamsim.core.geometry import between, rotation, wrap_angle
from slamsim.core.result import GraphEdge
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import is_sound

_Factor = gtsam.BetweenFactorPose2

EIGENVALUE_BOUNDS = (1e-14, 1e12)
PATIENCE = (4.0, 2.0)
"""How many times ``withdraw_sigmas`` a closure may be off in the first rounds."""

MAX_WITHDRAWALS = 8
EXTRA_UPDATES = 2
RISE_ALLOWED = 1e-6
"""Share by which solving may raise the error of the graph: what rounding does, and no more."""
MOST_POSES = 10_000_000
CLOSURES_TO_TELL = 10
CLOSURES_PER_EVIDENCE = 5.0
"""Closures that share most of their scans and so count as one measurement. Chosen, not fitted: it
scales the variances that are reported, and no pose."""
LEAST_VARIANCE_FACTOR = 1e-4
"""Of noiseless edges, so that no covariance becomes singular."""


class GraphUnsound(SlamsimError):
    """A pose graph that has no solution: a number not finite, a covariance that is none, poses
    that nothing joins to the first, or a solver that did not make it better."""


class PoseGraphSolver:
    """Poses joined by edges: solved roughly and at once while they come, fully in the end.

    On the way ISAM2 (Kaess et al. 2012) keeps the solution up to date, closures weighed by
    Cauchy's estimator; an ISAM2 that ever throws is thrown away and built anew. The final
    solution is Levenberg and Marquardt's on everything.
    """

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self._cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(config.cauchy_width)
        self.edges: list[GraphEdge] = []
        """All edges so far, in the order they came."""
        self._factors: list[_Factor] = []  # closures as ones that may be doubted
        self._joined = DisjointSet([0])
        self._held: FloatArray | None = None
        self._isam: gtsam.ISAM2 | None = None
        self._entered_edges = self._entered_poses = 0

    def hold(self, poses: FloatArray) -> None:
        """The first poses (n, 3) of the graph are known: not only the first one stays."""
        self._held = poses.copy()

    def add(self, edge: GraphEdge) -> None:
        """One more measurement. Raises GraphUnsound if it is none."""
        check_edges([edge])
        self.edges.append(edge)
        for number in range(len(self._joined), max(edge.source, edge.target) + 1):
            self._joined.add(number)
        self._joined.merge(edge.source, edge.target)
        self._factors.append(self._factor(edge))

    def renew(self, edges: Sequence[GraphEdge]) -> None:
        """Put these in the place of the edges that joined the same poses; closures stay.

        Raises GraphUnsound if one is no measurement.
        """
        check_edges(edges)
        renewed = {(edge.source, edge.target): edge for edge in edges}
        for number, edge in enumerate(self.edges):
            fresh = renewed.get((edge.source, edge.target))
            if fresh is not None and edge.kind != "closure":
                self.edges[number] = fresh
                self._factors[number] = self._factor(fresh)
        self._isam = None  # it has the old ones

    def forget(self, ends: Container[tuple[int, int]]) -> None:
        """Take out the closures that join these pairs of poses."""
        kept = [e.kind != "closure" or (e.source, e.target) not in ends for e in self.edges]
        self.edges = list(compress(self.edges, kept))
        self._factors = list(compress(self._factors, kept))
        self._isam = None

    def begin_anew(self) -> None:
        """The next update takes all poses as they are given, for some were carried elsewhere."""
        self._isam = None

    def update(self, poses: FloatArray) -> FloatArray:
        """(n, 3) the solution by now, given poses (n, 3) of which only new ones are looked at.

        Raises GraphUnsound.
        """
        check_joined(poses, self._joined)  # ISAM2 leaves poses that nothing holds where they are
        try:
            return self._update(poses)
        except RuntimeError:  # GTSAM's; the object goes on unoptimised after it
            self._isam = None
        try:
            return self._update(poses)
        except RuntimeError:
            self._isam = None
        return self.solve(poses)  # it copes with what is nearly undetermined

    def _update(self, poses: FloatArray) -> FloatArray:
        if self._isam is None:
            self._isam = gtsam.ISAM2(_isam_parameters())
            self._entered_edges = self._entered_poses = 0
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if self._entered_poses == 0:
            self._anchor(graph, poses)
        for number in range(self._entered_poses, len(poses)):
            values.insert(number, gtsam.Pose2(*poses[number]))
        for factor in self._factors[self._entered_edges :]:
            graph.push_back(factor)
        self._isam.update(graph, values)
        self._entered_edges, self._entered_poses = len(self.edges), len(poses)
        for _ in range(EXTRA_UPDATES):
            self._isam.update()
        solved = gtsam.utilities.extractPose2(self._isam.calculateEstimate())
        if not np.isfinite(solved).all():
            raise RuntimeError("the incremental solution is not finite")
        return np.asarray(solved, dtype=np.float64)

    def solve(self, poses: FloatArray) -> FloatArray:
        """(n, 3) the solution that false closures do not bend; ``edges`` get their weights.

        First Cauchy's estimator, which recovers from many false closures at once; then closures
        that do not fit are withdrawn and the rest solved by least squares, until it is the same
        ones that fit. At first only those far off go, since a true closure that Cauchy gave up
        can pull the poses to itself; a closure may always come back. Raises GraphUnsound.
        """
        check_joined(poses, self._joined)
        closure = np.array([edge.kind == "closure" for edge in self.edges], dtype=np.bool_)
        everything = np.ones(len(self.edges), dtype=np.bool_)
        solved = self._least_squares(poses, everything, self._factors)
        plain = [
            _factor(edge, _noise(edge)) if doubted else factor
            for edge, doubted, factor in zip(self.edges, closure, self._factors, strict=True)
        ]
        believed = np.zeros_like(everything)
        for patience in (*PATIENCE, *[1.0] * MAX_WITHDRAWALS):
            sigmas = residual_sigmas(solved, self.edges)
            fitting = ~closure | (sigmas <= patience * self._config.withdraw_sigmas)
            if patience == 1.0 and np.array_equal(fitting, believed):
                break
            believed = fitting
            solved = self._least_squares(solved, believed, plain)
        self.edges = [
            replace(edge, weight=float(weight))
            for edge, weight in zip(self.edges, believed, strict=True)
        ]
        return solved

    def _factor(self, edge: GraphEdge) -> _Factor:
        """The edge as the solver takes it; a closure as one that may be doubted."""
        noise = _noise(edge)
        if edge.kind != "closure":
            return _factor(edge, noise)
        return _factor(edge, gtsam.noiseModel.Robust.Create(self._cauchy, noise))

    def _anchor(self, graph: gtsam.NonlinearFactorGraph, poses: FloatArray) -> None:
        """Hold the poses that are known where they are, or the first if none is."""
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-4))
        for number, pose in enumerate(poses[:1] if self._held is None else self._held):
            graph.push_back(gtsam.PriorFactorPose2(number, gtsam.Pose2(*pose), noise))

    def _least_squares(
        self, poses: FloatArray, used: BoolArray, factors: Sequence[_Factor]
    ) -> FloatArray:
        """Levenberg and Marquardt's solution, checked."""
        if len(poses) == 1:
            return poses.copy()
        graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._anchor(graph, poses)
        for number in np.flatnonzero(used).tolist():
            graph.push_back(factors[number])
        for number, pose in enumerate(poses):
            initial.insert(number, gtsam.Pose2(*pose))
        before = graph.error(initial)
        values = gtsam.LevenbergMarquardtOptimizer(graph, initial, _batch_parameters()).optimize()
        after = graph.error(values)
        solved = np.asarray(gtsam.utilities.extractPose2(values), dtype=np.float64)
        if not (np.isfinite(after) and np.isfinite(solved).all()):
            raise GraphUnsound(f"the solution of the pose graph is not finite (error {after})")
        if after > before * (1.0 + RISE_ALLOWED) + RISE_ALLOWED:
            raise GraphUnsound(f"solving raised the pose graph's error: {before} to {after}")
        return solved


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


def variance_factor(poses: FloatArray, edges: Sequence[GraphEdge]) -> float:
    """By how much the variances of the edges should be multiplied to agree with their residuals.

    The a-posteriori variance of unit weight: the sum of squared residuals over the redundancy,
    which is three for each believed closure that is independent of the others. Closures of
    neighbouring key frames share most of their scans. 1 where there are too few to tell. poses: (n,
    3).
    """
    believed = [edge for edge in edges if edge.weight > 0.0]
    closures = sum(edge.kind == "closure" for edge in believed)
    if closures < CLOSURES_TO_TELL:
        return 1.0
    squares = float(np.square(residual_sigmas(poses, believed)).sum())
    return max(squares * CLOSURES_PER_EVIDENCE / (3.0 * closures), LEAST_VARIANCE_FACTOR)


def check_edges(edges: Sequence[GraphEdge]) -> None:
    """Raise GraphUnsound unless all is finite and covariances are symmetric and positive."""
    for edge in edges:
        ends = f"edge {edge.source} to {edge.target} of the pose graph"
        covariance = edge.covariance
        ordered = sorted((edge.source, edge.target))
        if not 0 <= ordered[0] < ordered[1] < MOST_POSES:
            raise GraphUnsound(f"{ends} joins no two poses")
        if edge.T_source_target.shape != (3,) or covariance.shape != (3, 3):
            raise GraphUnsound(f"{ends} is no step in the plane with a covariance")
        if not (is_sound(edge.T_source_target).all() and is_sound(covariance).all()):
            raise GraphUnsound(f"{ends} is not finite, or leads too far")
        if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12):
            raise GraphUnsound(f"{ends} has a covariance that is not symmetric")
        least, _, most = np.linalg.eigvalsh(covariance).tolist()
        if least < EIGENVALUE_BOUNDS[0] or most > EIGENVALUE_BOUNDS[1]:
            raise GraphUnsound(
                f"{ends} has a covariance with eigenvalues {least:.3g} to {most:.3g}; "
                f"allowed are {EIGENVALUE_BOUNDS[0]:.0e} to {EIGENVALUE_BOUNDS[1]:.0e}"
            )


def check_joined(poses: FloatArray, joined: DisjointSet[int]) -> None:
    """Raise GraphUnsound unless the poses are finite and all joined to the first. poses: (n, 3)."""
    count = len(poses)
    if count == 0 or not is_sound(poses).all():
        raise GraphUnsound(f"not all of the {count} poses of the graph are finite, or they are far")
    if len(joined) > count:
        raise GraphUnsound(f"an edge leads beyond the {count} poses of the graph")
    loose = count - joined.subset_size(0)
    if loose:
        raise GraphUnsound(f"{loose} of {count} poses of the graph are not joined to the first")


def _factor(edge: GraphEdge, noise: gtsam.noiseModel.Base) -> _Factor:
    return _Factor(edge.source, edge.target, gtsam.Pose2(*edge.T_source_target), noise)


def _noise(edge: GraphEdge) -> gtsam.noiseModel.Gaussian:
    # GTSAM's covariances are those of a step in the frame of the target.
    turn = rotation(np.asarray(-edge.T_source_target[2]))
    covariance = turn @ edge.covariance @ turn.T
    return gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))


def _isam_parameters() -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.02)
    parameters.relinearizeSkip = 1
    return parameters


def _batch_parameters() -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(100)
    parameters.setRelativeErrorTol(1e-6)
    return parameters
