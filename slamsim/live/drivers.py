"""Who drives a live robot: a person, a route, or the commands of an earlier drive."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from slamsim.config.drive import DriveConfig
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import require_number
from slamsim.live.controls import HOLD_S
from slamsim.sim.drive.drive_loop import BasePose
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.pilot import STANDING, Pilot
from slamsim.sim.drive.route import Route

FASTEST = 1e12
"""A twist beyond is an error of its sender; all others are cut down to the limits."""
_KEPT = 10_000


class ManualDriver:
    """Twists as they come, each held for a while of real time.

    A base at rest, and one whose commands stop coming, stands still.
    """

    ended = ""

    def __init__(self) -> None:
        self._twist, self._received_s, self._until_s = STANDING, 0.0, 0.0
        self._taken_s = 0.0
        self.delays_s: deque[float] = deque(maxlen=_KEPT)
        """From when a twist came to when the wheels were told, of the last ones."""

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """See ``Controls``. Raises BadNumbers."""
        require_number("the speed of a twist in m/s", speed_m_s, -FASTEST, FASTEST)
        require_number("the yaw rate of a twist in rad/s", yaw_rate_rad_s, -FASTEST, FASTEST)
        require_number("the seconds to hold a twist", hold_s, 0.0, 60.0)
        now_s = time.monotonic()
        self._twist = float(speed_m_s), float(yaw_rate_rad_s)
        self._received_s, self._until_s = now_s, now_s + hold_s

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        now_s, received_s = time.monotonic(), self._received_s
        if received_s != self._taken_s:
            self._taken_s = received_s
            self.delays_s.append(now_s - received_s)
        return self._twist if now_s < self._until_s else STANDING


PoseSource = Callable[[], FloatArray | None]
"""(3,) where the robot believes it is, in the frame of the route; None while it does not know."""


class RouteDriver:
    """Follows a route as ``simulate`` does, by the true pose or by what the robot believes.

    pose: None for the true one.
    """

    def __init__(self, route: Route, config: DriveConfig, pose: PoseSource | None = None) -> None:
        self._pilot, self._pose = Pilot(route, config), pose

    @property
    def ended(self) -> str:
        return self._pilot.ended

    @property
    def at_end(self) -> bool:
        """Whether it ended where the route does."""
        return self._pilot.at_end

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        if self._pose is not None:
            believed = self._pose()
            if believed is None or not np.isfinite(believed).all():
                return STANDING
            x_m, y_m, yaw_rad = believed.tolist()
            pose = BasePose(x_m, y_m, 0.0, yaw_rad, 1.0)
        self._pilot.decide(time_s, *pose)
        return self._pilot.command


class PlayedDriver:
    """The commands of an earlier drive, control tick by control tick.

    commands: (control tick from which on, twist), rising. ticks: how many the drive had.
    """

    def __init__(self, commands: Sequence[tuple[int, Twist]], ticks: int) -> None:
        self._commands, self._ticks = deque(commands), ticks
        self._tick, self._twist = 0, STANDING

    @property
    def ended(self) -> str:
        return "all commands were played" if self._tick >= self._ticks else ""

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        while self._commands and self._commands[0][0] <= self._tick:
            self._twist = self._commands.popleft()[1]
        self._tick += 1
        return self._twist
