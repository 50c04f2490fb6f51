"""Uncertainties of long, far and badly joined graphs, against sums, dense inverses and GTSAM."""

from __future__ import annotations

import numpy as np
import pytest
from graph_example import (
    CARRIED,
    along_the_chain,
    by_gtsam,
    chained,
    joined,
    off,
    ring,
    wandering,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.geometry import adjoint, between, compose, inverse, rotation
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.models.blocks import factorise
from slamsim.models.supernodes import add_block, empty_system, make_panels
from slamsim.slam.backend.bridges import find_bridges
from slamsim.slam.backend.estimate import Estimate
from slamsim.slam.backend.marginals import edge_covariances, graph_factor, relative_covariances

AGREED = 1e-6


def fill_by_sets(place: IntArray, pairs: IntArray, count: int) -> list[list[int]]:
    """Rows below the diagonal of each column of the factor: eliminated one after the other."""
    columns: list[set[int]] = [set() for _ in range(count)]
    for a, b in np.sort(place[pairs], axis=1).tolist():
        columns[a] |= {b} - {a}
    for rows in columns:
        if rows:
            columns[min(rows)] |= rows - {min(rows)}
    return [sorted(rows) for rows in columns]


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(0, 60))
def test_the_pattern_is_that_of_elimination(seed: int, count: int, loops: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = np.concatenate([chained(np.zeros(count + 1)), rng.integers(0, count + 1, (loops, 2))])
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    panels = make_panels(pairs, count)
    assert sorted(panels.place[:-1].tolist()) == list(range(count)) and panels.place[-1] == count
    expected = fill_by_sets(panels.place, pairs[(pairs < count).all(axis=1)], count)
    for panel, (begin, end) in enumerate(zip(panels.first[:-1], panels.first[1:], strict=True)):
        below = panels.below[panels.starts[panel] : panels.starts[panel + 1]].tolist()
        assert below == expected[end - 1]
        for column in range(begin, end):
            assert {row for row in expected[column] if row >= end} <= set(below)


def test_an_entry_that_the_panels_have_no_place_for_is_not_written_elsewhere() -> None:
    panels = make_panels(np.array([(0, 1), (1, 2), (2, 3)]), 4)
    system = empty_system(panels)
    with pytest.raises(IndexError, match="no entry"):
        add_block(panels, system, 0, 3, np.eye(3))
    assert not system.any()


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan, np.inf])
def test_a_system_without_a_solution_names_the_key_frame(bad: float) -> None:
    count = 30
    panels = make_panels(np.array(chained(np.zeros(count))), count)
    system = empty_system(panels)
    for unknown in range(count):
        diagonal = np.array([1.0, bad if unknown == 11 else 1.0, 1.0])
        add_block(panels, system, unknown, unknown, np.diag(diagonal))
    with pytest.raises(NoSolution, match="key frame 111") as refusal:
        factorise(panels, system, np.arange(100, 130))
    assert refusal.value.keyframe == 111


@pytest.mark.long
@pytest.mark.parametrize("count", [900, 2000, 6000])
def test_a_chain_without_closures_has_the_sum_of_its_steps(count: int) -> None:
    """Entries of the factor shrink along it; they vanished after some 740 key frames."""
    poses = wandering(np.random.default_rng(count), count)
    edges = joined(poses, chained(poses), rng=np.random.default_rng(1))
    expected = along_the_chain(poses, edges)
    assert off(relative_covariances(poses, edges, 0)[1:], expected[1:]) < 1e-9
    # Solved for, rounding leaves less: the condition number grows with the cube of the length.
    assert off(graph_factor(poses, edges).inverse_diagonal(), expected[1:]) < 1e-4


@pytest.mark.parametrize(("length_m", "agreed"), [(1000.0, AGREED), (5000.0, 30.0 * AGREED)])
def test_a_ring_of_kilometres_is_as_sure_as_both_paths_around_it(
    length_m: float, agreed: float
) -> None:
    """Each pose by the sum of one path, and that of the other: two measurements of one thing.

    At 5 km GTSAM's elimination finds the system indeterminate; ours keeps nearly five digits, by
    processor: rounding left less than 1e-5 on one and 1.2e-5 on another.
    """
    count = 2000
    poses = ring(count, length_m, far_m=500.0)
    edges = joined(poses, [*chained(poses), (0, count - 1)], rng=np.random.default_rng(1))
    found = relative_covariances(poses, edges, 0)
    back = [edges[-1], *[reversed_edge(edge) for edge in edges[-2:0:-1]]]
    order = np.append(0, np.arange(count - 1, 0, -1))
    one = along_the_chain(poses, edges[:-1])[1:]
    other = along_the_chain(poses[order], back)[:0:-1]
    expected = np.linalg.inv(np.linalg.inv(one) + np.linalg.inv(other))
    assert off(found[1:], expected) < agreed


