"""The front end: scan by scan from raw sweeps to poses."""

from __future__ import annotations

import numpy as np

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between
from slamsim.core.result import Calibrated, Event, EventKind
from slamsim.core.types import Cloud, FloatArray, Scan
from slamsim.guard.numbers import require_mount
from slamsim.guard.quantities import as_count
from slamsim.slam.calibration.solve import Solved
from slamsim.slam.event_monitor import EventMonitor, TrackingState
from slamsim.slam.frontend.deskew import MAX_TILT_RAD, deskew, tilt_of
from slamsim.slam.frontend.lost_holds import LostHolds
from slamsim.slam.frontend.match_selection import MatchSelector
from slamsim.slam.frontend.motion import Odometry
from slamsim.slam.frontend.prediction import Prediction, Predictor
from slamsim.slam.frontend.sudden_steps import SuddenSteps
from slamsim.slam.frontend.tracking import Tracked
from slamsim.slam.matching import Match, Matcher, make_matcher
from slamsim.slam.matching.accumulate import ENOUGH_PIECES, ScanWindow, with_drift, worth_waiting

LOST_SCANS = 20
"""After so many scans in a row that fit nowhere the local map is begun anew."""

MIN_GRIP = 5
"""With fewer surface pieces than this no map is begun."""

ELSEWHERE_M, ELSEWHERE_RAD = 10.0, 2.0
ELSEWHERE = np.diag(np.square([ELSEWHERE_M, ELSEWHERE_M, ELSEWHERE_RAD]))
"""Covariance of where a robot is that was carried away."""

CARRIED = "what was seen contradicts what was seen just before, as if the robot had been carried"

CUT_BY_ENDS = 2
"""So many sweeps may reach beyond the ends of the odometry before it is worth telling."""


