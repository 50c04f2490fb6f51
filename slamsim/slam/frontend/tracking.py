"""What is known of a scan as soon as it has been tracked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from slamsim.core.geometry import compose, inverse
from slamsim.core.result import Event
from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.frontend.preintegration import OdometryStep
from slamsim.slam.matching import Match

Status = Literal["tracking", "searching", "lost"]
"""tracking: the scan lies on the map. searching: it fits nowhere near, odometry is followed.
lost: so for so long that the local map was begun anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the front end knows at one scan's stamp.

    T_map_base: (3,), drifting slowly, as no loop is closed here. T_odom_base: (3,) the
    prediction from wheels and gyroscope alone, at the same stamp. match: None where the scan
    fitted nowhere and the motion prediction was followed instead. information: (3, 3) of a
    small step of the base in its own frame relative to the local map, zero where nothing is
    known from the scan. pieces: (k, PIECE_FIELDS) of the cloud, in the base frame. keyscan:
    whether the scan entered the local map. restart: (3, 3), if a local map was begun anew here,
    of a small step of the base relative to the map before, if the robot was not carried. suspect:
    whether it may have been. doubtful: whether the scan was lost, or placed by a search. odometry:
    what wheels and gyroscope say of the step since the last scan; None if nothing. held_back:
    whether the scan is kept to be matched together with the next ones, and followed by odometry
    until then. match_before: the last match before such a scan.
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
    doubtful: bool = False
    suspect: bool = False
    held_back: bool = False
    match_before: Match | None = None

    @property
    def match_quality(self) -> float:
        """Inlier ratio of the match, 0 without one; of the last one for a scan held back."""
        match = self.match_before if self.held_back else self.match
        return 0.0 if match is None else match.inlier_ratio

    @property
    def degenerate(self) -> bool:
        """Whether some direction was left to odometry; at the last match for a scan held back."""
        match = self.match_before if self.held_back else self.match
        return match is None or match.degenerate


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What is known at a scan's stamp, as soon as it has been tracked.

    T_map_base: (3,) as corrected by all closures known by now; it may jump when one comes in. nan
    while nothing tells where the robot is in a map that is held fixed; its status is then lost.
    T_odom_base: (3,) from wheels and gyroscope alone, smooth (REP 105). covariance: (3, 3) of a
    small step of the base in its own frame, relative to the first key frame. match_quality:
    inlier ratio, 0 without a match. degenerate_directions: (k, 3) steps of the base, in its own
    frame, that the surfaces do not hold. events: what happened since the last step. keyframe: the
    index of the key frame that the scan became, with its cloud in the base frame; else None.
    """

    stamp_ns: int
    T_map_base: FloatArray
    T_odom_base: FloatArray
    covariance: FloatArray
    match_quality: float
    degenerate_directions: FloatArray
    status: Status
    events: tuple[Event, ...] = ()
    keyframe: int | None = None
    cloud: Cloud | None = None

    @property
    def T_map_odom(self) -> FloatArray:  # noqa: N802
        """(3,) what a robot publishes beside its odometry."""
        return compose(self.T_map_base, inverse(self.T_odom_base))
