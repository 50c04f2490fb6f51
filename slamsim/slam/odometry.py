"""The front end: scan by scan from raw sweeps to poses."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.config.slam import FrontEndConfig
from slamsim.slam.matching.base import Match
from slamsim.types import Cloud, FloatArray, PlanarTrajectory, Scan


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the front end knows at one scan's stamp.

    T_map_base: (3,), drifting slowly, as no loop is closed here. T_odom_base: (3,) the
    prediction from wheels and gyroscope alone, at the same stamp. match: None where the scan fitted
    nowhere and the motion prediction was followed instead. information: (3, 3) of a small step
    of the base in its own frame relative to the local map, zero where nothing is known from the
    scan. keyscan: whether the scan entered the local map.
    """

    stamp_ns: int
    T_map_base: FloatArray
    T_odom_base: FloatArray
    match: Match | None
    information: FloatArray
    cloud: Cloud
    keyscan: bool

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

    motion: T_odom_base, or None for a robot that reports none (its speed is then
    taken as constant between scans).
    """

    def __init__(
        self, config: FrontEndConfig, motion: PlanarTrajectory | None, T_base_laser: FloatArray
    ) -> None:
        self._config = config
        self._motion = motion
        self._T_base_laser = T_base_laser
        self.skipped = 0
        """Scans whose beams the motion does not cover."""

    def step(self, scan: Scan) -> Tracked | None:
        """Track one scan; None if it had to be skipped. Scans come in time order."""
        raise NotImplementedError

    def warnings(self) -> tuple[str, ...]:
        """What went wrong so far, in words and counts."""
        raise NotImplementedError
