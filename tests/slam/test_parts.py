"""Parts of a map against a slow count of what hangs together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.core.geometry import between
from slamsim.core.result import EdgeKind, GraphEdge, PoseGraph
from slamsim.core.types import PlanarTrajectory
from slamsim.slam.closures.rejoin import moved_onto
from slamsim.slam.frontend.parts import Parts
from slamsim.slam.mapping.joints import doubtful_joints

COUNT = 12


@settings(max_examples=200)
@given(
    begins=st.sets(st.integers(1, COUNT - 1), max_size=5),
    joins=st.lists(st.tuples(st.integers(0, COUNT - 1), st.integers(0, COUNT - 1)), max_size=6),
)
def test_parts_are_the_components_of_chain_and_closures(
    begins: set[int], joins: list[tuple[int, int]]
) -> None:
    parts = Parts()
    for begin in sorted(begins):
        parts.begin(begin)
    for one, other in joins:
        parts.join(one, other)
    edges = [(k - 1, k) for k in range(1, COUNT) if k not in begins] + joins
    ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(COUNT, COUNT))
    count, label = connected_components(graph, directed=False)
    assert parts.loose == count - 1
    for one in range(COUNT):
        together = np.zeros(COUNT, dtype=np.bool_)
        for part in parts.members(one, COUNT):
            together[part] = True
        assert np.array_equal(together, label == label[one])
        assert all((parts.of(one) == parts.of(k)) == (label[one] == label[k]) for k in range(COUNT))


@settings(max_examples=200)
@given(
    begins=st.dictionaries(st.integers(1, COUNT - 1), st.sampled_from("ulfwck"), max_size=6),
    one=st.integers(0, COUNT - 1),
    other=st.integers(0, COUNT - 1),
)
def test_runs_are_linked_until_something_refutes_it(
    begins: dict[int, str], one: int, other: int
) -> None:
    """u: nothing links the run to the one before, l: odometry does, f: and so does what was seen at
    its beginning, w: and it was right, c: and it was wrong, k: and it is kept, right or wrong."""
    parts = Parts()
    for begin, kind in sorted(begins.items()):
        parts.begin(begin, linked=kind != "u")
    for begin, kind in begins.items():
        if kind == "w":
            parts.withdraw(begin)
        elif kind == "c":
            parts.confirm(begin)
        elif kind == "k":
            parts.leave(begin)
        elif kind == "f":
            parts.follow(begin)
    low, high = sorted((one, other))
    between_them = {b: kind for b, kind in begins.items() if low < b <= high}
    kinds = set(between_them.values())
    assert parts.linked(one, other) == (not kinds & {"u", "c"})
    assert (parts.of(one) == parts.of(other)) == (kinds <= {"w", "k"})
    undecided = sorted(b for b, kind in between_them.items() if kind in "lf")
    assert parts.open_between(one, other) == undecided
    assert parts.doubted_between(one, other) == [b for b in undecided if begins[b] == "l"]
    assert parts.withdrawn == {b for b, kind in begins.items() if kind == "w"}
    parts.rebuild([])
    assert (parts.of(one) == parts.of(other)) == (kinds <= {"w", "k"})


def test_a_part_is_carried_rigidly_and_the_rest_stays() -> None:
    rng = np.random.default_rng(3)
    poses = rng.normal(size=(6, 3))
    T_new = rng.normal(size=3)
    moved = moved_onto(poses, [slice(2, 5)], T_new, poses[3])
    assert np.array_equal(moved[[0, 1, 5]], poses[[0, 1, 5]])
    assert np.allclose(moved[3], T_new)
    assert np.allclose(between(moved[2], moved[4]), between(poses[2], poses[4]))


def _edge(source: int, target: int, kind: EdgeKind, sigma_m: float = 0.01) -> GraphEdge:
    covariance = np.diag(np.square([sigma_m, sigma_m, 0.01]))
    return GraphEdge(source, target, np.array([1.0, 0.0, 0.0]), covariance, kind)


def _told(closures: list[GraphEdge], drives: set[int]) -> list[str]:
    """Of six key frames, the robot having been carried before the fourth."""
    chain = [_edge(k, k + 1, "match") for k in range(5) if k != 2]
    poses = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)])
    keyframes = PlanarTrajectory(np.arange(6, dtype=np.int64), poses)
    edges = (*chain, _edge(2, 3, "odometry", sigma_m=100.0), *closures)
    graph = PoseGraph(keyframes, np.zeros((6, 3, 3)), edges)
    return [event.words for event in doubtful_joints(graph, drives)]


def test_a_part_that_only_its_looks_place_is_told_of_unless_that_was_asked_for() -> None:
    recognised = [_edge(0, 4, "closure"), _edge(1, 4, "closure"), _edge(3, 5, "closure")]
    (words,) = _told(recognised, set())
    assert "from 1 of its 3 key frames" in words and "may be wrong" in words
    assert _told(recognised, {3}) == []
    (words,) = _told([_edge(3, 5, "closure")], set())
    assert "drawn beside" in words


@pytest.mark.parametrize(("sigma_m", "told"), [(0.01, 0), (0.1, 2)])
def test_key_frames_that_hang_between_what_holds_together_are_told_of_if_they_are_unsure(
    sigma_m: float, told: int
) -> None:
    kinds: list[EdgeKind] = ["match", "match", "odometry", "odometry", "match"]
    edges = [_edge(k, k + 1, kind) for k, kind in enumerate(kinds)]
    poses = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)])
    keyframes = PlanarTrajectory(np.arange(6, dtype=np.int64), poses)
    covariances = np.zeros((6, 3, 3))
    covariances[3, :2, :2] = sigma_m**2 * np.eye(2)
    whole = PoseGraph(keyframes, covariances, (*edges, _edge(1, 5, "closure")))
    assert len(list(doubtful_joints(whole, set()))) == told
    (event,) = doubtful_joints(PoseGraph(keyframes, covariances, tuple(edges[:3])), set())
    assert "by odometry alone" in event.words, "nothing holds what comes after to what was before"
