"""Poses, tags and shared errors solved together, against SciPy's least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import Generator
from scipy.optimize import least_squares

from slamsim.config.back_end import GraphConfig
from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.landmarks.joint import SHARED, JointSolver, Ties

NODES, TAGS = 6, 3
NO_SURFACES = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3, 3))


def _edge(rng: Generator, poses: FloatArray, ends: tuple[int, int], kind: str) -> GraphEdge:
    covariance = np.diag(rng.uniform(1e-6, 1e-4, 3))
    step = between(poses[ends[0]], poses[ends[1]])
    step = step + np.sqrt(np.diag(covariance)) * rng.normal(size=3)
    return GraphEdge(*ends, step, covariance, "closure" if kind == "view" else "odometry")


def _ties(rng: Generator, poses: FloatArray) -> Ties:
    chain = [_edge(rng, poses, (k, k + 1), "step") for k in range(NODES - 1)]
    views = [
        _edge(rng, poses, (k, NODES + tag), "view") for k in range(NODES) for tag in range(TAGS)
    ]
    slopes = np.zeros((len(chain) + len(views), 3, SHARED))
    slopes[len(chain) :] = rng.normal(size=(len(views), 3, SHARED))
    cameras = np.array([-1] * len(chain) + [0] * len(views))
    sigmas = rng.uniform(0.001, 0.01, (1, SHARED))
    return Ties((*chain, *views), cameras, slopes, sigmas, NO_SURFACES, poses)


@pytest.mark.parametrize("fits_two_ways", [False, True])
def test_the_solution_is_that_of_scipy(fits_two_ways: bool) -> None:
    """A tag that fits two ways seems to face half a radian off, and claims a radian."""
    rng = np.random.default_rng(5)
    true = rng.uniform(-2.0, 2.0, (NODES + TAGS, 3))
    ties = _ties(rng, true)
    if fits_two_ways:
        ties = replace(ties, edges=[_turned(edge) for edge in ties.edges])
    begun = compose(true, rng.normal(size=true.shape) * 0.02)
    begun[0] = true[0]

    def residuals(values: FloatArray) -> FloatArray:
        poses = np.concatenate([true[:1], values[:-SHARED].reshape(-1, 3)])
        found = [values[-SHARED:] / ties.sigmas[0]]
        for edge, camera, slopes in zip(ties.edges, ties.cameras, ties.slopes, strict=True):
            off = between(edge.T_source_target, between(poses[edge.source], poses[edge.target]))
            if camera >= 0:  # noise is of lengths as they were measured
                off = (off - slopes @ values[-SHARED:]) / [1.0 + values[-1], 1.0 + values[-1], 1.0]
            turn = adjoint(np.array([0.0, 0.0, -edge.T_source_target[2]]))
            root = np.linalg.cholesky(np.linalg.inv(turn @ edge.covariance @ turn.T))
            found.append(root.T @ off)
        return np.concatenate(found)

    values = np.concatenate([begun[1:].ravel(), np.zeros(SHARED)])
    best = least_squares(residuals, values, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    solver = JointSolver(ties, begun, 0)
    solver.relax()
    off = between(np.concatenate([true[:1], best.x[:-SHARED].reshape(-1, 3)]), solver.poses)
    sigmas = np.sqrt(np.diagonal(solver.covariances(0), axis1=1, axis2=2))[1:]
    assert np.abs(off[1:] / sigmas).max() < 0.01
    jacobian = np.asarray(best.jac, dtype=np.float64)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    assert np.allclose(sigmas[:, 2], np.sqrt(np.diag(covariance)[2:-SHARED:3]), rtol=0.02)


def _turned(edge: GraphEdge) -> GraphEdge:
    """A view whose heading is half a radian off to either side, and counts for next to nothing."""
    if edge.kind != "closure":
        return edge
    by_rad = 0.5 if edge.source % 3 else -0.8
    covariance = edge.covariance.copy()
    covariance[2, 2] = 1.0
    return replace(
        edge,
        T_source_target=edge.T_source_target + np.array([0.0, 0.0, by_rad]),
        covariance=covariance,
    )


def test_what_edges_claim_and_what_a_solution_fits_are_those_of_dense_matrices() -> None:
    rng = np.random.default_rng(8)
    true = rng.uniform(-2.0, 2.0, (NODES + TAGS, 3))
    ties = _ties(rng, true)
    solver = JointSolver(ties, true, 0)
    solver.relax()
    those = np.array([0, 3, 4])
    off, claimed, fitted = solver.fit_of(those)

    _, believed, parts = solver._linear()
    rows = np.zeros((len(ties.edges), 3, 3 * (solver._unknowns + 1)))
    for number, slopes in parts:
        for k, column in enumerate(number):
            rows[k, :, 3 * column : 3 * column + 3] += slopes[k]
    rows = rows[:, :, :-3]
    prior = np.zeros(rows.shape[2])
    prior[-SHARED:] = 1.0 / np.square(ties.sigmas[0])
    normal = np.einsum("mia,mij,mjb->ab", rows, believed, rows) + np.diag(prior)
    covariance = np.linalg.inv(normal)
    for place, k in enumerate(those):
        assert np.allclose(fitted[place], rows[k] @ covariance @ rows[k].T, rtol=1e-4, atol=1e-12)
        assert np.allclose(claimed[place], np.linalg.inv(believed[k]))
        assert np.allclose(off[place] @ believed[k] @ off[place], solver._sigmas()[k] ** 2)


def test_surfaces_say_nothing_of_where_a_map_lies() -> None:
    rng = np.random.default_rng(6)
    poses = rng.uniform(-2.0, 2.0, (4, 3))
    ties = _with_surfaces(rng, poses)
    for moved in (poses, compose(np.array([5.0, -3.0, 2.0]), poses)):
        assert np.abs(JointSolver(ties, moved, 0)._gradient()).max() < 1e-6
    bent = poses.copy()
    bent[2:] = compose(np.array([0.01, 0.0, 0.0]), bent[2:])
    solver = JointSolver(ties, bent, 0)
    solver.relax()
    assert np.allclose(solver.poses, poses, atol=1e-6)


def _with_surfaces(rng: Generator, poses: FloatArray) -> Ties:
    """Views of many walls: each tells how far its pose is from it, whichever way the wall lies."""
    count = len(poses)
    dense = np.zeros((3 * count, 3 * count))
    for _ in range(30):
        towards = rng.uniform(0.0, 2.0 * np.pi)
        normal = np.array([np.cos(towards), np.sin(towards), rng.uniform(-3.0, 3.0)])
        rows = np.stack([normal @ adjoint(pose) for pose in poses])  # wall's offset, by each pose
        each = np.zeros((count, 3 * count))
        for k in range(count):
            each[k, 3 * k : 3 * k + 3] = rows[k]
        each -= each.mean(axis=0)  # the wall itself is free
        dense += 1e6 * each.T @ each
    pairs = np.array([(a, b) for a in range(count) for b in range(count)])
    known = np.array([dense[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] for a, b in pairs])
    loose = [GraphEdge(0, k, between(poses[0], poses[k]), np.eye(3), "odometry") for k in (1, 2, 3)]
    none = np.zeros((len(loose), 3, SHARED))
    cameras = np.full(len(loose), -1)
    return Ties(loose, cameras, none, np.zeros((0, SHARED)), (pairs, known), poses)


def test_a_solution_that_went_astray_begins_again() -> None:
    """Edges that are withdrawn by now led there."""
    rng = np.random.default_rng(9)
    true = rng.uniform(-2.0, 2.0, (NODES + TAGS, 3))
    ties = _ties(rng, true)
    solver, astray = JointSolver(ties, true, 0), JointSolver(ties, true, 0)
    astray.poses = rng.uniform(-1e6, 1e6, true.shape)
    astray.poses[0] = true[0]
    astray.shared = astray.shared + 5.0
    for each in (solver, astray):
        each.relax()

    assert astray.settled
    assert np.allclose(astray.poses, solver.poses, atol=1e-6)


def test_a_view_of_another_tag_is_withdrawn() -> None:
    rng = np.random.default_rng(7)
    true = rng.uniform(-2.0, 2.0, (NODES + TAGS, 3))
    ties = _ties(rng, true)
    edges = list(ties.edges)
    elsewhere = edges[-1].T_source_target + np.array([1.0, 0.0, 0.0])
    edges[-1] = replace(edges[-1], T_source_target=elsewhere)
    solver = JointSolver(replace(ties, edges=edges), true, 0)
    solver.weigh(GraphConfig())
    solver.relax()
    solver.doubt(GraphConfig())
    assert solver.weights[-1] == 0.0
    assert solver.weights[:-1].all()
