"""Poses, tags and what is not known of the cameras, solved together.

Surfaces that views share count as the refinement found them: by their whole information, sparse as
it is, about the relative poses that it ended with. Seen from one pose of each pair, these do not
change while parts of the map move as one, so a map may be carried far, and bent where it is weak.
Errors that all observations of a camera have in common (its place, its clock, its lens) are
unknowns with a prior: counted as independent, they would outweigh any lidar.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from slamsim.config.back_end import GraphConfig
from slamsim.core.geometry import adjoint, between, compose, rotation
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.models.blocks import BlockFactor, factorise
from slamsim.models.supernodes import add_blocks, blocks_at, empty_system, make_panels
from slamsim.slam.backend.bundle import LEAST_KNOWN
from slamsim.slam.backend.graph import MAX_WITHDRAWALS, PATIENCE
from slamsim.slam.backend.marginals import edge_covariances

SHARED = 6
"""Numbers that all observations of a camera have in common: its x, y and yaw on the base, how late
its first row is, how long its readout takes more, and the logarithm of how much farther things are
than they look. Of wheels the last one is that of the path."""
LEAST_SCALE = 0.1
"""Nothing is so much smaller than it looks; keeps a step too far from turning it inside out."""
MOST_STEPS = 50
RISE, FIRST_DAMPING = 1.1, 1e-4
"""A step that makes the cost more than this times larger is taken back, and taken again with this
share of each diagonal on top, and ten times more if that does not do."""
SETTLED = 1e-6
"""Metres and radians: steps no larger end a solution."""
WIDTHS = 3.0
"""Cauchy's width over the median of what it weighs: of normal errors most keep nine tenths."""


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """What ties n poses.

    edges: m of them. cameras: (m,) number of the camera that an edge is a view of, -1 for others;
    slopes: (m, 3, 6) how errors that a camera's views share move the target, in its own frame;
    sigmas: (c, 6) of these errors. surfaces: (p, 2) ordered pairs of poses, and (p, 3, 3) what is
    known of small steps of both, each in its own frame, about the poses ``placed`` (n, 3).
    """

    edges: Sequence[GraphEdge]
    cameras: IntArray
    slopes: FloatArray
    sigmas: FloatArray
    surfaces: tuple[IntArray, FloatArray]
    placed: FloatArray


