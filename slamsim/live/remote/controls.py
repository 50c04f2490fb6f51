"""The ``Controls`` of a robot that runs elsewhere."""

from __future__ import annotations

from pathlib import Path

from slamsim.guard.errors import SlamsimError
from slamsim.live.controls import HOLD_S, Mode, Status
from slamsim.live.remote.robot import RemoteRobot


class RemoteControls:
    """See ``Controls`` for all of its methods. What only a simulation can do is refused."""

    def __init__(self, robot: RemoteRobot) -> None:
        self._robot = robot

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """See ``Controls``."""
        self._robot.teleop.drive(speed_m_s, yaw_rate_rad_s, hold_s)

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        """See ``Controls``: the robot's own navigation is asked."""
        self._robot.teleop.go_to(x_m, y_m, yaw_rad)

    def set_mode(self, mode: Mode) -> None:
        """See ``Controls``."""
        if mode != "manual":
            raise _not_simulated("drives no tour")

    def pause(self, paused: bool) -> None:
        """See ``Controls``."""
        raise _not_simulated("cannot be paused")

    def step(self, seconds: float) -> None:
        """See ``Controls``."""
        raise _not_simulated("cannot be stepped")

    def set_rate(self, rate: float | None) -> None:
        """See ``Controls``."""
        raise _not_simulated("lives in real time")

    def reset(self) -> None:
        """See ``Controls``: a new map is begun."""
        self._robot.calls.answer(self._robot.reset)

    def record(self, on: bool) -> Path | None:
        """See ``Controls``."""
        robot = self._robot
        return robot.calls.answer(robot.begin_recording if on else robot.recordings.end)

    def save_map(self) -> Path:
        """See ``Controls``."""
        return self._robot.known.save(self._robot.setup.folder)

    def status(self) -> Status:
        """See ``Controls``."""
        return self._robot.status


def _not_simulated(what: str) -> SlamsimError:
    return SlamsimError(f"a robot that is not simulated here {what}")
