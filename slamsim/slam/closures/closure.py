"""Loop closures: found by geometry, and believed only after trying to refute them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import adjoint, between, compose, rotation, transform_points
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.closures.correlative import LikelihoodGrid, Peak, Window, scores, search
from slamsim.slam.closures.relocalise import BESIDE_PATH_M
from slamsim.slam.closures.submaps import (
    FREE,
    UNKNOWN,
    GridCache,
    SpaceGrid,
    Submap,
    Surfaces,
    space_grid,
)
from slamsim.slam.matching.align import CONVERGED, COVERED, INLIERS, WEAK, align

Refusal = Literal["score", "ambiguous", "fit", "overlap", "contradiction", "unsupported"]

MAX_POINTS = 300
ALIGN_GATE_M = 0.3
ALIGN_START_SIGMAS = 20.0
ALIGN_ITERATIONS = 40
WEAK_SHARE = 0.01
SLIDE_M = 0.4
SLIDE_SHARE = 0.92
SLIDE_SIGMA_M = 1e3
"""Nothing is known along the corridor: hundreds of closures that slid alike must not add up."""

FOUND = np.diag(np.square([0.15, 0.15, 0.05]))
"""Covariance of where a search of the whole map finds a key frame."""

LOOSE = np.diag([1.0, 1.0, 4.0])
"""Information that stands in for what the surfaces do not hold: a metre and half a radian."""


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """A verified match. edge: from the submap's anchor to the key frame. expected: whether the
    estimate knew before where to find it. submap: number of the submap. path_m: of the key
    frame. witnesses: sensors that found it without one another."""

    edge: GraphEdge
    expected: bool
    submap: int
    path_m: float
    witnesses: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """T_submap_query: (3,) where the query should be, covariance: (3, 3) in the query's frame."""

    T_submap_query: FloatArray
    covariance: FloatArray


