"""The ``Controls`` of a live robot, over its loop."""

from __future__ import annotations

from pathlib import Path

from slamsim.guard.numbers import require_number
from slamsim.live.controls import HOLD_S, Mode, Status
from slamsim.live.loop import LiveLoop


class LoopControls:
    """See ``Controls`` for all of its methods."""

    def __init__(self, loop: LiveLoop) -> None:
        self._loop, self._calls = loop, loop.calls

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """See ``Controls``."""
        steering = self._loop.steering
        steering.manual.drive(speed_m_s, yaw_rate_rad_s, hold_s)
        if not steering.is_driven_by_twists:
            twist = speed_m_s, yaw_rate_rad_s, hold_s
            self._calls.ask(lambda: steering.take_over(*twist))

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        """See ``Controls``."""
        steering = self._loop.steering
        route = steering.route_to(x_m, y_m, yaw_rad)
        self._calls.ask(lambda: steering.go(route))

    def set_mode(self, mode: Mode) -> None:
        """See ``Controls``."""
        loop = self._loop
        self._calls.ask(lambda: loop.steering.switch(mode, loop.true_pose))

    def pause(self, paused: bool) -> None:
        """See ``Controls``."""
        loop = self._loop
        self._calls.ask(lambda: loop.set_pace(loop.pace.rate, paused))

    def step(self, seconds: float) -> None:
        """See ``Controls``."""
        require_number("the seconds to step", seconds, 1e-3, 60.0)
        self._calls.ask(lambda: self._loop.step(seconds))

    def set_rate(self, rate: float | None) -> None:
        """See ``Controls``."""
        loop = self._loop
        if rate is not None:
            require_number("the rate", rate, 0.01, 100.0)
        self._calls.ask(lambda: loop.set_pace(rate, loop.pace.paused))

    def reset(self) -> None:
        """See ``Controls``."""
        self._calls.answer(self._loop.reset)

    def record(self, on: bool) -> Path | None:
        """See ``Controls``."""
        loop = self._loop
        return self._calls.answer(loop.begin_recording if on else loop.end_recording)

    def save_map(self) -> Path:
        """See ``Controls``."""
        return self._loop.known.save(self._loop.setup.folder)

    def status(self) -> Status:
        """See ``Controls``."""
        return self._loop.status
