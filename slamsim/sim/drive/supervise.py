"""Detects a failed drive: stuck, tipped over, off the floor, not a number."""

from __future__ import annotations

import math

from slamsim.config.drive import FollowConfig
from slamsim.sim.drive.follow import Follower, Twist

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