class ClosureFinder:
    """Matches queries with submaps and verifies what it finds."""

    def __init__(self, config: BackEndConfig) -> None:
        self._config = config
        self._grids = GridCache(config.submaps)
        self._scratch = Surfaces()

    def forget_grids(self) -> None:
        """Nothing is searched for now; they are built again when needed."""
        self._grids = GridCache(self._config.submaps)

    def find(
        self, query: Submap, number: int, submap: Submap, expected: Expected, noise_m: float
    ) -> Closure | Refusal:
        """The closure between a query (anchored at its key frame) and a submap, or why not."""
        limits = self._config.closures
        likelihood, space = self._grids.of(submap)
        middle = np.append(query.middle_m, 0.0)
        start = compose(expected.T_submap_query, middle)
        window = self._window(expected, middle)
        points = _thinned(query.points_m - query.middle_m)
        rival = (
            limits.ambiguity_ratio,
            limits.ambiguity_distance_m,
            float(np.deg2rad(limits.ambiguity_turn_deg)),
        )
        peak = search(likelihood, points, start, window, limits.min_score, rival)
        if peak is None:
            return "score"
        # In a small window another place is the same one slid along a wall: that is told below.
        surely_near = max(window.x_m, window.y_m) <= limits.sure_window_m
        if not surely_near and peak.rival > limits.ambiguity_ratio * peak.score:
            return "ambiguous"
        edge = self._refined(query, submap, peak, middle, noise_m)
        if isinstance(edge, str):
            return edge
        edge = _without_sliding(edge, likelihood, points, middle)
        expected_here = surely_near and sigmas_off(edge, expected) <= limits.gate_sigmas
        refusal = self._refuted(query, submap, space, edge.T_source_target, expected_here)
        if refusal is not None:
            return refusal
        return Closure(edge, expected_here, number, query.to_path_m)

    def placed(
        self, query: Submap, number: int, submap: Submap, T_submap_query: FloatArray
    ) -> Closure | Refusal:
        """The closure of a query that a search of the whole map found there, or why not.

        It is not registered: outdoors the same place fits within decimetres only. Others must agree
        with it before it counts, and what is then found nearby is exact. T_submap_query: (3,).
        """
        _, space = self._grids.of(submap)
        refusal = self._refuted(query, submap, space, T_submap_query, True, BESIDE_PATH_M)
        if refusal is not None:
            return refusal
        turn = rotation(np.asarray(T_submap_query[2]))
        covariance = turn @ FOUND @ turn.T
        edge = GraphEdge(submap.anchor, query.anchor, T_submap_query, covariance, "closure")
        return Closure(edge, False, number, query.to_path_m)

    def _window(self, expected: Expected, middle: FloatArray) -> Window:
        """The search about the middle of the query's points, in the frame of the submap."""
        limits = self._config.closures
        to_middle = adjoint(np.array([-middle[0], -middle[1], 0.0]))
        turn = rotation(np.asarray(expected.T_submap_query[2])) @ to_middle
        sigmas = np.sqrt(np.diag(turn @ expected.covariance @ turn.T))
        half_m = np.clip(limits.gate_sigmas * sigmas[:2], limits.min_window_m, limits.max_window_m)
        half_deg = float(
            np.clip(
                limits.gate_sigmas * np.rad2deg(sigmas[2]),
                limits.min_window_deg,
                limits.max_window_deg,
            )
        )
        return Window(float(half_m[0]), float(half_m[1]), float(np.deg2rad(half_deg)))

    def _refined(
        self, query: Submap, submap: Submap, peak: Peak, middle: FloatArray, noise_m: float
    ) -> GraphEdge | Refusal:
        """Point-to-line registration from the peak, with its covariance."""
        T_guess = compose(peak.T_grid_points, np.array([-middle[0], -middle[1], 0.0]))
        self._scratch.fill([(submap.surfaces, np.zeros(3))], noise_m)
        T, information, _, summary = align(
            query.surfaces,
            T_guess,
            T_guess,
            LOOSE,
            (ALIGN_GATE_M, ALIGN_START_SIGMAS, 1.0, WEAK_SHARE, ALIGN_ITERATIONS),
            self._scratch.grid,
        )
        limits, sizes = self._config.closures, self._config.graph
        inliers = summary[INLIERS] / max(summary[COVERED], 1.0)
        if not np.isfinite(T).all() or summary[CONVERGED] == 0.0 or inliers < limits.min_inliers:
            return "fit"
        if summary[WEAK] >= 2.0:
            return "fit"
        floor = np.diag(
            np.square([sizes.closure_sigma_m] * 2 + [np.deg2rad(sizes.closure_sigma_deg)])
        )
        covariance = np.linalg.inv(information / sizes.sigma_scale**2 + LOOSE) + floor
        turn = rotation(np.asarray(T[2]))
        return GraphEdge(submap.anchor, query.anchor, T, turn @ covariance @ turn.T, "closure")

    def _refuted(
        self,
        query: Submap,
        submap: Submap,
        space: SpaceGrid,
        T_submap_query: FloatArray,
        expected: bool,
        beside_m: float = np.inf,
    ) -> Refusal | None:
        """Whether too little of the two overlaps, or one has walls where the other saw through.

        Doors, people and panes of glass contradict as well: a match that was expected is allowed
        more of it. beside_m: surfaces of the submap farther than this from the query's key frames
        do not count.
        """
        limits = self._config.closures
        size = self._config.submaps
        seen = space.at(transform_points(T_submap_query, query.points_m))
        known = np.count_nonzero(seen != UNKNOWN)
        if known < limits.min_overlap * len(seen):
            return "overlap"
        query_space = space_grid(query, size.resolution_m, size.radius_m)
        T_query_submap = between(T_submap_query, np.zeros(3))
        theirs_m = transform_points(T_query_submap, submap.points_m)
        back = query_space.at(theirs_m[query.away_m(theirs_m) <= beside_m])
        allowed = limits.max_contradiction * (1.5 if expected else 1.0)
        for states in (seen, back):
            free, known = np.count_nonzero(states == FREE), np.count_nonzero(states != UNKNOWN)
            if free > allowed * known:
                return "contradiction"
        return None


def _thinned(points_m: FloatArray) -> FloatArray:
    return np.ascontiguousarray(points_m[:: max(1, -(-len(points_m) // MAX_POINTS))])


def _without_sliding(
    edge: GraphEdge, likelihood: LikelihoodGrid, points_m: FloatArray, middle: FloatArray
) -> GraphEdge:
    """The edge, uncertain along the direction in which the match could as well have slid.

    Along a corridor a few end pieces give the registration a certainty that they do not deserve;
    the likelihood of the whole, a few decimetres to either side, tells. points_m: (n, 2) about
    ``middle``, the pose of their mean in the frame of the target.
    """
    axes = np.linalg.eigh(edge.covariance[:2, :2])[1]
    offsets = np.array([-1.0, 1.0])[:, None] * SLIDE_M * axes[:, 1]
    here = compose(edge.T_source_target, middle)
    poses = here + np.concatenate([np.zeros((1, 3)), np.pad(offsets, ((0, 0), (0, 1)))])
    at = scores(likelihood, points_m, poses)
    if at[1:].max() <= SLIDE_SHARE * at[0]:
        return edge
    along = np.append(axes[:, 1], 0.0)
    covariance = edge.covariance + SLIDE_SIGMA_M**2 * np.outer(along, along)
    return replace(edge, covariance=covariance)


def sigmas_off(edge: GraphEdge, expected: Expected) -> float:
    """How many standard deviations the found pose is from the expected one."""
    step = between(expected.T_submap_query, edge.T_source_target)
    turn = rotation(np.asarray(-edge.T_source_target[2]))
    covariance = expected.covariance + turn @ edge.covariance @ turn.T
    return float(np.sqrt(step @ np.linalg.solve(covariance, step)))
