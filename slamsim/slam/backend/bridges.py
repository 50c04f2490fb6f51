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


class Across(NamedTuple):
    """How an error of one pose moves those beyond it: each is off by an error of its own and by
    what the pose ``before`` it is off, carried along.

    order: of the poses but the root, each after the one before it. carry: (n, 3, 3) takes a small
    step of the pose before to that of each. gates: (g,) the poses that bridges lead to, and steps:
    (g, 3, 3) the covariance of these bridges, in the own frame of each gate.
    """

    order: IntArray
    before: IntArray
    carry: FloatArray
    gates: IntArray
    steps: FloatArray

    @staticmethod
    def of(bridges: Bridges, poses: FloatArray, pairs: IntArray, steps: FloatArray) -> Across:
        """pairs, steps: (m, 2) and the (m, 3, 3) covariance of each, of its second pose in that
        one's own frame."""
        gates = bridges.gates
        carry = adjoint(between(poses, poses[bridges.gate]))
        carry[gates] = adjoint(between(poses[gates], poses[bridges.parent[gates]]))
        own = steps[bridges.link[gates]]
        turned = pairs[bridges.link[gates], 0] == gates
        to_first = carry[gates[turned]]
        own[turned] = to_first @ own[turned] @ np.swapaxes(to_first, 1, 2)
        before = np.where(bridges.link >= 0, bridges.parent, bridges.gate)
        return Across(bridges.order[1:], before, carry, gates, own)

    def add_up(self, held: FloatArray) -> FloatArray:
        """(n, 3, 3) covariance of each pose relative to the root, in its own frame.

        held: (n, 3, 3) covariance of each pose relative to its gate, in its own frame.
        """
        found = held.copy()
        found[self.gates] = self.steps
        _add_up(self.order, self.before, self.carry, found)
        return found

    def gather(self, right: FloatArray) -> FloatArray:
        """(n, 3, k) what an error of each pose's own adds to the sum that ``right`` (n, 3, k)
        makes of the errors of all."""
        gathered = right.copy()
        for at in self.order[::-1].tolist():
            gathered[self.before[at]] += self.carry[at].T @ gathered[at]
        return gathered

    def spread(self, own: FloatArray, gathered: FloatArray) -> FloatArray:
        """(n, 3, k) product of the joint covariance with the right-hand side that was gathered.

        own: the same of the poses' own errors, but for the gates, whose bridges are known here.
        """
        product = own.copy()
        product[self.gates] = self.steps @ gathered[self.gates]
        for at in self.order.tolist():
            product[at] += self.carry[at] @ product[self.before[at]]
        return product


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
