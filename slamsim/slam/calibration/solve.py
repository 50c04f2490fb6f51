"""The calibration of wheels and gyroscope as variables of the pose graph, solved with all of it.

Odometry's steps between key frames depend on the calibration, to first order. Each is compared
with the matched step of the same interval; where no match holds the robot, along a corridor, the
step enters the graph itself, and closures farther off speak about the calibration as well. One
Gauss-Newton step of the whole system follows each solution of the poses: these are eliminated
(Schur complement), so that what is left has the size of the calibration, and its inverse is the
calibration's covariance given everything. The gyroscope's bias walks: it is a line through knots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.wheel_gyro import GYRO_BIAS, GYRO_SCALE, PARAMETERS
from slamsim.slam.backend.marginals import edge_covariances, graph_factor
from slamsim.slam.calibration.online import (
    LEAST_GYRO_FACTOR,
    PRIOR_SIGMAS,
    Evidence,
    evidence,
    fit_factor,
    match_information,
    step_covariance,
)
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep

KNOT_S, MOST_KNOTS = 30.0, 24
ROUNDS = 8
CONVERGED_SIGMAS = 0.01
DOUBT_SQUARED = 9.0
FREE_SHARE = 0.01
"""A step follows odometry along a direction if the match leaves it more than this share."""

STRONG = 1e4
"""A match that knows a direction at all outweighs odometry along it by this much."""

MEDIAN_CHI2_3 = 2.366
"""Of squared errors of three numbers in sigmas (chi-squared, three degrees of freedom)."""
UNIT_BOUNDS = (0.01, 25.0)
"""Of the variances that matches and odometry claim together: from a tenth to five times in sigma,
beyond which the model is wrong and not the unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """One key frame to the next: odometry's step, the matched step (3,), information (3, 3) of the
    later match, and the later key frame's stamp."""

    step: OdometryStep
    T_matched: FloatArray
    information: FloatArray
    stamp_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """values: (p,), the four constant parameters and the bias at its knots, with covariance (p, p).

    knots_ns: (p - 4,). noise: random errors as they were found.
    """

    values: FloatArray
    covariance: FloatArray
    knots_ns: IntArray
    noise: OdometryNoise

    def parameters(self, stamps_ns: IntArray) -> FloatArray:
        """(n, 5) at the given instants; the bias is held beyond its first and last knot."""
        constant = np.broadcast_to(self.values[:GYRO_BIAS], (len(stamps_ns), GYRO_BIAS))
        bias = shares(self.knots_ns, stamps_ns) @ self.values[GYRO_BIAS:]
        return np.column_stack([constant, bias])

    def mean(self) -> tuple[FloatArray, FloatArray]:
        """(5,) parameters and their (5, 5) covariance, the bias averaged over the drive."""
        count = len(self.knots_ns)
        gather = np.zeros((PARAMETERS, len(self.values)))
        gather[:GYRO_BIAS, :GYRO_BIAS] = np.eye(GYRO_BIAS)
        gather[GYRO_BIAS, GYRO_BIAS:] = 1.0 / count
        return np.asarray(gather @ self.values), np.asarray(gather @ self.covariance @ gather.T)

    def at(self, step: OdometryStep, stamp_ns: int) -> OdometryStep:
        """A step so calibrated."""
        return step.at(self.parameters(np.array([stamp_ns]))[0])


def shares(knots_ns: IntArray, stamps_ns: IntArray) -> FloatArray:
    """(n, k) by which the values at the knots enter those at the stamps."""
    if len(knots_ns) == 1:
        return np.ones((len(stamps_ns), 1))
    place = np.interp(stamps_ns - knots_ns[0], knots_ns - knots_ns[0], np.arange(len(knots_ns)))
    return np.asarray(np.maximum(1.0 - np.abs(place[:, None] - np.arange(len(knots_ns))), 0.0))


def knots_of(stamps_ns: IntArray, gyro: bool) -> IntArray:
    """(k,) where the bias may bend, of stamps (n,): one instant for all without a gyroscope."""
    seconds = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9
    count = min(1 + round(seconds / KNOT_S), MOST_KNOTS) if gyro else 1
    return np.linspace(stamps_ns[0], stamps_ns[-1], max(count, 1)).astype(np.int64)


def freedom(interval: Interval, noise: OdometryNoise) -> FloatArray:
    """(3, 3) by which a change of odometry's step moves the matched one: zero where it is held."""
    own = np.linalg.inv(noise.covariance(interval.step) + 1e-12 * np.eye(3))
    return np.asarray(np.linalg.inv(STRONG * interval.information + own) @ own)


