"""Controllers: from the true pose to the twist command, many times a second."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Protocol

from slamsim.config.drive import FollowConfig, LimitsConfig
from slamsim.core.types import FloatArray
from slamsim.sim.drive.legs import SPACING_M, Leg, Route

Twist = tuple[float, float]
"""(forward m/s, yaw rate rad/s)."""

CREEP_M_S = 0.04
"""Slowest command on a path, so that the robot arrives instead of approaching for ever."""
ARRIVED_M = 0.01
"""Before the end of a path: at the slowest speed one tick goes less far."""
FACING_RAD = math.radians(2.0)
"""A turn on the spot ends within this, once the robot turns no faster than TURNED_RATE_RAD_S."""
TURNED_RATE_RAD_S = 0.05
"""Slower than a robot turns past its goal in one tick."""
SEARCH_POINTS = 12


class Follower(Protocol):
    """Something that drives. ``progress`` only grows while it gets on; its unit is its own."""

    done: bool
    progress: float

    def command(self, x_m: float, y_m: float, yaw_rad: float, yaw_rate_rad_s: float) -> Twist:
        """The wanted twist at this control tick, before acceleration limits."""

    def try_again(self) -> bool:
        """After the robot was backed up; False if there is nothing to try."""


class TwistPlayer:
    """Plays recorded commands, whatever comes of them."""

    def __init__(self, twists: FloatArray, tick_s: float) -> None:
        self._times: list[float] = twists[:, 0].tolist()
        self._twists: list[Twist] = [(row[1], row[2]) for row in twists.tolist()]
        self._tick_s, self._tick = tick_s, 0
        self.done, self.progress = False, 0.0

    def command(self, x_m: float, y_m: float, yaw_rad: float, yaw_rate_rad_s: float) -> Twist:
        # The added nanosecond keeps a tick that falls on a row's time from rounding before it.
        time_s = self._tick * self._tick_s + 1e-9
        self._tick += 1
        self.done = time_s >= self._times[-1]
        self.progress = time_s
        return (0.0, 0.0) if self.done else self._twists[bisect_right(self._times, time_s) - 1]

    def try_again(self) -> bool:
        return False


class PathFollower:
    """Pure pursuit (Coulter 1992) along legs, turning on the spot where it faces elsewhere."""

    def __init__(self, route: Route, follow: FollowConfig, limits: LimitsConfig) -> None:
        self._legs = route.legs
        self._ahead = max(round(follow.lookahead_m / SPACING_M), 1)
        self._turn_beyond_rad = math.radians(follow.turn_in_place_deg)
        self._limits = limits
        self._tick_s = 1.0 / follow.control_rate_hz
        self._leg_index, self._passed, self._at = -1, 0, 0
        self.done, self.progress = False, 0.0
        self._next_leg()

    def command(self, x_m: float, y_m: float, yaw_rad: float, yaw_rate_rad_s: float) -> Twist:
        while not self.done:
            twist = self._leg_command(x_m, y_m, yaw_rad, yaw_rate_rad_s)
            if twist is not None:
                return twist
            self._next_leg()
        return 0.0, 0.0

    def try_again(self) -> bool:
        """Look for the nearest point again, a little back on the path."""
        self._at = max(self._at - 2 * self._ahead, 0)
        self._turning = True
        return True

    def _next_leg(self) -> None:
        if self._leg_index >= 0:
            self._passed += len(self._x)
        self._leg_index += 1
        if self._leg_index == len(self._legs):
            self.done = True
            return
        leg = self._legs[self._leg_index]
        self._load(leg)
        self._at, self._turning, self._arrived = 0, True, self._last == 0

    def _load(self, leg: Leg) -> None:
        """Plain lists are several times faster than arrays for one number at a time."""
        self._x: list[float] = leg.points_m[:, 0].tolist()
        self._y: list[float] = leg.points_m[:, 1].tolist()
        self._speed: list[float] = leg.speeds_m_s.tolist()
        self._end_yaw = leg.end_yaw_rad
        self._rest_ticks = round(leg.rest_s / self._tick_s)
        dx, dy = self._x[-1] - self._x[-2], self._y[-1] - self._y[-2]
        length = math.hypot(dx, dy)
        self._last = len(self._x) - 1 if length > 0.0 else 0
        self._along = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)

    def _leg_command(
        self, x_m: float, y_m: float, yaw_rad: float, yaw_rate_rad_s: float
    ) -> Twist | None:
        """None when the leg is behind us."""
        if self._arrived:
            return self._at_the_end(yaw_rad, yaw_rate_rad_s)
        self._advance(x_m, y_m)
        left_m = (self._x[-1] - x_m) * self._along[0] + (self._y[-1] - y_m) * self._along[1]
        if self._at >= self._last - 2 and left_m < ARRIVED_M:
            self._arrived = True
            return self._at_the_end(yaw_rad, yaw_rate_rad_s)
        dx, dy = self._aim(x_m, y_m)
        error = _wrapped(math.atan2(dy, dx) - yaw_rad)
        if self._turning or abs(error) > self._turn_beyond_rad:
            self._turning = abs(error) > FACING_RAD or abs(yaw_rate_rad_s) > TURNED_RATE_RAD_S
            if self._turning:
                return 0.0, self._turn_rate(error)
        bend = 2.0 * math.sin(error) / math.hypot(dx, dy)
        speed = max(self._speed[self._at], CREEP_M_S)
        fastest = self._limits.max_yaw_rate_rad_s / max(abs(bend), 1e-9)
        speed = min(speed, fastest)
        return speed, speed * bend

    def _advance(self, x_m: float, y_m: float) -> None:
        """To the nearest of the next few points: a path may pass close by itself."""
        best, nearest = self._at, math.inf
        for i in range(self._at, min(self._at + SEARCH_POINTS, self._last) + 1):
            squared = (self._x[i] - x_m) ** 2 + (self._y[i] - y_m) ** 2
            if squared < nearest:
                best, nearest = i, squared
        self._at = best
        self.progress = max(self.progress, float(self._passed + best))

    def _aim(self, x_m: float, y_m: float) -> tuple[float, float]:
        """From the robot to the point ahead; past the end the leg is prolonged straight on."""
        target = self._at + self._ahead
        over_m = max(target - self._last, 0) * SPACING_M
        i = min(target, self._last)
        return (
            self._x[i] + over_m * self._along[0] - x_m,
            self._y[i] + over_m * self._along[1] - y_m,
        )

    def _at_the_end(self, yaw_rad: float, yaw_rate_rad_s: float) -> Twist | None:
        """Turn, then stand; None when both are done."""
        turn = self._final_turn(yaw_rad, yaw_rate_rad_s)
        if turn is not None or self._rest_ticks <= 0:
            return turn
        self._rest_ticks -= 1
        return 0.0, 0.0

    def _final_turn(self, yaw_rad: float, yaw_rate_rad_s: float) -> Twist | None:
        if self._end_yaw is None:
            return None
        error = _wrapped(self._end_yaw - yaw_rad)
        if abs(error) < FACING_RAD and abs(yaw_rate_rad_s) < TURNED_RATE_RAD_S:
            return None
        return 0.0, self._turn_rate(error)

    def _turn_rate(self, error_rad: float) -> float:
        """As fast as it can still be stopped in time."""
        braking = 0.5 * self._limits.max_yaw_acceleration_rad_s2
        rate = min(
            math.sqrt(2.0 * braking * abs(error_rad)),
            4.0 * abs(error_rad),
            self._limits.max_yaw_rate_rad_s,
        )
        return math.copysign(rate, error_rad)


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, math.tau)


def build_follower(route: Route, follow: FollowConfig, limits: LimitsConfig) -> Follower:
    """The controller for a route."""
    if route.twists is not None:
        return TwistPlayer(route.twists, 1.0 / follow.control_rate_hz)
    return PathFollower(route, follow, limits)