class JointSolver:
    """Gauss and Newton's steps for poses (n, 3), of which one is held fixed.

    shared: (c, 6) errors of the cameras, as found by now. weights: (m,) what is left of the edges.
    settled: whether the last solution came to an end.
    """

    def __init__(self, ties: Ties, poses: FloatArray, fixed: int) -> None:
        self.poses, self.shared = poses, np.zeros_like(ties.sigmas)
        self.weights = np.ones(len(ties.edges))
        self.settled = True
        self._begun = poses, self.shared
        self._ties = ties
        self._ends = np.array([(edge.source, edge.target) for edge in ties.edges])
        self._doubted = np.array([edge.kind == "closure" for edge in ties.edges])
        self.measure(ties.edges)
        self._pairs, self._known = ties.surfaces
        self._relative = between(*(ties.placed[ends] for ends in self._pairs.T))
        self._fix(fixed)

    def _fix(self, fixed: int) -> None:
        """Number the unknowns: all poses but one, and two for each camera. What is no unknown has
        the number after the last."""
        count, cameras = len(self.poses), len(self.shared)
        self._unknowns = count - 1 + 2 * cameras
        self._number = np.arange(count) - (np.arange(count) > fixed)
        self._number[fixed] = self._unknowns
        self._others = np.delete(np.arange(count), fixed)
        errors = count - 1 + np.arange(2 * cameras).reshape(-1, 2)
        none = np.full((1, 2), self._unknowns)  # of edges that are no views
        self._errors = np.concatenate([errors, none])[self._ties.cameras]
        joined = np.column_stack([self._number[self._ends], self._errors])
        meeting = [joined[:, [a, b]] for a in range(4) for b in range(a)]
        pairs = np.concatenate([self._number[self._pairs], *meeting])
        self._panels = make_panels(pairs, self._unknowns)

    def measure(self, edges: Sequence[GraphEdge]) -> None:
        """Take these in the place of the edges, one for one."""
        self._measured = np.array([edge.T_source_target for edge in edges])
        self._believed = np.asarray(np.linalg.inv(edge_covariances(edges)), np.float64)

    def relax(self) -> None:
        """Move everything to where the edges have it, by their weights (Marquardt 1963).

        From where it all began, if that fits better: edges that are withdrawn may have led far
        away. Raises NoSolution.
        """
        damping, cost = 0.0, self._cost()
        last = self.poses, self.shared
        self.poses, self.shared = self._begun
        if (begun := self._cost()) < cost:
            cost = begun
        else:
            self.poses, self.shared = last
        for _ in range(MOST_STEPS):
            before = self.poses, self.shared
            step = self._factor(LEAST_KNOWN, damping).solve(-self._gradient())
            if not np.isfinite(step).all():
                raise NoSolution("a step of the solution with tags is not finite")
            moves, count = np.zeros_like(self.poses), len(self.poses) - 1
            moves[self._others] = step[:count]
            self.poses = compose(self.poses, moves)
            self.shared = self.shared + step[count:].reshape(self.shared.shape)
            now = self._cost()
            if now <= RISE * cost + 1.0:
                damping, cost = 0.1 * damping, now
            else:
                self.poses, self.shared = before
                damping = max(10.0 * damping, FIRST_DAMPING)
            self.settled = bool(np.abs(step).max(initial=0.0) <= SETTLED)
            if self.settled:
                break

    def weigh(self, config: GraphConfig) -> None:
        """Weigh closures and views by Cauchy's estimator, as wide as most of them are off: a robot
        that drifted by metres is off from all of its tags alike, a mistaken tag from the others."""
        off = self._sigmas()
        width = max(config.cauchy_width, WIDTHS * float(np.median(off[self._doubted])))
        self.weights = np.where(self._doubted, 1.0 / (1.0 + np.square(off / width)), 1.0)

    def doubt(self, config: GraphConfig) -> None:
        """Withdraw closures and views that do not fit, as ``PoseGraphSolver.solve`` does."""
        for patience in (*PATIENCE, *[1.0] * MAX_WITHDRAWALS):
            fitting = ~self._doubted | (self._sigmas() <= patience * config.withdraw_sigmas)
            if patience == 1.0 and np.array_equal(fitting, self.weights > 0.0):
                break
            self.weights = fitting.astype(np.float64)
            self.relax()

    def loose(self) -> IntArray:
        """Numbers of the poses that nothing ties any more: all that tied them is withdrawn."""
        tied = np.zeros(len(self.poses), dtype=np.bool_)
        tied[self._ends[self.weights > 0.0]] = True
        tied[self._pairs] = True
        return np.flatnonzero(~tied)

    def without_edges(self, first: int) -> JointSolver:
        """The same solution with edges from number ``first`` on that count for nothing."""
        other = copy(self)
        other.weights = np.where(np.arange(len(self.weights)) < first, self.weights, 0.0)
        return other

    def covariances(self, fixed: int) -> FloatArray:
        """(n, 3, 3) relative to a pose, which is held fixed from now on, of small steps of each in
        its own frame. Those of loose poses mean nothing."""
        self._fix(fixed)
        found = np.zeros((len(self.poses), 3, 3))
        least = np.zeros((self._unknowns + 1, 3, 3))
        least[self._number[self.loose()]] = LEAST_KNOWN
        diagonal = self._factor(least[:-1]).inverse_diagonal()
        found[self._others] = diagonal[: len(self._others)]
        return found

    def fit_of(self, those: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of (k,) edges: (k, 3) by how much they are off, (k, 3, 3) what they claim of that, and
        how much of it the solution could fit; all in the frames of their targets."""
        off, believed, every = self._linear()
        parts = [(number[those], slopes[those]) for number, slopes in every]
        pairs = np.concatenate(
            [np.column_stack([one, other]) for one, _ in parts for other, _ in parts]
        )
        free = (pairs < self._unknowns).all(axis=1)
        blocks = np.zeros((len(pairs), 3, 3))
        blocks[free] = self._factor(LEAST_KNOWN).inverse_blocks(pairs[free])
        blocks = blocks.reshape(len(parts), len(parts), len(those), 3, 3)
        fitted = sum(
            slopes @ blocks[i, j] @ np.swapaxes(back, 1, 2)
            for i, (_, slopes) in enumerate(parts)
            for j, (_, back) in enumerate(parts)
        )
        claimed = np.asarray(np.linalg.inv(believed[those]), dtype=np.float64)
        return off[those], claimed, np.asarray(fitted)

    def _off(self) -> FloatArray:
        """(m, 3) errors of the edges, in the frames of their targets as they were measured."""
        sources, targets = self.poses[self._ends.T[0]], self.poses[self._ends.T[1]]
        shared = np.concatenate([self.shared, np.zeros((1, SHARED))])[self._ties.cameras]
        off = between(self._measured, between(sources, targets))
        off -= np.einsum("mij,mj->mi", self._ties.slopes, shared)
        off[:, :2] *= self._as_measured()[:, None]
        return np.asarray(off)

    def _as_measured(self) -> FloatArray:
        """(m,) takes lengths to what a camera or the wheels have them for: noise is of that size.
        Were it of the true one, everything would fit the better the smaller it is."""
        scales = np.append(self.shared[:, -1], 0.0)[self._ties.cameras]
        return np.asarray(1.0 / np.maximum(1.0 + scales, LEAST_SCALE))

    def _linear(self) -> tuple[FloatArray, FloatArray, list[tuple[IntArray, FloatArray]]]:
        """Of each edge: its error (m, 3), what is known of that (m, 3, 3), and its unknowns (m,)
        with how they move the error (m, 3, 3).

        All in the frame of the target as it is now: that in which it was measured may be turned by
        a radian, for a tag that is far away fits two ways.
        """
        sources, targets = self.poses[self._ends.T[0]], self.poses[self._ends.T[1]]
        seen = between(sources, targets)
        turn = rotation(self._measured[:, 2] - seen[:, 2])
        off = np.einsum("mij,mj->mi", turn, self._off())
        believed = turn @ self._believed @ np.swapaxes(turn, 1, 2)
        as_measured = self._as_measured()
        shrink = np.ones_like(off)
        shrink[:, :2] = as_measured[:, None]
        shrinks = shrink[:, :, None] * np.eye(3)
        errors, slopes = self._errors, shrinks @ turn @ self._ties.slopes
        slopes[:, :2, -1] += as_measured[:, None] * off[:, :2]
        return (
            off,
            believed,
            [
                (self._number[self._ends[:, 0]], -shrinks @ adjoint(between(targets, sources))),
                (self._number[self._ends[:, 1]], shrinks),
                (errors[:, 0], -slopes[:, :, :3]),
                (errors[:, 1], -slopes[:, :, 3:]),
            ],
        )

    def _sigmas(self) -> FloatArray:
        """(m,) how many standard deviations each edge is off."""
        off = self._off()
        return np.asarray(np.sqrt(np.einsum("mi,mij,mj->m", off, self._believed, off)))

    def _cost(self) -> float:
        """Squared standard deviations of everything. That of surfaces is the sum over pairs, which
        is exact for surfaces without a turn of their own, and enough to tell a step too far."""
        step, carry = self._steps()
        one, other = self._pairs.T
        later = one < other
        back = np.swapaxes(np.linalg.inv(carry[later]), 1, 2)
        known = -back @ self._known[later]
        surfaces = np.einsum("pi,pij,pj->", step[later], known, step[later])
        errors = np.square(self.shared / self._ties.sigmas).sum()
        return float(self.weights @ np.square(self._sigmas()) + surfaces + errors)

    def _steps(self) -> tuple[FloatArray, FloatArray]:
        """(p, 3) by how much the second pose of each pair of surfaces is off, seen from the first,
        and (p, 3, 3) takes a small step of the first to the second."""
        one, other = self._pairs.T
        step = between(compose(self.poses[one], self._relative), self.poses[other])
        return step, adjoint(between(self.poses[other], self.poses[one]))

    def _gradient(self) -> FloatArray:
        """(u, 3) of half the squares."""
        found = np.zeros((self._unknowns + 1, 3))
        off, believed, parts = self._linear()
        pull = np.einsum("m,mij,mj->mi", self.weights, believed, off)
        for number, slopes in parts:
            np.add.at(found, number, np.einsum("mji,mj->mi", slopes, pull))
        step, _ = self._steps()
        np.add.at(
            found, self._number[self._pairs[:, 0]], np.einsum("pij,pj->pi", self._known, step)
        )
        errors = found[len(self.poses) - 1 : -1].reshape(self.shared.shape)
        errors += self.shared / np.square(self._ties.sigmas)
        return found[:-1]

    def _factor(self, least: FloatArray, damping: float = 0.0) -> BlockFactor:
        """What everything knows of the unknowns, factorised. least: known of each, or of all
        alike; damping: share of the diagonal on top."""
        system = empty_system(self._panels)
        _, believed, parts = self._linear()
        believed = self.weights[:, None, None] * believed
        for k, (number, slopes) in enumerate(parts):
            weighed = np.swapaxes(slopes, 1, 2) @ believed
            for other, by_other in parts[k:]:
                ends = np.column_stack([number, other])
                add_blocks(self._panels, system, ends, np.ascontiguousarray(weighed @ by_other))
        once = self._pairs[:, 0] <= self._pairs[:, 1]
        add_blocks(self._panels, system, self._number[self._pairs[once]], self._known[once])
        own = np.repeat(np.arange(self._unknowns)[:, None], 2, axis=1)
        known = np.broadcast_to(least, (self._unknowns, 3, 3)).copy()
        prior = np.square(1.0 / self._ties.sigmas).reshape(-1, 3)
        known[len(self.poses) - 1 :] = prior[:, :, None] * np.eye(3)
        known += damping * np.eye(3) * blocks_at(self._panels, system, own)
        add_blocks(self._panels, system, own, known)
        names = np.append(self._others, np.arange(len(prior)))
        return factorise(self._panels, system, names)