def solve_calibration(intervals: Sequence[Interval], config: MotionConfig) -> Solved:
    """The most likely calibration given the matches of all intervals, loops left out."""
    return _System(intervals, OdometryNoise(config)).solve()


class _System:
    """Stacked intervals, solved by Gauss and Newton with bad ones weighed down."""

    def __init__(self, intervals: Sequence[Interval], noise: OdometryNoise) -> None:
        self._noise = noise
        self._steps = [one.step for one in intervals]
        self._T_matched = np.array([one.T_matched for one in intervals])
        information = np.array([one.information for one in intervals])
        self._information = match_information(information)
        self._held = np.linalg.eigvalsh(self._information)[:, 0] > 1.0
        self._stamps_ns = np.array([one.stamp_ns for one in intervals], dtype=np.int64)
        gyro = any(step.gyro_s > 0.0 for step in self._steps)
        self.knots_ns = knots_of(self._stamps_ns, gyro)
        self._size = GYRO_BIAS + len(self.knots_ns)

    def solve(self) -> Solved:
        values, prior = np.zeros(self._size), self._prior()
        jacobian = self._jacobian()
        covariance = np.asarray(np.linalg.inv(prior), np.float64)
        for _ in range(ROUNDS):
            found, own = self._evidence(values, jacobian)
            self._noise = self._fitted(found, own, covariance)
            doubt = 1.0 / (1.0 + found.squared / DOUBT_SQUARED)
            weight = doubt[:, None, None] * found.weight
            system = prior + np.einsum("nri,nrs,nsj->ij", jacobian, weight, jacobian)
            push = prior @ values + np.einsum("nri,nrs,ns->i", jacobian, weight, found.residual)
            rest, pushed = self._rest(values)
            covariance = np.asarray(np.linalg.inv(system + rest), np.float64)
            step = -covariance @ (push + pushed)
            values = values + step
            if np.abs(step / np.sqrt(np.diag(covariance))).max() < CONVERGED_SIGMAS:
                break
        unit = 1.0
        if self._held.any():
            unit = float(np.median(found.squared[self._held])) / MEDIAN_CHI2_3
        unit = float(np.clip(unit, *UNIT_BOUNDS))
        return Solved(values, covariance * unit, self.knots_ns, self._noise)

    def _prior(self) -> FloatArray:
        information = np.zeros((self._size, self._size))
        constant = np.arange(GYRO_BIAS + 1)
        information[constant, constant] = 1.0 / np.square(PRIOR_SIGMAS)
        seconds = np.diff(self.knots_ns) * 1e-9
        for knot, apart_s in enumerate(seconds, start=GYRO_BIAS):
            walk = 1.0 / (self._noise.config.gyro_bias_walk**2 * apart_s)
            information[knot : knot + 2, knot : knot + 2] += walk * np.array([[1, -1], [-1, 1]])
        return information

    def _jacobian(self) -> FloatArray:
        """(n, 4, p)."""
        by_parameter = np.array([step.jacobian for step in self._steps])
        share = shares(self.knots_ns, self._stamps_ns)
        bias = by_parameter[:, :, GYRO_BIAS, None] * share[:, None, :]
        return np.concatenate([by_parameter[:, :, :GYRO_BIAS], bias], axis=2)

    def _evidence(self, values: FloatArray, jacobian: FloatArray) -> tuple[Evidence, FloatArray]:
        solved = Solved(values, np.zeros((0, 0)), self.knots_ns, self._noise)
        steps = [
            step.at(parameters)
            for step, parameters in zip(
                self._steps, solved.parameters(self._stamps_ns), strict=True
            )
        ]
        own = np.array([step_covariance(step, self._noise) for step in steps])
        T_odometry = np.array([step.T_first_last for step in steps])
        turned = np.array([step.wheel_turn_rad for step in steps])
        return (
            evidence(self._T_matched, self._information, T_odometry, turned, jacobian, own),
            own,
        )

    def _rest(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """At rest the gyroscope shows its bias: information, and its push."""
        seconds = np.array([step.rest_s for step in self._steps])
        turned = np.array([step.rest_turn_rad for step in self._steps])
        rows = np.zeros((len(seconds), self._size))
        rows[:, GYRO_SCALE] = turned
        rows[:, GYRO_BIAS:] = -seconds[:, None] * shares(self.knots_ns, self._stamps_ns)
        weight = np.zeros(len(seconds))
        resting = seconds > 0.0
        weight[resting] = 1.0 / (self._noise.config.gyro_rad_per_sqrt_s**2 * seconds[resting])
        residual = turned + rows @ values
        return rows.T @ (weight[:, None] * rows), rows.T @ (weight * residual)

    def _fitted(self, found: Evidence, own: FloatArray, known: FloatArray) -> OdometryNoise:
        """The noise that the residuals of held intervals show."""
        unit = replace(self._noise, path=1.0, turn=1.0, gyro=1.0)
        matched = np.linalg.inv(self._information + 1e-9 * np.eye(3))
        carried = np.einsum("nri,ij,nrj->nr", found.jacobian, known, found.jacobian)
        rows: tuple[list[tuple[float, float, float]], ...] = ([], [], [])
        for n in np.flatnonzero(self._held).tolist():
            step, square = self._steps[n], np.square(found.residual[n])
            if step.doubt.any() or step.path_m == 0.0:
                continue
            fixed = matched[n, 0, 0] + carried[n, 0] + step.reading_m**2
            rows[0].append((square[0], fixed, unit.path_variance(step)))
            fixed = matched[n, 2, 2] + carried[n, 3] + step.reading_rad**2
            rows[1].append((square[3], fixed, unit.wheel_turn_variance(step)))
            if np.isfinite(own[n, 3, 3]):
                fixed = matched[n, 2, 2] + carried[n, 2]
                rows[2].append((square[2], fixed, unit.gyro_variance(step)))
        path, turn, gyro = (fit_factor(np.array(row)) if row else 1.0 for row in rows)
        return replace(self._noise, path=path, turn=turn, gyro=max(gyro, LEAST_GYRO_FACTOR))


def closed_by_loops(
    alone: Solved,
    solved: Solved,
    intervals: Sequence[Interval],
    ends: Sequence[tuple[int, int]],
    poses: FloatArray,
    edges: Sequence[GraphEdge],
) -> Solved:
    """One Gauss-Newton step of calibration and poses (n, 3) together, these at their optimum.

    alone: without loops; solved: by which the chain was made. ends: (source, target) of each
    interval. edges: all of the graph, those of the chain as solved.
    """
    free = np.array([freedom(one, solved.noise) for one in intervals])
    loose = np.trace(free, axis1=1, axis2=2) > FREE_SHARE
    if not loose.any() or not any(edge.kind == "closure" and edge.weight > 0.0 for edge in edges):
        return solved
    chain = {(edge.source, edge.target): edge for edge in edges if edge.kind != "closure"}
    factor = graph_factor(poses, edges)
    size = len(solved.values)
    coupling, own, push = np.zeros((len(poses), 3, size)), np.zeros((size, size)), np.zeros(size)
    for n in np.flatnonzero(loose).tolist():
        a, b = ends[n]
        edge = chain[a, b]
        known = np.linalg.inv(edge_covariances([edge])[0])
        share = shares(solved.knots_ns, np.array([intervals[n].stamp_ns]))
        jacobian = intervals[n].step.jacobian[:3]
        jacobian = np.hstack([jacobian[:, :GYRO_BIAS], jacobian[:, GYRO_BIAS:] * share])
        # The step by which the measured step moves, in the frame of its end.
        moved = free[n] @ jacobian
        off = between(edge.T_source_target, between(poses[a], poses[b]))
        own += moved.T @ known @ moved
        push += moved.T @ known @ off
        coupling[b] += known @ moved
        coupling[a] -= adjoint(between(poses[b], poses[a])).T @ known @ moved
    moves = np.stack([factor.solve(column) for column in np.moveaxis(coupling[1:], 2, 0)], axis=2)
    gained = own - coupling[1:].reshape(-1, size).T @ moves.reshape(-1, size)
    known_alone = np.linalg.inv(alone.covariance)
    covariance = np.asarray(np.linalg.inv(known_alone + gained), np.float64)
    step = covariance @ (push - known_alone @ (solved.values - alone.values))
    return replace(solved, values=solved.values + step, covariance=covariance)


def moved_match(interval: Interval, T_used: FloatArray, solved: Solved) -> FloatArray:
    """(3,) the matched step once odometry says otherwise than when it was matched (T_used)."""
    renewed = solved.at(interval.step, interval.stamp_ns).T_first_last
    return compose(interval.T_matched, freedom(interval, solved.noise) @ between(T_used, renewed))
