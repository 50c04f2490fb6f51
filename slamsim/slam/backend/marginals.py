"""Covariances of a solved pose graph without inverting it.

Each pose is disturbed by a small step in its own frame, so that no number grows with the distance
from the map's origin: levers are those between the two poses of an edge. The inverse, with one pose
held fixed, has the uncertainty of every other pose relative to that one on its diagonal. Edges that
alone hold a part of the graph are left out of it: covariances add up along them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.core.geometry import adjoint, between, rotation
from slamsim.core.jit import kernel
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.models.blocks import BlockFactor, factorise, require_variances
from slamsim.models.supernodes import Panels, add_block, empty_system, make_panels
from slamsim.slam.backend.bridges import Across, find_bridges

HOLD = 1e9
"""A pose is held fixed by this many times the largest information of a system."""


def edge_covariances(edges: Sequence[GraphEdge]) -> FloatArray:
    """(m, 3, 3) covariance of each edge as a small step of its target in the target's frame."""
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 3, 3)
    measured = np.array([edge.T_source_target for edge in edges]).reshape(-1, 3)
    turn = rotation(-measured[:, 2])
    return np.asarray(turn @ covariances @ np.swapaxes(turn, -1, -2))


def relative_covariances(poses: FloatArray, edges: Sequence[GraphEdge], fixed: int) -> FloatArray:
    """(n, 3, 3) covariance of each pose relative to the fixed one, as small steps in its own frame.

    Edges count by their weight. Raises NoSolution unless every pose is joined to the fixed one.
    """
    if len(poses) == 1:
        return np.zeros((1, 3, 3))
    ends, covariances = _weighted(poses, edges)
    panels = make_panels(_numbers(len(poses), fixed)[ends], len(poses) - 1)
    nothing = np.zeros((0, 2), dtype=np.int64)
    seen = (panels, empty_system(panels), nothing)
    return Joined(poses, fixed, seen, (ends, covariances)).covariances()


class Joined:
    """A solved graph of poses (n, 3) with one of them held fixed: how unsure the others are.

    seen: a system of all poses but the fixed one, numbered in their order, whose place its factor
    takes, and the (p, 2) pairs of poses that meet in it. steps: (m, 2) pairs of poses with the (m,
    3, 3) covariance of each, of its second pose in that one's own frame. Raises NoSolution.
    """

    def __init__(
        self,
        poses: FloatArray,
        fixed: int,
        seen: tuple[Panels, FloatArray, IntArray],
        steps: tuple[IntArray, FloatArray],
    ) -> None:
        panels, system, met = seen
        ends, covariances = steps
        number = _numbers(len(poses), fixed)
        self._bridges = find_bridges(np.concatenate([ends, met]), len(poses), fixed)
        self._across = Across.of(self._bridges, poses, ends, covariances)
        self._others = np.delete(np.arange(len(poses)), fixed)
        gates = self._bridges.gates
        inside = np.ones(len(ends), dtype=np.bool_)
        inside[self._bridges.link[gates]] = False
        carry = adjoint(between(poses[ends[inside, 1]], poses[ends[inside, 0]]))
        information = np.asarray(np.linalg.inv(covariances[inside]), np.float64)
        add_edges(panels, system, number[ends[inside]], carry, information)
        # Beyond a bridge, poses are held by its end: a part of its own within the same system.
        hold = HOLD * max(system.max(initial=1.0), -system.min(initial=-1.0)) * np.eye(3)
        for gate in number[gates].tolist():
            add_block(panels, system, gate, gate, hold)
        self._factor = factorise(panels, system, self._others)

    def covariances(self) -> FloatArray:
        """(n, 3, 3) relative to the fixed pose, as small steps of each in its own frame."""
        held = np.zeros((len(self._others) + 1, 3, 3))
        held[self._others] = self._factor.inverse_diagonal()
        found = self._across.add_up(held)
        require_variances(found[self._others], self._others)
        return found

    def times(self, right: FloatArray) -> FloatArray:
        """(n, 3, k) product of the joint covariance of all poses (3 n, 3 n) with ``right``."""
        gathered = self._across.gather(right)
        inside = gathered.copy()
        inside[self._bridges.gates] = 0.0
        columns = np.moveaxis(inside[self._others], 2, 0)
        own = np.zeros_like(gathered)
        own[self._others] = np.stack([self._factor.solve(each) for each in columns], axis=2)
        return self._across.spread(own, gathered)


def graph_factor(poses: FloatArray, edges: Sequence[GraphEdge]) -> BlockFactor:
    """The information of all poses (n, 3) but the first, as small steps in their own frames.

    Its unknowns are the other poses in their order. Raises as ``relative_covariances``.
    """
    ends, covariances = _weighted(poses, edges)
    number, others = _numbers(len(poses), 0), np.arange(1, len(poses))
    panels = make_panels(number[ends], len(others))
    system = empty_system(panels)
    carry = adjoint(between(poses[ends[:, 1]], poses[ends[:, 0]]))
    information = np.asarray(np.linalg.inv(covariances), np.float64)
    add_edges(panels, system, number[ends], carry, information)
    return factorise(panels, system, others)


def _weighted(poses: FloatArray, edges: Sequence[GraphEdge]) -> tuple[IntArray, FloatArray]:
    """(m, 2) ends of the edges that count, and (m, 3, 3) covariances by their weight."""
    used = [edge for edge in edges if edge.weight > 0.0]
    if not used:
        raise NoSolution(f"nothing joins {len(poses)} poses, which are as unsure as can be")
    weights = np.array([edge.weight for edge in used])
    ends = np.array([(edge.source, edge.target) for edge in used], dtype=np.int64)
    return ends, edge_covariances(used) / weights[:, None, None]


def _numbers(count: int, fixed: int) -> IntArray:
    """(count,) number of each pose in a system without the fixed one, which goes last."""
    number = np.arange(count)
    number[fixed + 1 :] -= 1
    number[fixed] = count - 1
    return number


def add_edges(
    panels: Panels, system: FloatArray, ends: IntArray, carry: FloatArray, information: FloatArray
) -> None:
    """Add what edges know of the unknowns that they join.

    ends: (m, 2) source and target. carry: (m, 3, 3) takes a small step of the source to the frame
    of the target. information: (m, 3, 3) in the target's frame.
    """
    beside = -np.swapaxes(carry, -1, -2) @ information
    _add_blocks(panels, system, ends, -beside @ carry, beside, information)


@kernel
def _add_blocks(
    panels: Panels,
    system: FloatArray,
    ends: IntArray,
    of_source: FloatArray,
    beside: FloatArray,
    of_target: FloatArray,
) -> None:
    fixed = panels.place.size - 1
    for m in range(ends.shape[0]):
        a, b = ends[m, 0], ends[m, 1]
        if a != fixed:
            add_block(panels, system, a, a, of_source[m])
        if b != fixed:
            add_block(panels, system, b, b, of_target[m])
        if fixed not in (a, b):
            add_block(panels, system, a, b, beside[m])
