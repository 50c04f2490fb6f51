"""The pose graph: loops with a known answer, false closures, and numbers that are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamsim.config.back_end import GraphConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import EdgeKind, GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.graph import (
    GraphUnsound,
    PoseGraphSolver,
    residual_sigmas,
    variance_factor,
)

SIGMAS = np.array([0.02, 0.02, 0.005])
COVARIANCE = np.diag(SIGMAS**2)


def edge(
    source: int, target: int, T: FloatArray, kind: EdgeKind = "match", scale: float = 1.0
) -> GraphEdge:
    return GraphEdge(source, target, T, COVARIANCE * scale, kind)


def chained(edges: list[GraphEdge]) -> FloatArray:
    poses = [np.zeros(3)]
    for one in edges:
        if one.kind != "closure":
            poses.append(compose(poses[-1], one.T_source_target))
    return np.array(poses)


def solver_of(edges: list[GraphEdge], config: GraphConfig | None = None) -> PoseGraphSolver:
    solver = PoseGraphSolver(config or GraphConfig())
    for one in edges:
        solver.add(one)
    return solver


def manhattan(
    count: int, false_share: float, seed: int
) -> tuple[FloatArray, list[GraphEdge], list[bool]]:
    """Truth (n, 3) of a walk on a street grid, its noisy edges, and which closures are false."""
    rng = np.random.default_rng(seed)
    truth = [np.zeros(3)]
    for step in range(1, count):
        turn = rng.choice([-1, 0, 1]) * np.pi / 2 if step % 5 == 0 else 0.0
        onward = compose(truth[-1], np.array([1.0, 0.0, turn]))
        if np.abs(onward[:2]).max() > 12.0:
            onward = compose(truth[-1], np.array([0.0, 0.0, np.pi / 2]))
        truth.append(onward)
    poses = np.array(truth)
    noise = rng.normal(size=(count, 3)) * SIGMAS
    edges = [
        edge(i, i + 1, compose(between(poses[i], poses[i + 1]), noise[i])) for i in range(count - 1)
    ]
    apart = np.abs(poses[:, None, :2] - poses[None, :, :2]).max(axis=-1)
    near = np.argwhere((apart < 0.5) & (np.arange(count)[None] - np.arange(count)[:, None] > 20))
    chosen = near[rng.permutation(len(near))[: count // 2]]
    false = rng.random(len(chosen)) < false_share
    for (a, b), wrong in zip(chosen.tolist(), false.tolist(), strict=True):
        if wrong:
            source, target = sorted(rng.choice(count, 2, replace=False).tolist())
            T = np.array([*rng.normal(0.0, 0.5, 2), rng.normal(0.0, 0.2)])
            edges.append(edge(source, target, T, "closure"))
        else:
            T = compose(between(poses[a], poses[b]), rng.normal(size=3) * SIGMAS)
            edges.append(edge(a, b, T, "closure"))
    return poses, edges, false.tolist()


def rms_m(solved: FloatArray, truth: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(solved[:, :2] - truth[:, :2]).sum(axis=1))))


def test_a_straight_loop_shares_its_error_evenly() -> None:
    """Along a line the answer is that of a spring chain: each edge takes an equal part."""
    edges = [edge(i, i + 1, np.array([1.0, 0.0, 0.0])) for i in range(4)]
    edges.append(edge(0, 4, np.array([4.5, 0.0, 0.0]), "closure"))
    solver = solver_of(edges, GraphConfig(withdraw_sigmas=100.0))
    solved = solver.solve(chained(edges))
    # Five equal springs in a ring with a misfit of 0.5: each is stretched by a fifth of it.
    assert np.allclose(solved[:, 0], 1.1 * np.arange(5), atol=1e-6)
    assert np.allclose(solved[:, 1:], 0.0, atol=1e-9)


def test_a_sure_edge_yields_less_than_an_unsure_one() -> None:
    edges = [
        edge(0, 1, np.array([1.0, 0.0, 0.0])),
        edge(1, 2, np.array([1.0, 0.0, 0.0]), scale=9.0),
    ]
    edges.append(edge(0, 2, np.array([2.1, 0.0, 0.0]), "closure", scale=1e-4))
    solved = solver_of(edges, GraphConfig(withdraw_sigmas=1e6)).solve(chained(edges))
    assert np.isclose(solved[1, 0], 1.01, atol=1e-4)
    assert np.isclose(solved[2, 0], 2.1, atol=1e-4)


def test_covariances_are_read_in_the_frame_of_the_source() -> None:
    """Two edges to one pose, each sure of another axis of the source, must agree on both."""
    quarter = np.pi / 2
    loose, tight = 1.0, 1e-6
    sure_x = GraphEdge(0, 1, np.array([1.0, 0.0, quarter]), np.diag([tight, loose, 1e-6]), "match")
    sure_y = GraphEdge(
        0, 1, np.array([3.0, 2.0, quarter]), np.diag([loose, tight, 1e-6]), "closure"
    )
    solver = solver_of([sure_x, sure_y], GraphConfig(withdraw_sigmas=1e6))
    solved = solver.solve(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, quarter]]))
    assert np.allclose(solved[1], [1.0, 2.0, quarter], atol=1e-4)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_third_of_false_closures_is_found_and_withdrawn(seed: int) -> None:
    truth, edges, false = manhattan(700, 0.3, seed)
    solver = solver_of(edges)
    solved = solver.solve(chained(edges))
    weights = np.array([one.weight for one in solver.edges if one.kind == "closure"])
    assert (weights[np.array(false)] == 0.0).all()
    assert np.mean(weights[~np.array(false)]) > 0.97

    without = [one for one, wrong in zip(edges, [False] * 699 + false, strict=True) if not wrong]
    best = solver_of(without).solve(truth)
    assert rms_m(solved, best) < 0.01
    assert rms_m(solved, truth) < 0.5 * rms_m(chained(edges), truth)


def test_a_renewed_chain_is_solved_and_closures_stay() -> None:
    edges = [edge(i, i + 1, np.array([1.0, 0.0, 0.0])) for i in range(4)]
    edges.append(edge(0, 2, np.array([2.0, 0.0, 0.0]), "closure"))
    solver = solver_of(edges)
    solver.update(chained(edges))
    longer = [edge(i, i + 1, np.array([1.1, 0.0, 0.0])) for i in (2, 3)]
    solver.renew(longer)
    assert [one.kind for one in solver.edges] == [one.kind for one in edges]
    assert np.allclose(solver.solve(chained(edges))[:, 0], [0.0, 1.0, 2.0, 3.1, 4.2], atol=1e-6)
    assert np.allclose(solver.update(chained(edges))[-1, 0], 4.2, atol=1e-3)
    with pytest.raises(GraphUnsound):
        solver.renew([edge(0, 1, np.array([np.nan, 0.0, 0.0]))])


def test_without_closures_the_chain_stays_as_it_was() -> None:
    _, edges, _ = manhattan(50, 0.0, 3)
    chain = [one for one in edges if one.kind == "match"]
    assert np.allclose(solver_of(chain).solve(chained(chain)), chained(chain), atol=1e-6)


def test_the_solution_on_the_way_is_near_the_full_one() -> None:
    truth, edges, _ = manhattan(400, 0.0, 5)
    chain = [one for one in edges if one.kind == "match"]
    solver = PoseGraphSolver(GraphConfig())
    estimate = np.zeros((1, 3))
    for number, one in enumerate(chain, start=1):
        solver.add(one)
        estimate = np.vstack([estimate, compose(estimate[-1], one.T_source_target)])
        for closure in edges:
            if closure.kind == "closure" and closure.target == number:
                solver.add(closure)
        if number % 10 == 0:
            estimate = solver.update(estimate)
    full = solver.solve(estimate)
    assert rms_m(estimate, full) < 0.1
    assert rms_m(estimate, truth) < 0.3 * rms_m(chained(edges), truth)


def test_an_incremental_solver_that_throws_is_built_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    _, edges, _ = manhattan(60, 0.0, 6)
    solver = solver_of(edges)
    expected = solver.update(chained(edges))

    calls = 0
    update = PoseGraphSolver._update

    def failing(self: PoseGraphSolver, poses: FloatArray) -> FloatArray:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise RuntimeError("indeterminate linear system")
        return update(self, poses)

    monkeypatch.setattr(PoseGraphSolver, "_update", failing)
    assert np.allclose(solver.update(chained(edges)), expected, atol=1e-3)
    assert calls == 2


def test_a_graph_that_nothing_holds_together_is_refused() -> None:
    loose = [edge(0, 1, np.array([1.0, 0.0, 0.0])), edge(2, 3, np.array([1.0, 0.0, 0.0]))]
    with pytest.raises(GraphUnsound, match="2 of 4 poses"):
        solver_of(loose).solve(np.zeros((4, 3)))
    with pytest.raises(GraphUnsound):
        solver_of(loose).update(np.zeros((4, 3)))


@pytest.mark.parametrize(
    "broken",
    [
        {"T_source_target": np.array([np.nan, 0.0, 0.0])},
        {"T_source_target": np.array([np.inf, 0.0, 0.0])},
        {"covariance": np.full((3, 3), np.nan)},
        {"covariance": np.zeros((3, 3))},
        {"covariance": -COVARIANCE},
        {"covariance": np.diag([1e30, 1.0, 1.0])},
        {"covariance": COVARIANCE + np.array([[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]])},
        {"target": 0},
        {"source": -1},
    ],
)
def test_an_edge_that_measures_nothing_is_refused(broken: dict[str, object]) -> None:
    bad = replace(edge(0, 1, np.array([1.0, 0.0, 0.0])), **broken)  # type: ignore[arg-type]
    with pytest.raises(GraphUnsound):
        PoseGraphSolver(GraphConfig()).add(bad)


def test_poses_that_are_none_are_refused() -> None:
    solver = solver_of([edge(0, 1, np.array([1.0, 0.0, 0.0]))])
    with pytest.raises(GraphUnsound, match="finite"):
        solver.solve(np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]))
    with pytest.raises(GraphUnsound, match="beyond"):
        solver.solve(np.zeros((1, 3)))
    with pytest.raises(GraphUnsound):
        PoseGraphSolver(GraphConfig()).solve(np.zeros((0, 3)))


def test_a_single_pose_is_its_own_solution() -> None:
    assert np.array_equal(PoseGraphSolver(GraphConfig()).solve(np.ones((1, 3))), np.ones((1, 3)))


def test_residuals_are_counted_in_standard_deviations() -> None:
    off = edge(0, 1, np.array([1.0 + 3.0 * SIGMAS[0], 0.0, 0.0]))
    around = edge(0, 1, np.array([1.0, 0.0, 2.0 * np.pi - SIGMAS[2]]))
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.allclose(residual_sigmas(poses, [off, around]), [3.0, 1.0])


def test_claims_that_are_too_modest_are_found_so_by_the_variance_factor() -> None:
    truth, edges, _ = manhattan(400, 0.0, 8)
    honest = solver_of(edges)
    factor = variance_factor(honest.solve(truth), honest.edges)
    modest = solver_of([replace(one, covariance=100.0 * one.covariance) for one in edges])
    assert np.isclose(variance_factor(modest.solve(truth), modest.edges), factor / 100.0, rtol=0.05)
    assert variance_factor(truth[:2], edges[:1]) == 1.0
