"""Open-loop scripts of the basic drive and of UMBmark: commands as functions of time."""

from __future__ import annotations

import math

from slamsim.config.scenarios.basic_drive import StraightScript
from slamsim.config.scenarios.umbmark import SquareScript
from slamsim.sim.drive.script import CONTROL_HZ, Command

CORNERS = 4
CORNER_RAD = 0.5 * math.pi


def straight_commands(script: StraightScript) -> list[Command]:
    """Forth, stop, back, stop, with every speed: two commands to each stop."""
    rest = Command(script.rest_s, 0.0)
    return [
        command
        for speed_m_s in script.speeds_m_s
        for signed_m_s in (speed_m_s, -speed_m_s)
        for command in (Command(script.drive_s, signed_m_s), rest)
    ]


def square_commands(script: SquareScript, side_m: float, *, left: bool) -> list[Command]:
    """Four times a side, a stop, a corner, a stop; left: counter-clockwise.

    Speeds are changed a little so that sides and corners last whole control ticks: a command
    that is cut would look like an error of the wheels.
    """
    side_s = _ticks_s(side_m / script.speed_m_s)
    corner_s = _ticks_s(CORNER_RAD / script.yaw_rate_rad_s)
    turn_rad_s = (1.0 if left else -1.0) * CORNER_RAD / corner_s
    rest = Command(script.rest_s, 0.0)
    return [
        Command(side_s, side_m / side_s),
        rest,
        Command(corner_s, 0.0, turn_rad_s),
        rest,
    ] * CORNERS


def _ticks_s(duration_s: float) -> float:
    return max(round(duration_s * CONTROL_HZ), 1) / CONTROL_HZ
