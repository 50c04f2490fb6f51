"""Stretches of path that no loop checks: which they are, and from where on they are told."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.core.geometry import adjoint, compose, inverse
from slamsim.core.result import EdgeKind, GraphEdge, PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.slam.mapping.joints import open_loops

STEP = np.array([0.5, 0.0, 0.1])
WIDE = np.diag(np.square([1.0, 0.2, 0.01]))
"""Covariance of each step: so large that a stretch is told from its first key frame on."""


def edge(source: int, target: int, kind: EdgeKind, weight: float = 1.0) -> GraphEdge:
    return GraphEdge(source, target, STEP, WIDE, kind, weight)


def graph_of(edges: list[GraphEdge], count: int, added: FloatArray = WIDE) -> PoseGraph:
    """Key frames on a bow, each less sure than the one before by the covariance ``added``."""
    poses, covariances = [np.zeros(3)], [np.zeros((3, 3))]
    carry = adjoint(inverse(STEP))
    for _ in range(count - 1):
        poses.append(compose(poses[-1], STEP))
        covariances.append(carry @ covariances[-1] @ carry.T + added)
    stamps_ns = np.arange(count, dtype=np.int64) * 1_000_000_000
    return PoseGraph(PlanarTrajectory(stamps_ns, np.array(poses)), np.array(covariances), (*edges,))


def falls_apart(edges: list[GraphEdge], without: int, count: int) -> bool:
    """Whether the edge that leads to a key frame is all that joins it to the one before."""
    left = [e for e in edges if e.weight > 0.0 and (e.kind == "closure" or e.target != without)]
    ends = np.array([(e.source, e.target) for e in left], dtype=np.int64).reshape(-1, 2)
    joined = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    part = connected_components(joined, directed=False)[1]
    return bool(part[without - 1] != part[without])


@given(st.data())
def test_told_is_what_falls_apart_without_its_own_edge(data: st.DataObject) -> None:
    count = data.draw(st.integers(2, 12))
    held = data.draw(st.integers(0, count))
    number = st.integers(0, count - 1)
    ends = data.draw(st.lists(st.tuples(number, number, st.sampled_from([0.0, 1.0])), max_size=6))
    alone = data.draw(st.sets(st.integers(1, count - 1), max_size=2))
    chain = [edge(k - 1, k, "odometry" if k in alone else "match") for k in range(1, count)]
    edges = chain + [edge(a, b, "closure", weight) for a, b, weight in ends if a != b]
    told = {
        k
        for event in open_loops(graph_of(edges, count), held)
        for k in range(event.start_ns // 1_000_000_000, event.end_ns // 1_000_000_000 + 1)
    }
    unchecked = range(max(held, 1), count)
    assert told == {k for k in unchecked if k not in alone and falls_apart(edges, k, count)}


def test_a_stretch_is_told_from_where_it_may_be_off_by_a_cell() -> None:
    count, added = 40, np.diag(np.square([0.01, 0.01, 1e-9]))
    chain = [edge(k - 1, k, "match") for k in range(1, count)]
    # 2 sigmas of k steps of 1 cm are 5 cm at k = 6.25.
    (event,) = open_loops(graph_of(chain, count, added))
    assert (event.start_ns, event.end_ns) == (7_000_000_000, 39_000_000_000)
    assert "20 m of the path" in event.words and "0.12 m (95 %)" in event.words
    (event,) = open_loops(graph_of([*chain, edge(0, 20, "closure")], count, added))
    assert event.start_ns == 27_000_000_000
    assert not list(open_loops(graph_of([*chain, edge(0, 39, "closure")], count, added)))
    exact = graph_of(chain, count, 1e-3 * added)
    assert not list(open_loops(exact))
