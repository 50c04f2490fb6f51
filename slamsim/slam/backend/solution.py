"""The graph of key frames, and where it puts them while it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slamsim.config.back_end import GraphConfig
from slamsim.core.geometry import between, compose, inverse
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.estimate import Estimate
from slamsim.slam.backend.graph import PoseGraphSolver
from slamsim.slam.closures.closure import Closure, Expected, sigmas_off
from slamsim.slam.closures.rejoin import moved_onto, side_by_side
from slamsim.slam.closures.submaps import Submap
from slamsim.slam.frontend.odometry import ELSEWHERE
from slamsim.slam.frontend.parts import Parts

UPDATE_AFTER_KEYFRAMES = 10
RENEW_AFTER_KEYFRAMES = 20
RENEW_AFTER_SHARE = 0.1
"""Covariances cost more the longer the graph is: they are renewed after this share of it more, so
that all renewals together cost as much as some ten of the last one."""
SURPRISE_M = 0.1
SURPRISE_RAD = 0.03
"""By how much the key frames of new closures may be off what these measured before the poses are
updated at once, and not with the next UPDATE_AFTER_KEYFRAMES."""

DRIFT_M_PER_M, MOST_DRIFT_RAD = 0.03, 0.1
"""Of maps whose odometry is bad, beyond what its noise explains."""

CARRIED_SIGMAS = 5.0
"""A robot that is found farther from where odometry has it was carried, or slid: for Gaussian
errors in the plane a false alarm in 60,000 closures."""

RIGID = 1e-12 * np.eye(3)
"""Covariance of a step within a map that is held fixed: a thousand of them in a row, 50 m long,
are sure to 1.5 mm, far below what a closure tells."""


class Solution:
    """Edges of the chain and closures go in; poses and their uncertainties come out.

    ``update`` and ``solve`` let the edges move the poses: the one is quick, the other thorough.
    """

    def __init__(self, config: GraphConfig) -> None:
        self._graph = PoseGraphSolver(config)
        self._unsolved: list[Closure] = []
        self._updated_keyframes = 0
        self.estimate = Estimate()
        self.parts = Parts()

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base of the key frames as estimated by now; a view."""
        return self.estimate.poses

    @property
    def edges(self) -> Sequence[GraphEdge]:
        """Of the chain and closures, with the weights of the last solution."""
        return self._graph.edges

    @property
    def closures(self) -> list[GraphEdge]:
        """Those that were entered, believed or not."""
        return [edge for edge in self._graph.edges if edge.kind == "closure"]

    @property
    def believed(self) -> set[tuple[int, int]]:
        """The ends of the closures that count."""
        return {(edge.source, edge.target) for edge in self.closures if edge.weight > 0.0}

    def begin(self, T_map_base: FloatArray) -> None:
        """The first key frame. T_map_base: (3,)."""
        self.estimate.begin(T_map_base)

    def extend(self, edge: GraphEdge, apart: bool, linked: bool = False) -> None:
        """One more key frame, joined to the last by an edge of the chain.

        apart: that edge may be wrong by any distance; a part of its own begins here. linked: it is
        right, though, if the robot was not carried.
        """
        self._graph.add(edge)
        self.estimate.extend(edge)
        if apart:
            self.parts.begin(edge.target, linked)

    def hold(self, poses: FloatArray) -> None:
        """All key frames so far are one map that is finished, and stay at ``poses`` (n, 3)."""
        self.estimate.move(poses)
        self.parts = Parts()
        steps = between(poses[:-1], poses[1:])
        rigid = [GraphEdge(k, k + 1, T, RIGID, "match") for k, T in enumerate(steps)]
        self._graph.renew(rigid)
        self._graph.hold(poses)
        self._renew_covariances()

    def loosen(self, begin: int) -> None:
        """The robot was carried to a key frame: odometry says nothing of where it came from."""
        self.parts.confirm(begin)
        self._loosen_chain(begin)

    def _loosen_chain(self, begin: int) -> None:
        chain = (e for e in self._graph.edges if e.kind != "closure" and e.target == begin)
        self._graph.renew([replace(edge, covariance=ELSEWHERE) for edge in chain])

    def enter(self, edge: GraphEdge) -> None:
        """A closure that counts; if it joins two parts of the map, one is carried to the other."""
        self._judge(edge)
        if self.parts.of(edge.source) != self.parts.of(edge.target):
            self.estimate.move(self.moved_by(edge))
            self._graph.begin_anew()
            self.parts.join(edge.source, edge.target)
        self._graph.add(edge)

    def separate(self, members: IntArray, carried: Sequence[int]) -> None:
        """Forget the closures between these key frames and all others, and the odometry that leads
        to those of them to which the robot was carried.

        members: (k,).
        """
        self._graph.forget(self.crossing(members))
        for begin in carried:
            self.parts.cut(begin)
            self._loosen_chain(begin)
        self.parts.rebuild(self.believed)
        self._unsolved.clear()

    def crossing(self, members: IntArray) -> set[tuple[int, int]]:
        """The ends of the closures that count between these key frames and others.

        members: (k,).
        """
        inside = set(members.tolist())
        return {ends for ends in self.believed if (ends[0] in inside) != (ends[1] in inside)}

    def moved_by(self, edge: GraphEdge) -> FloatArray:
        """(n, 3) the poses if the later of two parts is carried to where an edge has it."""
        source, target = edge.source, edge.target
        if self.parts.of(target) < self.parts.of(source):
            T_new = compose(self.poses[target], inverse(edge.T_source_target))
            return self._carried(source, T_new)
        return self._carried(target, compose(self.poses[source], edge.T_source_target))

    def set_apart(self, submaps: Sequence[Submap]) -> None:
        """Put what nothing joins side by side, so that it does not look like one map."""
        if self.parts.loose:
            self.estimate.move(side_by_side(self.poses, self.parts, submaps))

    def close(self, closure: Closure) -> None:
        """Enter a closure that was just found, to be reckoned with at the next update."""
        self.enter(closure.edge)
        self._unsolved.append(closure)

    def expected(self, anchor: int, index: int) -> Expected:
        """Where a key frame should be in the frame of an earlier one."""
        T_submap_query = between(self.poses[anchor], self.poses[index])
        return Expected(T_submap_query, self.estimate.covariance(anchor, index))

    def may_be(self, edge: GraphEdge) -> bool:
        """Whether a key frame may be where an edge has it, by how far any odometry drifts; anywhere
        where none tells."""
        linked = self.parts.linked(edge.source, edge.target)
        if not linked or self.parts.doubted_between(edge.source, edge.target):
            return True
        expected = self.expected(edge.source, edge.target)
        drifted = self._drifted(expected, edge.source, edge.target)
        return bool(sigmas_off(edge, drifted) <= CARRIED_SIGMAS)

    def due(self) -> bool:
        """Whether an update now would help the search for the next closures."""
        if not self._unsolved:
            return False
        if len(self.estimate) - self._updated_keyframes >= UPDATE_AFTER_KEYFRAMES:
            return True
        edges = [closure.edge for closure in self._unsolved]
        now = between(self.poses[[e.source for e in edges]], self.poses[[e.target for e in edges]])
        step = between(np.array([edge.T_source_target for edge in edges]), now)
        surprise_m, surprise_rad = np.hypot(step[:, 0], step[:, 1]).max(), np.abs(step[:, 2]).max()
        return bool(surprise_m > SURPRISE_M or surprise_rad > SURPRISE_RAD)

    def update(self) -> None:
        """Let the new closures move the estimate; now and then, renew its uncertainties."""
        count = self._updated_keyframes = len(self.estimate)
        opened = not all(closure.expected for closure in self._unsolved)
        self._unsolved.clear()
        self.estimate.move(self._graph.update(self.poses))
        grown = count - self.estimate.solved_count
        if opened or grown >= RENEW_AFTER_KEYFRAMES + RENEW_AFTER_SHARE * count:
            self._renew_covariances()

    def take_up(self) -> None:
        """Let closures that were entered all at once move the estimate."""
        self.estimate.move(self._graph.update(self.poses))
        self._renew_covariances()

    def solve(self, begin: FloatArray | None = None) -> None:
        """The full solution, sought from the poses as they are, or from ``begin`` (n, 3)."""
        self.estimate.move(self._graph.solve(self.poses if begin is None else begin))
        self._renew_covariances()
        self._unsolved.clear()

    def solve_with(self, chain: Sequence[GraphEdge], begin: FloatArray | None = None) -> None:
        """The full solution with these in the place of the edges that joined the same poses, which
        come back if there is none. begin: (n, 3), as for ``solve``."""
        before = [edge for edge in self._graph.edges if edge.kind != "closure"]
        try:
            self._graph.renew(chain)
            self.solve(begin)
        except Exception:
            self._graph.renew(before)
            raise

    def _judge(self, edge: GraphEdge) -> None:
        """Whether a closure finds the robot where odometry had it, past runs that it links, or
        farther off than any drift; in between nothing is decided yet."""
        begins = self.parts.open_between(edge.source, edge.target)
        if not begins or not self.parts.linked(edge.source, edge.target):
            return
        doubted = self.parts.doubted_between(edge.source, edge.target)
        expected = self.expected(edge.source, edge.target)
        drifted = self._drifted(expected, edge.source, edge.target)
        for begin in begins:
            if sigmas_off(edge, expected) <= CARRIED_SIGMAS:
                self.parts.withdraw(begin)
            elif begin in doubted and sigmas_off(edge, drifted) > CARRIED_SIGMAS:
                self.loosen(begin)

    def _drifted(self, expected: Expected, source: int, target: int) -> Expected:
        """As unsure as the worst odometry leaves it."""
        steps = np.diff(self.poses[slice(*sorted((source, target + 1)))], axis=0)
        drift_m = DRIFT_M_PER_M * float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        drift = np.diag(np.square([drift_m, drift_m, MOST_DRIFT_RAD]))
        return replace(expected, covariance=expected.covariance + drift)

    def _carried(self, keyframe: int, T_map_base: FloatArray) -> FloatArray:
        """(n, 3) the poses with a whole part moved so that this key frame of it lies there."""
        members = self.parts.members(keyframe, len(self.estimate))
        return moved_onto(self.poses, members, T_map_base, self.poses[keyframe])

    def _renew_covariances(self) -> None:
        self.estimate.renew_covariances(self._graph.edges)
