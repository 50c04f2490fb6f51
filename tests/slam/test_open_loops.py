"""Stretches of path that no loop checks: which they are, and from where on they are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.core.geometry import adjoint, between, compose, inverse, rotation
from slamsim.core.result import EdgeKind, GraphEdge, PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.slam.mapping.joints import HELD_M, closures_agree, open_loops

STEP = np.array([0.5, 0.0, 0.1])
WIDE = np.diag(np.square([1.0, 0.2, 0.01]))
"""Covariance of each step: so large that a stretch is told from its first key frame on."""


SURE = np.diag(np.square([0.05, 0.02, 0.01]))
"""Of a closure."""


def edge(source: int, target: int, kind: EdgeKind, weight: float = 1.0) -> GraphEdge:
    return GraphEdge(source, target, STEP, SURE if kind == "closure" else WIDE, kind, weight)


def slid(one: int, other: int, free_rad: float) -> GraphEdge:
    """A closure that knows nothing along one direction of the map; key frames as ``graph_of``."""
    source, target = sorted((one, other))
    along = np.append(np.array([np.cos(free_rad), np.sin(free_rad)]), 0.0)
    turned = rotation(np.asarray(-source * STEP[2])) @ along
    return GraphEdge(source, target, STEP, SURE + 1e6 * np.outer(turned, turned), "closure")


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


@pytest.mark.long
@given(st.data())
def test_closures_that_slid_along_one_corridor_check_nothing_along_it(data: st.DataObject) -> None:
    """Many of them, their directions off by some degrees, are no more than one; together with one
    of a corridor across, or with one that did not slide, they check all."""
    count = data.draw(st.integers(2, 8))
    corridor_rad = data.draw(st.floats(0.0, np.pi))
    number = st.integers(0, count - 1)
    chain = [edge(k - 1, k, "match") for k in range(1, count)]
    kinds: dict[str, list[GraphEdge]] = {"along": [], "across": [], "whole": []}
    for kind, most in (("along", 60), ("across", 2), ("whole", 1)):
        for _ in range(data.draw(st.sampled_from([0, 1, most]))):
            one, other = data.draw(number), data.draw(number)
            if one == other:
                continue
            off_rad = np.deg2rad(data.draw(st.floats(-5.0, 5.0)))
            free_rad = corridor_rad + off_rad + (0.5 * np.pi if kind == "across" else 0.0)
            found = edge(one, other, "closure") if kind == "whole" else slid(one, other, free_rad)
            kinds[kind].append(found)
    closures = [one for some in kinds.values() for one in some]
    told = {
        k
        for event in open_loops(graph_of([*chain, *closures], count))
        for k in range(event.start_ns // 1_000_000_000, event.end_ns // 1_000_000_000 + 1)
    }

    def spanned(kind: str, k: int) -> bool:
        return not falls_apart([*chain, *kinds[kind]], k, count)

    for k in range(1, count):
        checked = spanned("whole", k) or (spanned("along", k) and spanned("across", k))
        assert (k in told) == (not checked)


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


@given(st.data())
def test_closures_agree_where_they_leave_the_path_about_as_it_was_measured(
    data: st.DataObject,
) -> None:
    """A loop over the edge to a key frame, measured as the map has it, and that edge moved by less
    than a closure may be unsure: whatever lies elsewhere makes no difference."""
    count = data.draw(st.integers(4, 10))
    number = data.draw(st.integers(1, count - 1))
    shift_m = data.draw(st.floats(0.0, 2.0 * HELD_M).filter(lambda m: abs(m - HELD_M) > 1e-6))
    chain = [edge(k - 1, k, "match") for k in range(1, count)]
    moved = STEP + np.array([shift_m, 0.0, 0.0])
    chain[number - 1] = GraphEdge(number - 1, number, moved, SURE, "match")
    poses = graph_of(chain, count).keyframes.poses
    first = data.draw(st.integers(0, number - 1))
    last = data.draw(st.integers(number, count - 1))
    there = between(poses[first], poses[last])
    loop = GraphEdge(first, last, there, SURE, "closure")
    assert closures_agree(graph_of([*chain, loop], count), number) == (shift_m <= HELD_M)
    elsewhere = GraphEdge(first, last, there + np.array([1.0, 0.0, 0.0]), SURE, "closure")
    assert not closures_agree(graph_of([*chain, elsewhere], count), number)
    assert not closures_agree(graph_of([*chain, replace(loop, weight=0.0)], count), number)
    along = SURE + np.diag([1e6, 0.0, 0.0])
    assert not closures_agree(graph_of([*chain, replace(loop, covariance=along)], count), number)
    assert not closures_agree(graph_of(chain, count), number)
