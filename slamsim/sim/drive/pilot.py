"""Decides the twist command of each control tick: rest, follow the route, back up, or give up;
detects a failed drive: stuck, tipped over, off the floor, not a number."""

from __future__ import annotations

import math

from slamsim.config.drive import DriveConfig, FollowConfig, LimitsConfig
from slamsim.sim.drive.follow import Follower, Twist, build_follower
from slamsim.sim.drive.legs import Route

STANDING: Twist = (0.0, 0.0)
"""No motion at all."""


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


MOVED_M = 0.05
MOVED_RAD = 0.2
COMMANDED_M_S = 0.01
COMMANDED_RAD_S = 0.05
FALLEN_M = 0.2
HOPELESS_FACTOR = 5.0
"""Moving about without progress along the path for so many times ``stuck_after_s`` is stuck too."""
FREED_PROGRESS = 20.0
"""Path points to get beyond where it was stuck before the robot may back up as often again."""
BACKING_M_S = -0.15
BACKING_S = 2.0
"""0.3 m back: about the radius of a robot, enough to turn clear of what it touched."""


class Supervisor:
    """Watches one drive, control tick by control tick."""

    def __init__(self, follow: FollowConfig, follower: Follower) -> None:
        self._follow, self._follower = follow, follower
        self._anchor = (math.inf, math.inf, 0.0)
        self._idle_s = self._stalled_s = 0.0
        self._progress = -1.0
        self._recoveries, self._stuck_at = 0, 0.0
        self._backing_s = 0.0

    def stuck(self, x_m: float, y_m: float, yaw_rad: float, command: Twist, tick_s: float) -> str:
        """What is wrong, in words, once the robot got nowhere for too long; else nothing."""
        if abs(command[0]) < COMMANDED_M_S and abs(command[1]) < COMMANDED_RAD_S:
            return ""
        turned = abs(math.remainder(yaw_rad - self._anchor[2], math.tau))
        moved = math.hypot(x_m - self._anchor[0], y_m - self._anchor[1])
        if not (moved < MOVED_M and turned < MOVED_RAD):
            self._anchor, self._idle_s = (x_m, y_m, yaw_rad), 0.0
        self._idle_s += tick_s
        self._stalled_s += tick_s
        if self._follower.progress > self._stuck_at + FREED_PROGRESS:
            self._recoveries = 0
        if self._follower.progress > self._progress:
            self._progress, self._stalled_s = self._follower.progress, 0.0
        limit_s = self._follow.stuck_after_s
        if self._idle_s < limit_s and self._stalled_s < HOPELESS_FACTOR * limit_s:
            return ""
        return (
            f"the robot is stuck at ({x_m:.2f}, {y_m:.2f}): commanded {command[0]:.2f} m/s and "
            f"{command[1]:.2f} rad/s, it got nowhere for {max(self._idle_s, self._stalled_s):.1f} s"
        )

    def recover(self) -> bool:
        """Begin to back up; False when it was tried often enough or makes no sense."""
        if self._recoveries >= self._follow.max_recoveries or not self._follower.try_again():
            return False
        self._recoveries += 1
        self._stuck_at = self._follower.progress
        self._backing_s = BACKING_S
        self._idle_s = self._stalled_s = 0.0
        return True

    def backing(self, tick_s: float) -> Twist | None:
        """The command while the robot backs up, else None."""
        if self._backing_s <= 0.0:
            return None
        self._backing_s -= tick_s
        return BACKING_M_S, 0.0


def upset(follow: FollowConfig, x_m: float, y_m: float, z_m: float, up: float) -> str:
    """What ends a drive at once, in words, or nothing; up is the cosine of the robot's tilt."""
    least_up = math.cos(math.radians(follow.max_tilt_deg))
    if up >= least_up and abs(z_m) <= FALLEN_M and math.isfinite(x_m + y_m):
        return ""
    if not math.isfinite(x_m + y_m + z_m + up):
        return "the physics became unstable: the robot's pose is not a number"
    where = f"at ({x_m:.2f}, {y_m:.2f})"
    if up < least_up:
        tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, up))))
        return (
            f"the robot tipped over {where}: it leans by {tilt_deg:.0f} degrees, "
            f"follow.max_tilt_deg is {follow.max_tilt_deg:g}"
        )
    return f"the robot left the floor {where}: it is {z_m:.2f} m above it"
