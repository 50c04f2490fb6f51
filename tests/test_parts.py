"""Parts of a map against a slow count of what hangs together, and how often a place was seen."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.geometry import between
from slamsim.slam.parts import Parts
from slamsim.slam.rejoin import moved_onto
from slamsim.slam.visits import CELL_M, ENOUGH_PASSES, PASS_M, Visits

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


def test_a_part_is_carried_rigidly_and_the_rest_stays() -> None:
    rng = np.random.default_rng(3)
    poses = rng.normal(size=(6, 3))
    T_new = rng.normal(size=3)
    moved = moved_onto(poses, [slice(2, 5)], T_new, poses[3])
    assert np.array_equal(moved[[0, 1, 5]], poses[[0, 1, 5]])
    assert np.allclose(moved[3], T_new)
    assert np.allclose(between(moved[2], moved[4]), between(poses[2], poses[4]))


def test_a_place_is_known_after_enough_passes_the_same_way_round() -> None:
    visits, here = Visits(), np.array([0.3, 0.4, 0.1])
    for number in range(ENOUGH_PASSES):
        path_m = number * 3.0 * PASS_M
        assert not visits.enough(here, path_m)
        visits.add(here, path_m)
        visits.add(here, path_m + 0.3)  # the same pass
    path_m = ENOUGH_PASSES * 3.0 * PASS_M
    assert visits.enough(here, path_m)
    assert not visits.enough(here + np.array([0.0, 0.0, np.pi]), path_m)
    assert not visits.enough(here + np.array([CELL_M, 0.0, 0.0]), path_m)
