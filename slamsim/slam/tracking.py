"""What is known of a scan as soon as it has been tracked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from slamsim.geometry import compose, inverse
from slamsim.result import Event
from slamsim.types import FloatArray

Status = Literal["tracking", "searching", "lost"]
"""tracking: the scan lies on the map. searching: it fits nowhere near, odometry is followed.
lost: so for so long that the local map was begun anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What is known at a scan's stamp, as soon as it has been tracked.

    T_map_base: (3,) as corrected by all closures known by now; it may jump when one comes in.
    T_odom_base: (3,) from wheels and gyroscope alone, smooth (REP 105). covariance: (3, 3) of a
    small step of the base in its own frame, relative to the first key frame. match_quality:
    inlier ratio, 0 without a match. degenerate_directions: (k, 3) steps of the base, in its own
    frame, that the surfaces do not hold. events: what happened since the last step.
    """

    stamp_ns: int
    T_map_base: FloatArray
    T_odom_base: FloatArray
    covariance: FloatArray
    match_quality: float
    degenerate_directions: FloatArray
    status: Status
    events: tuple[Event, ...] = ()

    @property
    def T_map_odom(self) -> FloatArray:  # noqa: N802
        """(3,) what a robot publishes beside its odometry."""
        return compose(self.T_map_base, inverse(self.T_odom_base))
