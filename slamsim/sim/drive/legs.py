"""What a route is made of: lines to drive along, and the speed to have at each of their points.

Apart from planning, whose libraries take 0.3 s to load: the process that drives needs none of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import LimitsConfig
from slamsim.core.types import FloatArray

if TYPE_CHECKING:
    from slamsim.sim.drive.space import Space

SPACING_M = 0.025
SLOWEST_SHARE = 0.4
"""Share of the top speed at which the robot passes where it only just fits."""
SLOWED_WITHIN_M = 0.25
"""Spare room below which it slows down."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A line to drive along, forwards, to a stop; the robot first turns into its direction.

    points_m: (n, 2) evenly spaced, in the map frame. speeds_m_s: (n,) speed to have there.
    end_yaw_rad: heading to turn to at the end, None for any. rest_s: time to stand there then.
    """

    points_m: FloatArray
    speeds_m_s: FloatArray
    end_yaw_rad: float | None = None
    rest_s: float = 0.0

    def length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.points_m, axis=0), axis=1).sum())

    def heading_rad(self) -> float:
        """Into which it ends."""
        dx, dy = self.points_m[-1] - self.points_m[-2]
        return float(np.arctan2(dy, dx))

    def first(self, last: int, limits: LimitsConfig) -> Leg:
        """Up to that point, where it ends in a stop."""
        points_m = self.points_m[: last + 1]
        stop = speed_profile(points_m, None, limits)
        return Leg(points_m, np.minimum(self.speeds_m_s[: last + 1], stop))

    def rest(self, start: int) -> Leg:
        """From that point on."""
        return replace(self, points_m=self.points_m[start:], speeds_m_s=self.speeds_m_s[start:])


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Either legs or twists: (n, 3) rows of (t_s, v_m_s, w_rad_s), each held until the next.

    The last twist only tells when the route ends.
    """

    legs: tuple[Leg, ...]
    twists: FloatArray | None
    length_m: float
    duration_estimate_s: float


def curvature_1_m(line_m: FloatArray) -> FloatArray:
    """(n,) signed curvature of an evenly spaced line (n, 2)."""
    if len(line_m) < 3:
        return np.zeros(len(line_m))
    first = np.gradient(line_m, axis=0)
    second = np.gradient(first, axis=0)
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(cross / np.maximum(np.linalg.norm(first, axis=1), 1e-12) ** 3)


def speed_profile(line_m: FloatArray, space: Space | None, limits: LimitsConfig) -> FloatArray:
    """(n,) speed to have at each point: bends, walls and the stop at the end are allowed for.

    Only the braking side is limited here; how fast the robot speeds up is the commands' affair.
    """
    bend = np.maximum(np.abs(curvature_1_m(line_m)), 1e-9)
    speed = np.minimum.reduce(
        [
            np.full(len(line_m), limits.max_speed_m_s),
            np.sqrt(limits.max_lateral_acceleration_m_s2 / bend),
            0.8 * limits.max_yaw_rate_rad_s / bend,
        ]
    )
    if space is not None:
        spare_m = space.room_at_m(line_m) - space.needed_m
        share = np.clip(spare_m / SLOWED_WITHIN_M, 0.0, 1.0)
        speed = speed * (SLOWEST_SHARE + (1.0 - SLOWEST_SHARE) * share)
    return _brake_in_time(line_m, speed, 0.7 * limits.max_acceleration_m_s2)


def _brake_in_time(line_m: FloatArray, speed: FloatArray, braking_m_s2: float) -> FloatArray:
    steps_m = np.linalg.norm(np.diff(line_m, axis=0), axis=1)
    braked = speed.copy()
    braked[-1] = 0.0
    for i in range(len(speed) - 2, -1, -1):
        reachable = np.sqrt(braked[i + 1] ** 2 + 2.0 * braking_m_s2 * steps_m[i])
        braked[i] = min(braked[i], reachable)
    return braked
