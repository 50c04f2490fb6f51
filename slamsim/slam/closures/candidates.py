"""Which submaps may overlap with a key frame, given where both may be."""

from __future__ import annotations

import numpy as np

from slamsim.config.back_end import ClosureConfig
from slamsim.core.geometry import inverse, transform_points
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.estimate import Estimate
from slamsim.slam.closures.submaps import Submap


class CandidateIndex:
    """Anchors and middles of all submaps, in the order they were made, as growing arrays."""

    def __init__(self, config: ClosureConfig) -> None:
        self._config = config
        self._count = 0
        self._anchors: IntArray = np.zeros(64, dtype=np.int64)
        self._middles_m: FloatArray = np.zeros((64, 2))
        self._to_path_m: FloatArray = np.zeros(64)

    def add(self, submap: Submap) -> None:
        """One more submap, numbered in order from zero."""
        if self._count == len(self._anchors):
            self._anchors = np.concatenate([self._anchors, np.zeros_like(self._anchors)])
            self._middles_m = np.concatenate([self._middles_m, np.zeros_like(self._middles_m)])
            self._to_path_m = np.concatenate([self._to_path_m, np.zeros_like(self._to_path_m)])
        self._anchors[self._count] = submap.anchor
        self._middles_m[self._count] = submap.middle_m
        self._to_path_m[self._count] = submap.to_path_m
        self._count += 1

    def of(self, query: Submap, estimate: Estimate, before_m: float) -> list[int]:
        """Numbers of the submaps near enough to overlap; nearest first, few, not neighbours.

        before_m: those that end before this much path, however near the query, are no part of what
        it follows on.

        Nearness is that of the middles of what was seen, not of where the robot stood, so that
        a lidar that looks one way only finds what it sees on the way back.
        """
        limits = self._config
        middles_m, distance_m = self._left_behind(query, estimate, before_m)
        near = np.flatnonzero(distance_m <= limits.reach_m + limits.max_window_m)
        window_m = self._windows_m(query, estimate, near, middles_m[near])
        here = distance_m[near] <= limits.reach_m + window_m
        near = near[here & (window_m <= limits.max_window_m)]
        chosen: list[int] = []
        for number in near[np.argsort(distance_m[near], kind="stable")].tolist():
            if all(abs(number - other) > 1 for other in chosen):
                chosen.append(number)
            if len(chosen) == limits.max_candidates:
                break
        return chosen

    def anywhere(self, query: Submap, estimate: Estimate, before_m: float) -> list[int]:
        """Numbers of the submaps that the query may overlap with, for all that is known, but where
        a search would have to reach farther than ``max_window_m``."""
        limits = self._config
        window_m, distance_m = self._all_windows_m(query, estimate, before_m)
        within = distance_m <= limits.reach_m + window_m
        return np.flatnonzero(within & (window_m > limits.max_window_m)).tolist()

    def within_reach(self, query: Submap, estimate: Estimate) -> list[int]:
        """Numbers of the submaps of which the estimate knows well enough where they are that a
        search near it would find the query in them."""
        window_m, _ = self._all_windows_m(query, estimate, -np.inf)
        return np.flatnonzero(window_m <= self._config.max_window_m).tolist()

    def _all_windows_m(
        self, query: Submap, estimate: Estimate, before_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """(m,) windows of the first m submaps, which were left behind far enough back, and their
        (m,) distances from the query."""
        middles_m, distance_m = self._left_behind(query, estimate, before_m)
        numbers = np.arange(len(middles_m))
        return self._windows_m(query, estimate, numbers, middles_m), distance_m

    def _left_behind(
        self, query: Submap, estimate: Estimate, before_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """(m, 2) middles in the map frame of the first m submaps, which were left behind far enough
        back, and their (m,) distances from the query."""
        behind_m = max(query.to_path_m - self._config.min_travel_m, before_m)
        count = int(np.searchsorted(self._to_path_m[: self._count], behind_m))
        anchors = self._anchors[:count]
        middles_m = transform_points(estimate.poses[anchors], self._middles_m[:count])
        here_m = transform_points(estimate.poses[query.anchor], query.middle_m)
        return middles_m, np.hypot(*(middles_m - here_m).T)

    def _windows_m(
        self, query: Submap, estimate: Estimate, numbers: IntArray, middles_m: FloatArray
    ) -> FloatArray:
        """(m,) how far from where the estimate has it a submap may be, as seen by the query."""
        if not len(numbers):
            return np.zeros(0)
        sigmas_m = _position_sigmas(estimate, self._anchors[numbers], query.anchor, middles_m)
        return self._config.gate_sigmas * sigmas_m


def _position_sigmas(
    estimate: Estimate, anchors: IntArray, later: int, at_m: FloatArray
) -> FloatArray:
    """(m,) standard deviation of points (m, 2) that move with each anchor, as seen later."""
    covariances = estimate.covariances(anchors, later)
    seen_m = transform_points(inverse(estimate.poses[later]), at_m)
    lever = np.tile(np.eye(3)[:2], (len(anchors), 1, 1))
    lever[:, 0, 2], lever[:, 1, 2] = -seen_m[:, 1], seen_m[:, 0]
    spread = lever @ covariances @ np.swapaxes(lever, 1, 2)
    return np.asarray(np.sqrt(np.trace(spread, axis1=1, axis2=2)))
