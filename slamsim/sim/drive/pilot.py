"""Decides the twist command of each control tick: rest, follow the route, back up, or give up."""

from __future__ import annotations

import math

from slamsim.config.drive import DriveConfig, LimitsConfig
from slamsim.sim.drive.follow import Twist, build_follower
from slamsim.sim.drive.route import Route
from slamsim.sim.drive.supervise import Supervisor, upset

STANDING: Twist = (0.0, 0.0)


class Pilot:
    """One drive's decisions. ended tells in words why it is over, empty while it is not.

    finished: whether it ended as planned: at the end of the route or at the largest duration.
    """

    def __init__(self, route: Route, config: DriveConfig) -> None:
        self._config = config
        self._tick_s = 1.0 / config.follow.control_rate_hz
        self._follower = build_follower(route, config.follow, config.limits)
        self._supervisor = Supervisor(config.follow, self._follower)
        self._stop_at_s = stop_at_s(config)
        self._rest_ticks = math.ceil(config.follow.final_standstill_s / self._tick_s)
        self._resting = False
        self.command = STANDING
        self.finished, self.ended = False, ""

    @property
    def at_end(self) -> bool:
        """Whether it ended where the route does."""
        return self.finished and self._follower.done

    def decide(
        self, time_s: float, x_m: float, y_m: float, z_m: float, yaw_rad: float, up: float
    ) -> None:
        """The next command from the true pose; up is the cosine of the robot's tilt."""
        self.ended = upset(self._config.follow, x_m, y_m, z_m, up)
        wanted = STANDING if self.ended else self._wanted(time_s, x_m, y_m, yaw_rad)
        self.command = limited(self.command, wanted, self._config.limits, self._tick_s)

    def _wanted(self, time_s: float, x_m: float, y_m: float, yaw_rad: float) -> Twist:
        if time_s + 1e-9 < self._config.follow.standstill_s:
            return STANDING
        if self._resting or self._follower.done or time_s >= self._stop_at_s:
            self._rest()
            return STANDING
        supervisor = self._supervisor
        trouble = supervisor.stuck(x_m, y_m, yaw_rad, self.command, self._tick_s)
        if trouble and not supervisor.recover():
            self.ended = trouble
            return STANDING
        backing = supervisor.backing(self._tick_s)
        if backing is not None:
            return backing
        return self._follower.command(x_m, y_m, yaw_rad, self.command[1])

    def _rest(self) -> None:
        """Brake, then stand still for the configured time, then end."""
        self._resting = True
        if self.command != STANDING:
            return
        self._rest_ticks -= 1
        if self._rest_ticks < 0:
            self.finished = True
            self.ended = (
                "the route was driven to its end"
                if self._follower.done
                else f"stopped for route.max_duration_s {self._config.route.max_duration_s:g}"
            )


def limited(current: Twist, wanted: Twist, limits: LimitsConfig, tick_s: float) -> Twist:
    """The next command: as near to the wanted one as the limits let it come in one tick."""
    if wanted == current:
        return current
    step_m_s = limits.max_acceleration_m_s2 * tick_s
    step_rad_s = limits.max_yaw_acceleration_rad_s2 * tick_s
    speed = max(-limits.max_speed_m_s, min(limits.max_speed_m_s, wanted[0]))
    rate = max(-limits.max_yaw_rate_rad_s, min(limits.max_yaw_rate_rad_s, wanted[1]))
    return (
        max(current[0] - step_m_s, min(current[0] + step_m_s, speed)),
        max(current[1] - step_rad_s, min(current[1] + step_rad_s, rate)),
    )


def stop_at_s(config: DriveConfig) -> float:
    """When to begin to stop so that the largest duration is kept."""
    if config.route.max_duration_s is None:
        return math.inf
    limits = config.limits
    braking_s = max(
        limits.max_speed_m_s / limits.max_acceleration_m_s2,
        limits.max_yaw_rate_rad_s / limits.max_yaw_acceleration_rad_s2,
    )
    ticks_s = 2.0 / config.follow.control_rate_hz
    return config.route.max_duration_s - config.follow.final_standstill_s - braking_s - ticks_s
