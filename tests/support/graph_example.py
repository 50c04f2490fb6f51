"""Pose graphs as SLAM makes them, long and badly conditioned ones too, and slow exact answers."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.graph import _factor, _noise
from slamsim.slam.backend.marginals import edge_covariances

Wide = np.ndarray[Any, np.dtype[np.longdouble]]

MATCHED = np.diag(np.square([0.003, 0.003, 0.001]))
CARRIED = np.diag(np.square([10.0, 10.0, 2.0]))


def chained(poses: FloatArray) -> list[tuple[int, int]]:
    return [(k, k + 1) for k in range(len(poses) - 1)]


def joined(
    poses: FloatArray,
    pairs: list[tuple[int, int]],
    weak: tuple[tuple[int, int], ...] = (),
    rng: np.random.Generator | None = None,
) -> list[GraphEdge]:
    """Edges that measure what is so; rng: with covariances that differ and lean."""
    edges = []
    for a, b in pairs:
        covariance = CARRIED if (a, b) in weak else MATCHED
        if rng is not None:
            root = np.linalg.cholesky(covariance) @ (np.eye(3) + 0.5 * rng.normal(size=(3, 3)))
            covariance = root @ root.T + 1e-3 * covariance
        edges.append(GraphEdge(a, b, between(poses[a], poses[b]), covariance, "match"))
    return edges


def ring(count: int, length_m: float, far_m: float = 0.0) -> FloatArray:
    """(count, 3) poses around a circle of that length, its middle that far from the origin."""
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radius_m = length_m / (2.0 * np.pi)
    x, y = far_m + radius_m * np.cos(turn), far_m + radius_m * np.sin(turn)
    return np.column_stack([x, y, turn + 0.5 * np.pi])


def wandering(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) poses half a metre apart."""
    poses = np.zeros((count, 3))
    for k in range(1, count):
        poses[k] = compose(poses[k - 1], np.array([0.5, 0.0, 0.4 * rng.normal()]))
    return poses


def along_the_chain(poses: FloatArray, edges: list[GraphEdge]) -> FloatArray:
    """(n, 3, 3) relative to the first pose, edges joining each to the next: sums, step by step."""
    found = np.zeros((len(poses), 3, 3))
    for k, added in enumerate(edge_covariances(edges), start=1):
        carry = adjoint(between(poses[k], poses[k - 1]))
        found[k] = carry @ found[k - 1] @ carry.T + added
    return found


def by_gtsam(poses: FloatArray, edges: list[GraphEdge], some: list[int]) -> FloatArray:
    """(k, 3, 3) covariances of some poses relative to the first by GTSAM's elimination."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    exact = gtsam.noiseModel.Constrained.All(3)
    graph.push_back(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0]), exact))
    for edge in edges:
        graph.push_back(_factor(edge, _noise(edge)))
    for number, pose in enumerate(poses):
        values.insert(number, gtsam.Pose2(*pose))
    marginals = gtsam.Marginals(graph, values)
    return np.array([marginals.marginalCovariance(number) for number in some])


def off(found: FloatArray, expected: FloatArray) -> float:
    """The largest difference, in units of the standard deviations of row and column."""
    sigma = np.sqrt(np.einsum("nii->ni", expected))
    return float((np.abs(found - expected) / (sigma[:, :, None] * sigma[:, None, :])).max())


def by_long_double(poses: FloatArray, edges: list[GraphEdge]) -> FloatArray:
    """(n, 3, 3) relative to the first pose: the whole system, inverted with 64 bits of mantissa."""
    size = 3 * len(poses)
    system = np.zeros((size, size), np.longdouble)
    wide = poses.astype(np.longdouble)
    for edge in edges:
        a, b = edge.source, edge.target
        rows = np.zeros((3, size), np.longdouble)
        x, y, between_yaw = wide[a] - wide[b]
        rows[:, 3 * a : 3 * a + 3] = -_carry(x, y, between_yaw, wide[b, 2])
        rows[:, 3 * b : 3 * b + 3] = np.eye(3)
        turn = np.longdouble(-edge.T_source_target[2])
        to_target = _carry(np.longdouble(0.0), np.longdouble(0.0), turn, turn * 0)
        covariance = to_target @ edge.covariance.astype(np.longdouble) @ to_target.T
        both = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        known = rows[:, both].T @ _inverse(covariance) @ rows[:, both]
        system[np.ix_(both, both)] += known
    inverse = _inverse(system[3:, 3:])
    found = np.zeros((len(poses), 3, 3))
    for k in range(1, len(poses)):
        own = slice(3 * k - 3, 3 * k)
        found[k] = inverse[own, own]
    return found


def _carry(x: np.longdouble, y: np.longdouble, turn: np.longdouble, yaw: np.longdouble) -> Wide:
    """As ``adjoint`` of a pose given by differences in the map and the yaw of the other."""
    cos, sin, one = np.cos(yaw), np.sin(yaw), np.longdouble(1.0)
    forward, left = cos * x + sin * y, cos * y - sin * x
    rows = [[np.cos(turn), -np.sin(turn), left], [np.sin(turn), np.cos(turn), -forward]]
    return np.array([*rows, [0 * one, 0 * one, one]], np.longdouble)


def _inverse(matrix: Wide) -> Wide:
    """By Cholesky's decomposition, for NumPy has none of this precision."""
    left, right = matrix.copy(), np.eye(len(matrix), dtype=np.longdouble)
    for k in range(len(matrix)):
        assert left[k, k] > 0.0
        root = left[k:, k] / np.sqrt(left[k, k])
        left[k + 1 :, k + 1 :] -= np.outer(root[1:], root[1:])
        right[k] /= root[0]
        right[k + 1 :] -= np.outer(root[1:], right[k])
    return np.asarray(right.T @ right)
