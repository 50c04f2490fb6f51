"""The front end: scan by scan from raw sweeps to poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import FrontEndConfig
from slamsim.geometry import between
from slamsim.slam.calibration_solve import Solved
from slamsim.slam.deskew import deskew
from slamsim.slam.matching import Match, Matcher, make_matcher
from slamsim.slam.motion import Odometry
from slamsim.slam.prediction import Prediction, Predictor
from slamsim.slam.steps import OdometryStep
from slamsim.slam.watch import Fate, Watch
from slamsim.types import Calibrated, Cloud, Event, FloatArray, Scan

FAR_SIGMAS = 5.0
FAR_STRICTNESS = 0.75
CLEARLY = 0.02
DOUBTFUL_SHARE = 0.8
USUAL_GAIN = 0.02
START_USUAL = 0.8
MIN_COVERED_RATIO = 0.3
LOST_SCANS = 20
"""After so many scans in a row that fit nowhere the local map is begun anew."""

MIN_GRIP = 8
"""A scan with fewer surface pieces than this is blind: it says nothing about where it is."""

COVERED_TO_JUDGE = 0.5
CONTRADICTED_SHARE = 0.5
ELSEWHERE_M, ELSEWHERE_RAD = 10.0, 2.0
"""Standard deviations of where a robot is that was carried away."""

OTHER_GUESS_M = 0.1
OTHER_GUESS_RAD = 0.1
"""Guesses that are closer together lead to the same match."""
CUT_BY_ENDS = 2
"""So many sweeps may reach beyond the ends of the odometry before it is worth telling."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the front end knows at one scan's stamp.

    T_map_base: (3,), drifting slowly, as no loop is closed here. T_odom_base: (3,) the
    prediction from wheels and gyroscope alone, at the same stamp. match: None where the scan
    fitted nowhere and the motion prediction was followed instead. information: (3, 3) of a
    small step of the base in its own frame relative to the local map, zero where nothing is
    known from the scan. pieces: (k, PIECE_FIELDS) of the cloud, in the base frame. keyscan:
    whether the scan entered the local map. restart: (3, 3), if a local map was begun anew here,
    of a small step of the base relative to the map before. odometry: what wheels and
    gyroscope say of the step since the last scan; None if nothing.
    """

    stamp_ns: int
    T_map_base: FloatArray
    T_odom_base: FloatArray
    match: Match | None
    information: FloatArray
    cloud: Cloud
    pieces: FloatArray
    keyscan: bool
    restart: FloatArray | None = None
    odometry: OdometryStep | None = None

    @property
    def match_quality(self) -> float:
        """Inlier ratio of the match, 0 without one."""
        return 0.0 if self.match is None else self.match.inlier_ratio

    @property
    def degenerate(self) -> bool:
        """Whether some direction was left to odometry."""
        return self.match is None or self.match.degenerate


class FrontEnd:
    """Deskews, predicts, matches and gates one scan after the other.

    odometry: None for a robot that reports none; its speed is then taken as constant between scans.
    """

    def __init__(
        self,
        config: FrontEndConfig,
        odometry: Odometry | None,
        T_base_laser: FloatArray,
    ) -> None:
        self._config = config
        self._T_base_laser = T_base_laser
        self._predictor = Predictor(config.motion, odometry)
        self._matcher = make_matcher(config)
        self._T_map_key: FloatArray | None = None
        self._usual_inliers = START_USUAL
        self._watch = Watch()
        self._lost: list[_Lost] = []
        self.breaks_ns: list[int] = []
        """Where the trajectory is torn apart: stamps of the first scans after it, in order."""
        self.skipped = 0
        """Scans whose beams the motion does not cover."""
        self.unmatched = 0
        """Scans that fitted nowhere and were placed by the motion alone."""
        self.recovered = 0
        """Scans that only a search around the prediction could place."""
        self.restarts = 0
        """Times the local map was begun anew, the robot being lost."""

    def renew_motion(self, odometry: Odometry | None) -> None:
        """The odometry as it is known by now: any window from the last scan on will do."""
        self._predictor.renew_motion(odometry)

    def start_at(self, T_map_base: FloatArray) -> None:
        """Where the base stands at the first scan, (3,); the origin if nobody says."""
        self._predictor.place(T_map_base, self._predictor.covariance)

    def begin_at(self, T_map_base: FloatArray, covariance: FloatArray, matcher: Matcher) -> None:
        """Go on from a pose (3,) that is known with a covariance (3, 3), in another map."""
        self._predictor.place(T_map_base, covariance)
        self._matcher, self._T_map_key = matcher, T_map_base
        self._usual_inliers = START_USUAL
        self._lost.clear()

    def begin_anew(self, matcher: Matcher) -> None:
        """Go on from here in an empty map."""
        self._matcher, self._T_map_key = matcher, None

    @property
    def T_map_base(self) -> FloatArray:  # noqa: N802
        """(3,) at the last scan."""
        return self._predictor.T_map_base

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of a small step of the base in its own frame, at the last scan."""
        return self._predictor.covariance

    def step(self, scan: Scan) -> Tracked | None:
        """Track one scan; None if it had to be skipped. Scans come in time order."""
        motion = self._predictor.motion_over(scan)
        if motion is None:
            self.skipped += 1
            return None

        cloud = deskew(scan, motion, scan.stamp_ns, self._T_base_laser)

        prediction = self._predictor.predict(scan.stamp_ns)

        match = self._match(cloud, prediction)

        if match is not None and prediction.odometry is None:
            # Without odometry the motion within a sweep is best known from its own match.
            motion = self._predictor.motion_after(scan, match)
            cloud = deskew(scan, motion, scan.stamp_ns, self._T_base_laser)
            match = self._match(cloud, prediction) or match

        T_map_base = self._predictor.update(prediction, match)

        fate = self._fate(cloud, match)
        self._watch.see(prediction, T_map_base, fate)

        restart = self._restart(prediction) if fate == "lost" else None

        keyscan = fate in ("first", "matched") or restart is not None
        keyscan = keyscan and self._keep(cloud, T_map_base)

        information = np.zeros((3, 3)) if match is None else match.information
        return Tracked(
            scan.stamp_ns,
            T_map_base,
            prediction.T_odom_base,
            match,
            information,
            cloud,
            self._matcher.pieces(cloud),
            keyscan,
            restart,
            self._predictor.step,
        )

    @property
    def sighted(self) -> bool:
        """Whether any scan so far had enough returns for a map."""
        return self._T_map_key is not None or self.restarts > 0

    def events(self) -> tuple[Event, ...]:
        """What happened so far, and when."""
        happened = (*self._watch.events(), *self._predictor.events())
        return tuple(sorted(happened, key=lambda event: event.start_ns))

    def calibrated(self, solved: Solved | None) -> dict[str, Calibrated]:
        """A calibration in the units of this robot."""
        return self._predictor.calibrated(solved)

    def warnings(self) -> tuple[str, ...]:
        """What went wrong so far, in words and counts."""
        told = (
            (
                self._predictor.blind,
                "no odometry: the speed was taken as constant between scans",
            ),
            (
                self.skipped > CUT_BY_ENDS,
                f"{self.skipped} scans skipped: the odometry does not cover their beams",
            ),
            (
                self.unmatched,
                f"{self.unmatched} scans fitted nowhere, placed by odometry alone",
            ),
            (
                self.recovered,
                f"{self.recovered} scans were found by search after a bad prediction",
            ),
            (
                self.restarts,
                f"{self.restarts} times lost: the local map was begun anew",
            ),
            (
                self._predictor.jumps,
                f"{self._predictor.jumps} jumps of the odometry were not believed",
            ),
        )
        return tuple(words for count, words in told if count)

    def _match(self, cloud: Cloud, prediction: Prediction) -> Match | None:
        """The match to believe: near the prediction, else by search, else none."""
        if self._T_map_key is None:
            return None
        near = self._matcher.match(cloud, prediction.T_map_base, prediction.covariance)
        if near is not None and not prediction.jump and self._as_usual(near, prediction):
            self._lost.clear()
            return near
        candidates = [near, *self._far_candidates(cloud, prediction)]
        believed = [one for one in candidates if one and self._believable(one, prediction)]
        best = max(believed, key=lambda one: one.fit, default=None)
        if best is None:
            self._lost.append(_Lost(prediction, _contradicted(candidates)))
            return None
        self._lost.clear()
        if near in believed and near.fit > best.fit - CLEARLY:
            return near
        self.recovered += 1
        return best

    def _far_candidates(self, cloud: Cloud, prediction: Prediction) -> list[Match | None]:
        """Matches searched for around the prediction, and where the odometry is wrong: as if the
        robot had stood, or gone on as it went."""
        candidates = [self._search(cloud, prediction.T_map_base, prediction)]
        guesses = [prediction.T_map_base]
        for guess in (prediction.T_map_hold, self._predictor.coasting(prediction)):
            if all(_apart(guess, other) for other in guesses):
                guesses.append(guess)
                candidates.append(self._matcher.match(cloud, guess, prediction.covariance))
                candidates.append(self._search(cloud, guess, prediction))
        return candidates

    def _search(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prediction: Prediction
    ) -> Match | None:
        return self._matcher.search(cloud, T_map_base_guess, prediction.covariance)

    def _as_usual(self, match: Match, prediction: Prediction) -> bool:
        """Whether a match near the prediction needs no second look."""
        good = match.inlier_ratio >= DOUBTFUL_SHARE * self._usual_inliers
        if good and self._believable(match, prediction):
            self._usual_inliers += USUAL_GAIN * (match.inlier_ratio - self._usual_inliers)
            return True
        return False

    def _believable(self, match: Match, prediction: Prediction) -> bool:
        """The further a match lies from the prediction, the better it has to fit."""
        squared = (prediction.distance(match) / FAR_SIGMAS) ** 2
        least = self._config.matching.min_inlier_ratio
        share = least + FAR_STRICTNESS * (1.0 - least) * squared / (1.0 + squared)
        needed = share * self._usual_inliers
        return match.inlier_ratio >= needed and match.covered_ratio >= MIN_COVERED_RATIO

    def _fate(self, cloud: Cloud, match: Match | None) -> Fate:
        if match is not None:
            return "matched"
        blind = len(self._matcher.pieces(cloud)) < MIN_GRIP
        if self._T_map_key is None:
            return "blind" if blind else "first"
        self.unmatched += 1
        if blind and self._lost:
            self._lost.pop()  # it is no evidence for being elsewhere
        return "blind" if blind else "lost"

    def _restart(self, prediction: Prediction) -> FloatArray | None:
        """Begin the local map anew if the robot has been lost for long; how surely it is here.

        Scans that contradict the map where the odometry puts them say that it was carried.
        """
        if len(self._lost) < LOST_SCANS:
            return None
        carried = any(one.prediction.jump for one in self._lost)
        against = sum(one.contradicted for one in self._lost)
        carried |= against > CONTRADICTED_SHARE * len(self._lost)
        first_ns = self._lost[0].prediction.stamp_ns
        if carried:
            self.breaks_ns.append(first_ns)
        self._watch.add(Event(first_ns, prediction.stamp_ns, "kidnapped", _anew(carried)))
        self._lost.clear()
        self._matcher.forget()
        self._T_map_key = None
        self.restarts += 1
        if carried:
            return np.diag(np.square([ELSEWHERE_M, ELSEWHERE_M, ELSEWHERE_RAD]))
        return prediction.covariance

    def _keep(self, cloud: Cloud, T_map_base: FloatArray) -> bool:
        """Insert the scan into the local map when the robot has moved enough since the last."""
        if self._T_map_key is not None:
            moved = between(self._T_map_key, T_map_base)
            options = self._config.local_map
            near = np.hypot(moved[0], moved[1]) < options.keyscan_distance_m
            if near and abs(moved[2]) < np.deg2rad(options.keyscan_turn_deg):
                return False
        self._matcher.insert(cloud, T_map_base)
        self._T_map_key = T_map_base
        return True


@dataclass(frozen=True, slots=True, eq=False)
class _Lost:
    """A scan that fitted nowhere, and whether it contradicts the map rather than leaving it."""

    prediction: Prediction
    contradicted: bool


def _contradicted(candidates: list[Match | None]) -> bool:
    return any(one is not None and one.covered_ratio > COVERED_TO_JUDGE for one in candidates)


def _apart(guess: FloatArray, other: FloatArray) -> bool:
    step = between(other, guess)
    return bool(np.hypot(step[0], step[1]) > OTHER_GUESS_M or abs(step[2]) > OTHER_GUESS_RAD)


def _anew(carried: bool) -> str:
    if carried:
        return "nothing fitted, as if the robot had been carried: the local map was begun anew"
    return "nothing fitted any more: the local map was begun anew, joined by odometry alone"