class FrontEnd:
    """Deskews, predicts, matches and gates one scan after the other.

    odometry: None for a robot that reports none; its speed is then taken as constant between scans.
    Raises SlamsimError for a lidar that is not level.
    """

    def __init__(
        self,
        config: FrontEndConfig,
        odometry: Odometry | None,
        T_base_laser: FloatArray,
    ) -> None:
        require_mount("T_base_laser", T_base_laser)
        self._config = config
        self._T_base_laser, self._tilt_rad = T_base_laser, tilt_of(T_base_laser)
        self._predictor = Predictor(config.motion, odometry)
        self._matcher = make_matcher(config)
        self._T_map_key: FloatArray | None = None
        self._selector = MatchSelector(config.matching.min_inlier_ratio)
        self._monitor = EventMonitor()
        self._window = ScanWindow()
        self._sudden, self._holds = SuddenSteps(), LostHolds()
        self._last_match: Match | None = None
        self._held_back = 0
        self.breaks_ns: list[int] = []
        """Where the trajectory is torn apart: stamps of the first scans after it, in order."""
        self.skipped = 0
        """Scans whose beams the motion does not cover."""
        self.unmatched = 0
        """Scans that fitted nowhere and were placed by the motion alone."""
        self.sudden_steps: list[Event] = []
        """Steps of the scans that no robot makes: to be told where places look alike."""
        self.lost_holds: list[Event] = []
        """Where what held the scans was gone all of a sudden: to be told where places look alike,
        unless loops agree."""
        self.restarts = 0
        """Times the local map was begun anew, the robot being lost."""

    def renew_motion(self, odometry: Odometry | None) -> None:
        """The odometry as it is known by now: any window from the last scan on will do."""
        self._predictor.renew_motion(odometry)

    def start_at(self, T_map_base: FloatArray) -> None:
        """Where the base stands at the first scan, (3,); the origin by default."""
        self._predictor.place(T_map_base, self._predictor.covariance)

    def begin_anew(self, matcher: Matcher) -> None:
        """Go on from here in an empty map, at no known speed."""
        self._predictor.rest()
        self._matcher, self._T_map_key = matcher, None
        self._holds = LostHolds()

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

        cloud = self._selector.standing(self._matcher, cloud, prediction)

        window = self._window.add(cloud, prediction.T_map_base)
        alone, together = (len(self._matcher.pieces(one)) for one in (cloud, window))
        if alone > 0 and worth_waiting(prediction, together):
            return self._hold_back(cloud, prediction)
        several, cloud = window is not cloud, window
        self._window.clear()

        match = self._match(cloud, prediction)
        if match is not None and several:
            match = with_drift(match, prediction)

        if match is not None and prediction.odometry is None:
            # Without odometry the motion within a sweep is best known from its own match.
            motion = self._predictor.motion_after(scan, match)
            cloud = deskew(scan, motion, scan.stamp_ns, self._T_base_laser)
            match = self._match(cloud, prediction) or match

        if match is not None:
            self._look_for_kidnapping(cloud, prediction, match)

        T_map_base = self._predictor.update(prediction, match)

        state = self._tracking_state(cloud, match)
        self._monitor.see(prediction, T_map_base, state, match)

        restart, suspect = self._restart(prediction) if state == "lost" else (None, False)

        keyscan = state in ("first", "matched") or restart is not None
        keyscan = keyscan and self._keep(cloud, T_map_base)

        information = np.zeros((3, 3)) if match is None else match.information
        self._last_match, self._held_back = match or self._last_match, 0
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
            self._selector.doubtful,
            suspect,
        )

    def _hold_back(self, cloud: Cloud, prediction: Prediction) -> Tracked:
        """A scan that is to be matched with the next ones."""
        T_map_base = self._predictor.hold(prediction)
        self._monitor.see(prediction, T_map_base, "held back")
        self._held_back += 1
        return Tracked(
            prediction.stamp_ns,
            T_map_base,
            prediction.T_odom_base,
            None,
            np.zeros((3, 3)),
            cloud,
            self._matcher.pieces(cloud),
            keyscan=False,
            odometry=self._predictor.step,
            held_back=True,
            match_before=self._last_match,
        )

    @property
    def recovered(self) -> int:
        """Scans that only a search around the prediction could place."""
        return self._selector.recovered

    @property
    def sighted(self) -> bool:
        """Whether any scan so far had enough returns for a map."""
        return self._T_map_key is not None or self.restarts > 0

    def events(self) -> tuple[Event, ...]:
        """What happened so far, and when."""
        happened = (*self._monitor.events(), *self._predictor.events())
        return tuple(sorted(happened, key=lambda event: event.start_ns))

    def calibrated(self, solved: Solved | None) -> dict[str, Calibrated]:
        """A calibration in the units of this robot."""
        return self._predictor.calibrated(solved)

    def warnings(self) -> tuple[str, ...]:
        """What went wrong so far, in words and counts."""
        told = (
            (
                self._tilt_rad > MAX_TILT_RAD,
                f"the lidar is tilted by {np.rad2deg(self._tilt_rad):.0f} degrees: its beams that "
                "look up or down steeply are not used",
            ),
            (
                self._predictor.blind,
                "no odometry: the speed was taken as constant between scans",
            ),
            (
                self.skipped > CUT_BY_ENDS,
                f"{as_count(self.skipped, 'scan')} skipped: the odometry does not cover "
                "their beams",
            ),
            (
                self.unmatched,
                f"{as_count(self.unmatched, 'scan')} fitted nowhere, placed by odometry alone",
            ),
            (
                self.recovered,
                f"{as_count(self.recovered, 'scan')} found by search after a bad prediction",
            ),
            (
                self.restarts,
                f"{as_count(self.restarts, 'time')} lost: the local map was begun anew",
            ),
            (
                self._predictor.jumps,
                f"{self._predictor.jumps} jumps of the odometry were not believed",
            ),
        )
        return tuple(words for count, words in told if count)

    def _look_for_kidnapping(self, cloud: Cloud, prediction: Prediction, match: Match) -> None:
        """What a match shows of it where places look alike, and the scan fits nevertheless."""
        step = self._sudden.see(prediction, match, self._selector.sigmas_off(match, prediction))
        if step is not None:
            self.sudden_steps.append(step)
        lost = self._holds.see(cloud, match)
        if lost is not None:
            self.lost_holds.append(lost)

    def _match(self, cloud: Cloud, prediction: Prediction) -> Match | None:
        """The match to believe; none while there is no map."""
        if self._T_map_key is None:
            return None
        coasting = self._predictor.coasting(prediction)
        return self._selector.place(self._matcher, cloud, prediction, coasting)

    def _tracking_state(self, cloud: Cloud, match: Match | None) -> TrackingState:
        if match is not None:
            return "matched"
        pieces = len(self._matcher.pieces(cloud))
        if self._T_map_key is None:
            return "blind" if pieces < MIN_GRIP else "first"
        blind = pieces < ENOUGH_PIECES
        self.unmatched += 1 + self._held_back
        if blind and self._selector.lost:
            self._selector.lost.pop()  # it is no evidence for being elsewhere
        return "blind" if blind else "lost"

    def _restart(self, prediction: Prediction) -> tuple[FloatArray | None, bool]:
        """Begin the local map anew if the robot has been lost for long; how surely it is here, and
        whether it may have been carried.

        Scans that contradict what was seen just before say at once that it may have been. Where
        odometry went on it tells nevertheless where the robot is if it was not.
        """
        lost = self._selector.lost
        if len(lost) < LOST_SCANS and not self._selector.elsewhere:
            return None, False
        carried, first_ns = self._selector.carried(), lost[0].stamp_ns
        known = not carried or all(one.odometry is not None and not one.jump for one in lost)
        if carried:
            self.breaks_ns.append(first_ns)
        words = CARRIED if self._selector.elsewhere else _anew(carried)
        kind: EventKind = "kidnapped" if carried else "lost"
        self._monitor.add(Event(first_ns, prediction.stamp_ns, kind, words))
        lost.clear()
        self._matcher.forget()
        self._T_map_key = None
        self.restarts += 1
        return prediction.covariance if known else ELSEWHERE, carried

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


def _anew(carried: bool) -> str:
    if carried:
        return "nothing fitted, as if the robot had been carried: the local map was begun anew"
    return "nothing fitted any more: the local map was begun anew, joined by odometry alone"
