"""Edges that alone hold a part of a graph to the rest, and uncertainties across them.

Across such a bridge covariances add up; nothing need be solved for. A system that holds both a weak
bridge and strong edges has lost the bridge to rounding before it is factorised: information of
1e-2 beside 1e8, times the squares of levers, is all that its sixteen digits can hold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slamsim.core.geometry import adjoint, between
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.slam.matching.small import product


class Bridges(NamedTuple):
    """A graph of n poses seen from one of them, the root.

    order: (n,) poses, each after the one that it is reached from, which is (n,) ``parent``. link:
    (n,) number of the pair that is a bridge to the parent, -1 where there are other paths. gate:
    (n,) the pose beyond the last bridge on the path from the root, or the root.
    """

    order: IntArray
    parent: IntArray
    link: IntArray
    gate: IntArray

    @property
    def gates(self) -> IntArray:
        """The poses that bridges lead to."""
        return np.flatnonzero(self.link >= 0)


def find_bridges(pairs: IntArray, count: int, root: int) -> Bridges:
    """The bridges of a graph of ``count`` poses and (m, 2) pairs of them, which may repeat.

    Raises NoSolution, naming a pose, unless all of them are joined to the root.
    """
    numbers = np.arange(len(pairs), dtype=np.int64)
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    by_end = np.argsort(ends[:, 0], kind="stable")
    starts = np.searchsorted(ends[by_end, 0], np.arange(count + 1)).astype(np.int64)
    beside = ends[by_end, 1], np.concatenate([numbers, numbers])[by_end]
    order, parent, link, gate = _bridges(starts, *beside, root)
    if len(order) < count:
        loose = np.setdiff1d(np.arange(count), order)
        raise NoSolution(
            f"nothing joins key frame {loose[0]} and {len(loose) - 1} others to the rest",
            int(loose[0]),
        )
    return Bridges(order, parent, link, gate)


@kernel
def _bridges(
    starts: IntArray, neighbours: IntArray, numbers: IntArray, root: int
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Depth first, keeping the earliest pose that each can go back to (Tarjan 1974)."""
    count = starts.size - 1
    found, back = np.full(count, -1, np.int64), np.empty(count, np.int64)
    parent, via = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    order, left = np.empty(count, np.int64), starts[:-1].copy()
    found[root], back[root], order[0], reached, at = 0, 0, root, 1, root
    while at >= 0:
        if left[at] == starts[at + 1]:
            up = parent[at]
            if up >= 0:
                back[up] = min(back[up], back[at])
            at = up
            continue
        other, number = neighbours[left[at]], numbers[left[at]]
        left[at] += 1
        if number == via[at]:
            continue
        if found[other] >= 0:
            back[at] = min(back[at], found[other])
            continue
        found[other] = back[other] = reached
        order[reached], parent[other], via[other] = other, at, number
        reached, at = reached + 1, other
    gate = np.full(count, root, np.int64)
    for at in order[1:reached]:
        if back[at] < found[at]:
            via[at], gate[at] = -1, gate[parent[at]]
        else:
            gate[at] = at
    return order[:reached], parent, via, gate


def across(
    bridges: Bridges, poses: FloatArray, pairs: IntArray, steps: FloatArray, held: FloatArray
) -> FloatArray:
    """(n, 3, 3) covariance of each pose relative to the root, in its own frame.

    pairs, steps: (m, 2) and the (m, 3, 3) covariance of each, of its second pose in that one's own
    frame. held: (n, 3, 3) covariance of each pose relative to its gate, in its own frame.
    """
    found, gates = held.copy(), bridges.gates
    to_gate = adjoint(between(poses, poses[bridges.gate]))
    found[gates] = steps[bridges.link[gates]]
    turned = gates[pairs[bridges.link[gates], 0] == gates]
    to_first = adjoint(between(poses[turned], poses[bridges.parent[turned]]))
    found[turned] = to_first @ found[turned] @ np.swapaxes(to_first, 1, 2)
    before = np.where(bridges.link >= 0, bridges.parent, bridges.gate)
    to_gate[gates] = adjoint(between(poses[gates], poses[bridges.parent[gates]]))
    _add_up(bridges.order[1:], before, to_gate, found)
    return found


@kernel
def _add_up(order: IntArray, before: IntArray, carry: FloatArray, found: FloatArray) -> None:
    """Add to each what the pose that it depends on has, which comes before it."""
    half = np.empty((3, 3))
    for at in order:
        product(carry[at], found[before[at]], half)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    found[at, i, j] += half[i, k] * carry[at, j, k]
