"""Our matcher: straight surface pieces, point-to-line, on a map of merged surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between
from slamsim.core.types import Cloud, FloatArray, IntArray
from slamsim.slam.matching.align import (
    COVERED,
    INLIERS,
    PULL,
    UNIT,
    WEAK,
    WEIGHTS,
    align,
    support,
    typical_range,
)
from slamsim.slam.matching.base import Match
from slamsim.slam.matching.local_map import LocalMap
from slamsim.slam.matching.range_noise import RangeNoise
from slamsim.slam.matching.search import coarse_poses
from slamsim.slam.matching.surfaces import surface_pieces

MIN_PARTNERS = 5
SEARCH_CANDIDATES = 6
NEAR_GATE_M = 0.1
NEAR_SIGMAS = 8.0
WIDE_SIGMAS = 20.0
START_FIT = 0.6
START_UNIT = 4.0
LEARN_GAIN = 0.02
UNIT_BOUNDS = (0.5, 50.0)
WORSE_FIT = 0.1
"""A match near the prediction is doubted when it fits this much worse than is usual here."""

WIDE_PENALTY = 0.05
FAR_PENALTY = 0.1
"""What a match at the edge of the search window must be better by than one at the guess."""


@dataclass(frozen=True, slots=True, eq=False)
class _Aligned:
    """A match, its fit: the mean robust weight of the scan's pieces, 1 if all lie exactly, and the
    variance of unit weight: how much larger residuals are than the noise model has them."""

    match: Match
    fit: float
    unit: float


class LineMatcher:
    """Point-to-line registration; see ``surfaces``, ``local_map`` and ``align`` for its parts."""

    def __init__(self, config: FrontEndConfig) -> None:
        self._matching = config.matching
        self._reach_m = config.max_range_m
        self._map = LocalMap(config.local_map.cell_m, config.local_map.window_m)
        self._noise = RangeNoise()
        self._usual_fit = START_FIT
        self._unit = START_UNIT
        self._cached: tuple[Cloud, FloatArray] | None = None

    @property
    def range_noise_m(self) -> float:
        """Standard deviation of a range, learnt from the scans so far."""
        return self._noise.sigma_m

    def pieces(self, cloud: Cloud) -> FloatArray:
        """See ``Matcher.pieces``; the noise estimate follows along."""
        if self._cached is not None and self._cached[0] is cloud:
            return self._cached[1]
        self._noise.see(cloud)
        pieces = self.pieces_of_part(cloud)
        self._noise.learn(pieces)
        self._cached = (cloud, pieces)
        return pieces

    def match(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.match``."""
        return self.match_pieces(self.pieces(cloud), T_map_base_guess, prior_covariance)

    def match_pieces(
        self, pieces: FloatArray, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """``match`` for the (k, PIECE_FIELDS) pieces of a cloud."""
        near = self._near(pieces, T_map_base_guess, prior_covariance)
        if near is None:
            return None
        self._usual_fit += LEARN_GAIN * (near.fit - self._usual_fit)
        unit = self._unit + LEARN_GAIN * (near.unit - self._unit)
        self._unit = float(np.clip(unit, *UNIT_BOUNDS))
        return near.match

    def match_part(
        self, part: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.match_part``."""
        near = self._near(self.pieces_of_part(part), T_map_base_guess, prior_covariance)
        return None if near is None else near.match

    def pieces_of_part(self, part: Cloud) -> FloatArray:
        """See ``Matcher.pieces_of_part``."""
        return surface_pieces(part, self._noise.sigma_m, self._map.cell_m, self._reach_m)

    def _near(
        self, pieces: FloatArray, guess: FloatArray, covariance: FloatArray
    ) -> _Aligned | None:
        if self._map.empty or len(pieces) == 0:
            return None
        prior = _inverse(covariance)
        near = self._align(pieces, guess, guess, prior, self._near_gate(pieces, covariance))
        if near is None or near.fit < self._usual_fit - WORSE_FIT:
            wide = self._align(pieces, guess, guess, prior, (self._matching.gate_m, WIDE_SIGMAS))
            if wide is not None and (near is None or wide.fit > near.fit + WIDE_PENALTY):
                near = wide
        return near

    def _near_gate(self, pieces: FloatArray, covariance: FloatArray) -> tuple[float, float]:
        """How far partners are when the prediction is right, in metres and in sigmas."""
        doubt_m = np.sqrt(np.trace(covariance[:2, :2]))
        doubt_m += typical_range(pieces) * np.sqrt(covariance[2, 2])
        gate_m = min(NEAR_GATE_M + 3.0 * float(doubt_m), self._matching.gate_m)
        return gate_m, NEAR_SIGMAS

    def search(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.search``."""
        return self.search_pieces(self.pieces(cloud), T_map_base_guess, prior_covariance)

    def search_pieces(
        self, pieces: FloatArray, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """``search`` for the (k, PIECE_FIELDS) pieces of a cloud."""
        if self._map.empty or len(pieces) < MIN_PARTNERS:
            return None
        window = (
            self._matching.search_distance_m,
            float(np.deg2rad(self._matching.search_turn_deg)),
        )
        starts = coarse_poses(pieces, T_map_base_guess, window, self._grid, SEARCH_CANDIDATES)
        # If the prediction is wrong it is so by any step within the window.
        spread = np.square(np.array([window[0], window[0], window[1]])) / 3.0
        prior = _inverse(prior_covariance + np.diag(spread))
        guess = T_map_base_guess
        gate = (self._matching.gate_m, WIDE_SIGMAS)
        found = [self._align(pieces, start, guess, prior, gate) for start in starts]

        def worth(one: _Aligned) -> float:
            step = between(guess, one.match.T_map_base)
            far = np.hypot(np.hypot(step[0], step[1]) / window[0], step[2] / window[1])
            return one.fit - float(FAR_PENALTY * far)

        best = max((one for one in found if one is not None), key=worth, default=None)
        return None if best is None else best.match

    def support(self, cloud: Cloud, T_map_base: FloatArray) -> float:
        """See ``Matcher.support``."""
        if self._map.empty:
            return 0.0
        return float(support(self.pieces(cloud), T_map_base, self._unit, self._grid))

    def insert(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """See ``Matcher.insert``."""
        self.insert_pieces(self.pieces(cloud), T_map_base)

    def insert_pieces(self, pieces: FloatArray, T_map_base: FloatArray) -> None:
        """``insert`` for the (k, PIECE_FIELDS) pieces of a cloud."""
        self._map.insert(pieces, T_map_base, self._noise.sigma_m)

    def forget(self) -> None:
        """See ``Matcher.forget``."""
        self._map.clear()

    @property
    def _grid(self) -> tuple[FloatArray, IntArray, float, float]:
        oldest_m = self._map.path_m - self._map.window_m
        return self._map.surfaces, self._map.keys, self._map.cell_m, oldest_m

    def _align(
        self,
        pieces: FloatArray,
        T_start: FloatArray,
        T_guess: FloatArray,
        prior: FloatArray,
        gate: tuple[float, float],
    ) -> _Aligned | None:
        options = self._matching
        limits = (
            *gate,
            self._unit,
            options.weak_direction_share,
            options.max_iterations,
        )
        T, information, axes, summary = align(pieces, T_start, T_guess, prior, limits, self._grid)
        if summary[INLIERS] < MIN_PARTNERS or not np.isfinite(T).all():
            return None
        match = Match(
            T_map_base=T,
            information=information,
            inlier_ratio=float(summary[INLIERS] / max(summary[COVERED], 1.0)),
            covered_ratio=float(summary[COVERED] / len(pieces)),
            degenerate_directions=axes[:, : int(summary[WEAK])].T.copy(),
            pull=summary[PULL : PULL + 3].copy(),
        )
        return _Aligned(match, float(summary[WEIGHTS] / len(pieces)), float(summary[UNIT]))


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
