"""Which match to believe: near the prediction, found by search, or none."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.frontend.kidnap_detection import Surroundings
from slamsim.slam.frontend.movers import Movers
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.frontend.standing import StandingThings
from slamsim.slam.matching import Match, Matcher

FAR_SIGMAS = 5.0
FAR_STRICTNESS = 0.75
"""A match that lies far from the prediction must fit nearly as well as scans usually do; one at
FAR_SIGMAS already half as much of what is asked of the farthest."""
CLEARLY = 0.02
"""Of the pieces of a scan: a place found by search is taken only if so much more of the scan lies
on the map there than near the prediction."""

TAIL_FREEDOM = 3.0
"""Odometry errs by its noise or, seldom, by far more: its step has a Student t distribution."""

LIKELY_SHARE, LIKELY_SIGMAS = 0.95, 2.8
"""A match as near the prediction as so many are needs not fit better than the prediction does; in
three dimensions that is within so many sigmas, if they are honest."""

AGREE_SIGMAS = 1.0
"""What walks along pulls each match by the same step, which is few sigmas where the odometry is
unsure. To leave out a thing that stood costs no more than what it tells."""

LEARN_GAIN = 0.1
PLAIN_SHARE = 0.95
"""Matches of which all but so little fits as usual tell what odometry is worth."""

NATS_A_PIECE = 1.0
"""How much likelier a place is at which one more piece lies on the map. By chance one in ten does,
which makes two nats, but neighbours on one wall tell the same."""

DOUBTFUL_SHARE = 0.8
"""Below this share of the usual one a search is worth its time, although the match may still be
right."""
USUAL_GAIN = 0.02
START_USUAL = 0.8
"""Before any scan was matched; then the mean over some fifty scans (a gain of USUAL_GAIN)."""
MIN_COVERED_RATIO = 0.3
"""A scan of which less meets the map at all has nothing to be held against."""

SLIP_M, SLIP_M_S = 0.2, 0.5
SLIP_RAD, SLIP_RAD_S = 0.4, 1.5
SLIP_FOR_S = 0.5
"""From one moment to the next no wheels are more wrong than this: they only seem to be where a
robot was carried to a place that looks alike."""

OTHER_GUESS_M = 0.1
OTHER_GUESS_RAD = 0.1
"""Guesses that are closer together lead to the same match."""


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """One scan, where odometry has it, and the map."""

    matcher: Matcher
    cloud: Cloud
    prediction: Prediction

    def support(self, T_map_base: FloatArray) -> float:
        return self.matcher.support(self.cloud, T_map_base)


class MatchSelector:
    """Judges matches by how well scans usually fit here.

    min_inlier_ratio: share of a scan, where the map covers it, that must lie on it.
    """

    def __init__(self, min_inlier_ratio: float) -> None:
        self._least = min_inlier_ratio
        self._usual_inliers = START_USUAL
        self._likely_sigmas = LIKELY_SIGMAS
        self._placed_ns = 0
        self._surroundings = Surroundings()
        self._movers, self._standing = Movers(), StandingThings()
        self.lost: list[Prediction] = []
        """Where the scans that fitted nowhere should have been, since the last that was placed
        without a second look: a lost robot finds what looks alike now and then."""
        self.recovered = 0
        """Scans that only a search could place."""
        self.doubtful = False
        """Whether the last scan was lost, or needed a second look."""
        self.elsewhere = False
        """Whether the last scans are of another place than those before them."""

    def standing(self, matcher: Matcher, cloud: Cloud, prediction: Prediction) -> Cloud:
        """The cloud without what is not known to stand, where that tells most."""
        known = self._movers.standing(cloud, prediction)
        return self._standing.left(known, prediction, matcher)

    def place(
        self, matcher: Matcher, cloud: Cloud, prediction: Prediction, T_map_coasting: FloatArray
    ) -> Match | None:
        """The match to believe. T_map_coasting: (3,) where the robot is if it went on as it did."""
        self.doubtful = self.elsewhere = False
        near = matcher.match(cloud, prediction.T_map_base, prediction.covariance)
        if near is not None:
            cloud, near = self._without_mover(matcher, cloud, prediction, near)
        look = _Look(matcher, cloud, prediction)
        if near is not None and not prediction.jump and self._as_usual(near, look):
            self._surroundings.placed(cloud, near.T_map_base)
            self.lost.clear()
            self._placed_ns = prediction.stamp_ns
            return near
        guesses = _other_guesses(prediction, T_map_coasting)
        found = [one for one in (near, *_searched(look, guesses)) if one is not None]
        reachable = [one for one in found if self._reachable(one, prediction, guesses)]
        believed = [
            one
            for one in reachable
            if self._believable(one, prediction)
            and self._outweighs_odometry(one, look)
            and self._surroundings.agree(cloud, one, self._expected(one, prediction))
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
        self._surroundings.placed(cloud, best.T_map_base)
        return best

    def _without_mover(
        self, matcher: Matcher, cloud: Cloud, prediction: Prediction, near: Match
    ) -> tuple[Cloud, Match]:
        """Whether a match agrees with odometry is asked by its own sigmas here, not by such as
        scans have shown: a thing that moves would widen them until it is believed."""

        def agrees(match: Match) -> bool:
            return prediction.distance(match) <= AGREE_SIGMAS

        def match(rest: Cloud) -> Match | None:
            return matcher.match_part(rest, prediction.T_map_base, prediction.covariance)

        if agrees(near) or not self._believable(near, prediction):  # then it is not used
            return cloud, near
        return self._movers.left_out(cloud, near, prediction, agrees, match)

    def carried(self) -> bool:
        """Whether the lost scans say that the robot was carried: their odometry jumped, or nothing
        fitted any more from one moment to the next: after a long while without a place, odometry
        is still the best that is known."""
        jumped = any(one.jump for one in self.lost)
        return jumped or self._soon_after_match(self.lost[0])

    def _soon_after_match(self, prediction: Prediction) -> bool:
        return prediction.stamp_ns - self._placed_ns < self._surroundings.kidnap_within_ns

    def _reachable(self, match: Match, prediction: Prediction, guesses: list[FloatArray]) -> bool:
        """Whether the robot can have come to a match, be the wheels as wrong as they may be."""
        soon = self._soon_after_match(self.lost[0] if self.lost else prediction)
        if prediction.odometry is None or not soon:
            return True
        seconds = min((prediction.stamp_ns - self._placed_ns) * 1e-9, SLIP_FOR_S)
        for guess in (prediction.T_map_base, *guesses):
            step = between(guess, match.T_map_base)
            near = np.hypot(step[0], step[1]) <= SLIP_M + SLIP_M_S * seconds
            if near and abs(step[2]) <= SLIP_RAD + SLIP_RAD_S * seconds:
                return True
        return False

    def _as_usual(self, match: Match, look: _Look) -> bool:
        """Whether a match near the prediction needs no second look."""
        expected = self._expected(match, look.prediction)
        good = match.inlier_ratio >= DOUBTFUL_SHARE * self._usual_inliers
        if not good or not self._believable(match, look.prediction):
            return False
        if not self._surroundings.agree(look.cloud, match, expected):
            return False
        self._learn_usual(match, look.prediction)
        return self._outweighs_odometry(match, look)

    def _believable(self, match: Match, prediction: Prediction) -> bool:
        """The further a match lies from the prediction, the better it has to fit."""
        squared = (self.sigmas_off(match, prediction) / FAR_SIGMAS) ** 2
        share = self._least + FAR_STRICTNESS * (1.0 - self._least) * squared / (1.0 + squared)
        needed = share * self._usual_inliers
        return match.inlier_ratio >= needed and match.covered_ratio >= MIN_COVERED_RATIO

    def sigmas_off(self, match: Match, prediction: Prediction) -> float:
        """How far a match lies from the prediction, in such sigmas as odometry shows here."""
        return prediction.distance(match) * (LIKELY_SIGMAS / self._likely_sigmas)

    def _outweighs_odometry(self, match: Match, look: _Look) -> bool:
        """Whether so much more of a scan lies on the map at a match than at the prediction that
        it is likelier that odometry is wrong than that the match is."""
        prediction = look.prediction
        sigmas = self.sigmas_off(match, prediction)
        if prediction.jump or sigmas <= LIKELY_SIGMAS:
            return True
        gain = look.support(match.T_map_base) - look.support(prediction.T_map_base)
        return NATS_A_PIECE * gain >= _surprise(sigmas) - _surprise(LIKELY_SIGMAS)

    def _expected(self, match: Match, prediction: Prediction) -> bool:
        return not prediction.jump and self.sigmas_off(match, prediction) <= LIKELY_SIGMAS

    def _learn_usual(self, match: Match, prediction: Prediction) -> None:
        """Follow how well scans usually fit, and how far from the prediction; never to less than
        its own noise explains."""
        self._usual_inliers += USUAL_GAIN * (match.inlier_ratio - self._usual_inliers)
        if match.fit < PLAIN_SHARE * self._usual_inliers:
            return  # among trees and ramps it may be the match that is wrong
        farther = prediction.distance(match) > self._likely_sigmas
        changed = self._likely_sigmas * math.exp(LEARN_GAIN * (farther - (1.0 - LIKELY_SHARE)))
        self._likely_sigmas = max(changed, LIKELY_SIGMAS)


def _surprise(sigmas: float) -> float:
    """Negative logarithm of the density of a step so many sigmas from the expected, relative to
    that of the expected one, for a Student t distribution in three dimensions."""
    exponent = 0.5 * (TAIL_FREEDOM + 3.0)
    return exponent * math.log1p(sigmas * sigmas / TAIL_FREEDOM)


def _other_guesses(prediction: Prediction, T_map_coasting: FloatArray) -> list[FloatArray]:
    """Where the robot is if the odometry is wrong: it stood, or it went on as it did."""
    guesses: list[FloatArray] = []
    for guess in (prediction.T_map_hold, T_map_coasting):
        if all(_apart(guess, other) for other in (prediction.T_map_base, *guesses)):
            guesses.append(guess)
    return guesses


def _searched(look: _Look, guesses: list[FloatArray]) -> list[Match | None]:
    """What a search around the prediction finds, and one near and around each other guess."""
    matcher, cloud, prediction = look.matcher, look.cloud, look.prediction
    found = [matcher.search(cloud, prediction.T_map_base, prediction.covariance)]
    for guess in guesses:
        found.append(matcher.match(cloud, guess, prediction.covariance))
        found.append(matcher.search(cloud, guess, prediction.covariance))
    return found


def _apart(guess: FloatArray, other: FloatArray) -> bool:
    step = between(other, guess)
    return bool(np.hypot(step[0], step[1]) > OTHER_GUESS_M or abs(step[2]) > OTHER_GUESS_RAD)