def test_a_ring_with_chords_is_as_sure_as_gtsam_says() -> None:
    poses = ring(2000, 1000.0, far_m=500.0)
    edges = joined(poses, [*chained(poses), (0, 1999), (3, 1990), (500, 1500)])
    some = [1, 10, 499, 750, 1000, 1501, 1999]
    found = relative_covariances(poses, edges, 0)[some]
    assert off(found, by_gtsam(poses, edges, some)) < AGREED


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_random_graphs_agree_with_gtsam(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, loops = int(rng.integers(2, 60)), int(rng.integers(0, 80))
    poses = compose(rng.uniform(-500.0, 500.0, 3), wandering(rng, count))
    pairs = [tuple(sorted(rng.integers(0, count, 2).tolist())) for _ in range(loops)]
    pairs = [*chained(poses), *[pair for pair in pairs if pair[0] < pair[1]]]
    weak = tuple(pair for pair in pairs if rng.random() < 0.05 and pair[1] - pair[0] > 1)
    edges = joined(poses, pairs, weak, rng)
    some = list(range(1, count))
    found = relative_covariances(poses, edges, 0)[1:]
    assert off(found, by_gtsam(poses, edges, some)) < AGREED


@pytest.mark.parametrize("far_m", [0.0, 500.0, 5000.0])
def test_parts_that_one_weak_edge_joins_are_as_sure_as_apart(far_m: float) -> None:
    """Each part solved for itself, and the weak edges between them added up."""
    poses = ring(300, 1000.0, far_m)
    weak = ((99, 100), (199, 200))
    within = [(0, 80), (110, 190), (210, 290)]
    edges = joined(poses, [*chained(poses), *within], weak)
    found = relative_covariances(poses, edges, 0)
    expected = np.zeros((300, 3, 3))
    for first in (0, 100, 200):
        part = slice(first, first + 100)
        apart = joined(poses[part], [*chained(poses[part]), *[(10, 90)] * (first > 0)])
        if first == 0:
            apart = joined(poses[part], [*chained(poses[part]), (0, 80)])
        else:
            before = adjoint(between(poses[first], poses[first - 1]))
            link = edge_covariances([edge for edge in edges if edge.target == first][:1])[0]
            expected[first] = before @ expected[first - 1] @ before.T + link
        carry = adjoint(between(poses[part], poses[first]))
        expected[part] = relative_covariances(poses[part], apart, 0)
        if first > 0:
            gate = before @ found[first - 1] @ before.T + link
            expected[part] += carry @ gate @ np.swapaxes(carry, 1, 2)
    assert off(found[1:], expected[1:]) < 1e-8


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(-5000.0, 5000.0), st.floats(-3.0, 3.0))
def test_where_the_map_begins_does_not_matter(seed: int, far_m: float, turn: float) -> None:
    rng = np.random.default_rng(seed)
    poses = wandering(rng, 80)
    pairs = [*chained(poses), (0, 40), (20, 70), (5, 79)]
    moved = compose(np.array([far_m, 500.0, turn]), poses)
    edges = joined(poses, pairs, rng=rng)
    here = relative_covariances(poses, edges, 0)[1:]
    assert off(relative_covariances(moved, edges, 0)[1:], here) < 1e-9


def test_bridges_are_the_edges_whose_loss_tears_the_graph() -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        count = int(rng.integers(2, 14))
        extra = rng.integers(0, count, (int(rng.integers(0, 6)), 2))
        pairs = np.concatenate([chained(np.zeros(count)), extra[extra[:, 0] != extra[:, 1]]])
        rng.shuffle(pairs)
        root = int(rng.integers(count))
        bridges = find_bridges(pairs, count, root)
        torn = {k for k in range(len(pairs)) if len(reached(np.delete(pairs, k, 0), root)) < count}
        assert set(bridges.link[bridges.gates].tolist()) == torn
        for pose, gate in enumerate(bridges.gate.tolist()):
            assert bridges.link[gate] >= 0 or gate == root
            held = np.delete(pairs, sorted(torn), 0)
            assert pose in reached(held, gate)


def reversed_edge(edge: GraphEdge) -> GraphEdge:
    """The same measurement made from its target."""
    turn = rotation(np.asarray(-edge.T_source_target[2]))
    carry = turn @ adjoint(edge.T_source_target) @ turn
    covariance = carry @ edge.covariance @ carry.T
    T = inverse(edge.T_source_target)
    return GraphEdge(edge.target, edge.source, T, covariance, edge.kind)


def reached(pairs: FloatArray, root: int) -> set[int]:
    found, growing = {root}, True
    while growing:
        more = {int(b) for pair in pairs for a, b in (pair, pair[::-1]) if a in found} - found
        found |= more
        growing = bool(more)
    return found


def test_poses_that_nothing_joins_are_named() -> None:
    poses = wandering(np.random.default_rng(5), 9)
    edges = [edge for edge in joined(poses, chained(poses)) if edge.source != 5]
    with pytest.raises(NoSolution, match="key frame 6 and 2 others"):
        relative_covariances(poses, edges, 0)


def test_the_estimate_beyond_a_carried_robot_is_as_sure_as_before() -> None:
    """Differences of sums since the first key frame lost all that is smaller than a carried one."""
    count = 400
    poses = compose(np.array([2000.0, 0.0, 1.0]), wandering(np.random.default_rng(6), count))
    edges = joined(poses, chained(poses), weak=((100, 101),))
    estimate = Estimate()
    estimate.begin(poses[0])
    for edge in edges:
        estimate.extend(edge)
    expected = along_the_chain(poses[300:], joined(poses[300:], chained(poses[300:])))
    assert off(estimate.covariance(300, 399)[None], expected[-1:]) < 1e-9
    assert np.trace(estimate.covariance(50, 399)) > np.trace(CARRIED)
