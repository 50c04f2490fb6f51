"""Which match to believe: near the prediction, found by search, or none."""

from __future__ import annotations

import numpy as np

from slamsim.geometry import between
from slamsim.slam.matching import Match, Matcher
from slamsim.slam.prediction import Prediction
from slamsim.slam.sudden import SUDDEN_NS, Surroundings
from slamsim.types import Cloud, FloatArray

FAR_SIGMAS = 5.0
FAR_STRICTNESS = 0.75
CLEARLY = 0.02
DOUBTFUL_SHARE = 0.8
USUAL_GAIN = 0.02
START_USUAL = 0.8
MIN_COVERED_RATIO = 0.3

SLIP_M, SLIP_M_S = 0.2, 0.5
SLIP_RAD, SLIP_RAD_S = 0.4, 1.5
SLIP_FOR_S = 0.5
"""From one moment to the next no wheels are more wrong than this: they only seem to be where a
robot was carried to a place that looks alike."""

OTHER_GUESS_M = 0.1
OTHER_GUESS_RAD = 0.1
"""Guesses that are closer together lead to the same match."""


class Placer:
    """Judges matches by how well scans usually fit here.

    min_inlier_ratio: share of a scan, where the map covers it, that must lie on it.
    """

    def __init__(self, min_inlier_ratio: float) -> None:
        self._least = min_inlier_ratio
        self._usual_inliers = START_USUAL
        self._placed_ns = 0
        self._surroundings = Surroundings()
        self.lost: list[Prediction] = []
        """Where the scans since the last that was placed should have been."""
        self.recovered = 0
        """Scans that only a search could place."""
        self.doubtful = False
        """Whether the last scan was lost, or needed a second look."""
        self.elsewhere = False
        """Whether the last scans are of another place than those before them."""

    def begin(self) -> None:
        """In another map scans may fit as well as they like."""
        self._usual_inliers = START_USUAL
        self.lost.clear()
        self._surroundings.forget()

    def place(
        self, matcher: Matcher, cloud: Cloud, prediction: Prediction, T_map_coasting: FloatArray
    ) -> Match | None:
        """The match to believe. T_map_coasting: (3,) where the robot is if it went on as it did."""
        self.doubtful = self.elsewhere = False
        near = matcher.match(cloud, prediction.T_map_base, prediction.covariance)
        if near is not None and not prediction.jump and self._as_usual(near, prediction, cloud):
            self._placed(prediction, cloud, near)
            return near
        guesses = _other_guesses(prediction, T_map_coasting)
        found = [near, *_searched(matcher, cloud, prediction, guesses)]
        reachable = [one for one in found if one and self._reachable(one, prediction, guesses)]
        believed = [
            one
            for one in reachable
            if self._believable(one, prediction) and self._surroundings.agree(cloud, one)
        ]
        best = max(believed, key=lambda one: one.fit, default=None)
        if best is None:
            self.lost.append(prediction)
            self.doubtful = True
            tried = [*guesses, *(one.T_map_base for one in reachable)]
            self.elsewhere = self._surroundings.left(cloud, prediction.T_map_base, tried)
            return None
        self.doubtful = True
        if near in believed and near.fit > best.fit - CLEARLY:
            best = near
        else:
            self.recovered += 1
        self._placed(prediction, cloud, best)
        return best

    def carried(self) -> bool:
        """Whether the lost scans say that the robot was carried: their odometry jumped, or nothing
        fitted any more from one moment to the next: after a long while without a place, odometry
        is still the best that is known."""
        jumped = any(one.jump for one in self.lost)
        return jumped or self._sudden(self.lost[0])

    def _sudden(self, prediction: Prediction) -> bool:
        return prediction.stamp_ns - self._placed_ns < SUDDEN_NS

    def _reachable(self, match: Match, prediction: Prediction, guesses: list[FloatArray]) -> bool:
        """Whether the robot can have come to a match, be the wheels as wrong as they may be."""
        sudden = self._sudden(self.lost[0] if self.lost else prediction)
        if prediction.odometry is None or not sudden:
            return True
        seconds = min((prediction.stamp_ns - self._placed_ns) * 1e-9, SLIP_FOR_S)
        for guess in (prediction.T_map_base, *guesses):
            step = between(guess, match.T_map_base)
            near = np.hypot(step[0], step[1]) <= SLIP_M + SLIP_M_S * seconds
            if near and abs(step[2]) <= SLIP_RAD + SLIP_RAD_S * seconds:
                return True
        return False

    def _placed(self, prediction: Prediction, cloud: Cloud, match: Match) -> None:
        self._surroundings.placed(cloud, match.T_map_base)
        self.lost.clear()
        self._placed_ns = prediction.stamp_ns

    def _as_usual(self, match: Match, prediction: Prediction, cloud: Cloud) -> bool:
        """Whether a match near the prediction needs no second look."""
        good = match.inlier_ratio >= DOUBTFUL_SHARE * self._usual_inliers
        good = good and self._believable(match, prediction)
        if good and self._surroundings.agree(cloud, match):
            self._usual_inliers += USUAL_GAIN * (match.inlier_ratio - self._usual_inliers)
            return True
        return False

    def _believable(self, match: Match, prediction: Prediction) -> bool:
        """The further a match lies from the prediction, the better it has to fit."""
        squared = (prediction.distance(match) / FAR_SIGMAS) ** 2
        share = self._least + FAR_STRICTNESS * (1.0 - self._least) * squared / (1.0 + squared)
        needed = share * self._usual_inliers
        return match.inlier_ratio >= needed and match.covered_ratio >= MIN_COVERED_RATIO


def _other_guesses(prediction: Prediction, T_map_coasting: FloatArray) -> list[FloatArray]:
    """Where the robot is if the odometry is wrong: it stood, or it went on as it did."""
    guesses: list[FloatArray] = []
    for guess in (prediction.T_map_hold, T_map_coasting):
        if all(_apart(guess, other) for other in (prediction.T_map_base, *guesses)):
            guesses.append(guess)
    return guesses


def _searched(
    matcher: Matcher, cloud: Cloud, prediction: Prediction, guesses: list[FloatArray]
) -> list[Match | None]:
    """What a search around the prediction finds, and one near and around each other guess."""
    found = [matcher.search(cloud, prediction.T_map_base, prediction.covariance)]
    for guess in guesses:
        found.append(matcher.match(cloud, guess, prediction.covariance))
        found.append(matcher.search(cloud, guess, prediction.covariance))
    return found


def _apart(guess: FloatArray, other: FloatArray) -> bool:
    step = between(other, guess)
    return bool(np.hypot(step[0], step[1]) > OTHER_GUESS_M or abs(step[2]) > OTHER_GUESS_RAD)
