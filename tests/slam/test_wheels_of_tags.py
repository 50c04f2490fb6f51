"""What wheels get wrong along a path that tags hold."""

from __future__ import annotations

import numpy as np
import pytest

from slamsim.core.geometry import between, compose
from slamsim.core.result import GraphEdge
from slamsim.models.wheel_gyro import walk
from slamsim.slam.landmarks.joint import SHARED, JointSolver, Ties
from slamsim.slam.landmarks.wheels import learnt_noise, wheel_slopes


@pytest.mark.parametrize(("forward_m", "turned_rad"), [(0.3, 0.2), (0.5, -0.9), (-0.4, 0.3)])
def test_errors_of_wheels_move_a_step_as_integrating_them_says(
    forward_m: float, turned_rad: float
) -> None:
    pieces = 50
    steps = np.tile([forward_m, 0.0, turned_rad, np.nan], (pieces, 1)) / pieces
    stamps_ns = np.arange(pieces + 1) * 10_000_000
    poses, jacobian = np.zeros((pieces + 1, 3)), np.zeros((4, 5))
    walk(stamps_ns, steps, 0, int(stamps_ns[-1]), np.zeros(5), 0.0, poses, jacobian, np.zeros(5))
    found = wheel_slopes(GraphEdge(0, 1, poses[-1], np.eye(3), "odometry"))

    expected = jacobian[:3, [1, 2, 0]]
    assert np.allclose(found[:, [0, 1, -1]], expected, atol=0.002 * abs(forward_m))
    assert not found[:, 2:-1].any()


@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
def test_noise_of_wheels_is_learnt_where_no_scan_tells_it(factor: float) -> None:
    """Steps assumed to be as sure as 20 mm; each pose is seen from one that is known."""
    rng, count = np.random.default_rng(4), 200
    true = np.cumsum(np.tile([0.3, 0.0, 0.05], (count, 1)), axis=0)
    sigmas = np.array([0.02, 0.01, 0.01])
    noises = factor * sigmas * rng.normal(size=(count - 1, 3))
    steps = [
        GraphEdge(
            k, k + 1, between(true[k], true[k + 1]) + noises[k], np.diag(sigmas**2), "odometry"
        )
        for k in range(count - 1)
    ]
    views = [
        GraphEdge(
            0,
            k,
            between(true[0], true[k]) + rng.normal(0.0, 0.002, 3),
            4e-6 * np.eye(3),
            "closure",
        )
        for k in range(1, count)
    ]
    nothing = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3, 3))
    edges = (*steps, *views)
    none = np.zeros((len(edges), 3, SHARED))
    ties = Ties(edges, np.full(len(edges), -1), none, np.zeros((0, SHARED)), nothing, true)
    solver, blind = JointSolver(ties, true, 0), np.ones(len(steps), np.bool_)
    for _ in range(10):
        solver.relax()
        learnt = learnt_noise(steps, blind, solver)
        solver.measure((*learnt, *views))
    found = np.sqrt(np.diag(learnt[7].covariance))

    assert np.allclose(found, factor * sigmas, rtol=0.25)
    assert np.allclose(
        compose(solver.poses[0], learnt[0].T_source_target)[:2], true[1, :2], atol=0.3
    )
