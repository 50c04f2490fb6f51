"""Robots that drive the open-loop scripts of the basic drive and of UMBmark, run after run:
commands, what is read of a run, the figures of the 2019 study."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.bundled import find_input
from slamsim.config.loading import load_model
from slamsim.config.robot import RobotConfig, VariationConfig
from slamsim.config.scenarios.robots import SquareScript, StraightScript
from slamsim.core.randomness import random_bits
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.base import BodyMotion, Solid, Source
from slamsim.sim.drive.script import CONTROL_HZ, Command, ScriptedRun
from slamsim.sim.robot.model import RobotModel

SHOWN_HZ = 10
SECONDS_OF_CORE = 0.03
"""Per simulated second of a scripted run, about."""


def robot_motion(name: str, run: ScriptedRun, model: RobotModel) -> BodyMotion:
    """What to show of a run."""
    every = max(round(len(run.drive) / max(duration_s(run), 1e-9) / SHOWN_HZ), 1)
    thinned = run.drive.trajectory().select(slice(None, None, every))
    return BodyMotion(name, Solid("robot", (model.footprint_radius_m, model.height_m)), thinned)


def duration_s(run: ScriptedRun) -> float:
    """From the first recorded step to the last."""
    return float(run.drive.stamps_ns[-1] - run.drive.stamps_ns[0]) * 1e-9


def steps_at(run: ScriptedRun, instants_s: FloatArray) -> IntArray:
    """(m,) the recorded steps at these instants after the start.

    Raises SlamsimError for a run that ended before the last.
    """
    if run.ended:
        raise SlamsimError(f"the run ended after {duration_s(run):.1f} s: {run.ended}")
    since_ns = run.drive.stamps_ns - run.drive.stamps_ns[0]
    steps = np.searchsorted(since_ns, np.rint(instants_s * 1e9))
    return np.asarray(np.minimum(steps, len(since_ns) - 1))


def true_poses(run: ScriptedRun) -> FloatArray:
    """(n, 3) x, y and yaw of all steps; yaw is not wrapped."""
    poses = run.drive.trajectory().planar().poses
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def corner_deg(yaws_rad: FloatArray) -> float:
    """Mean turn of the corners. yaws_rad: (16,) after each command; a side and a stop come first.

    From the end of the stop before a corner to the end of the stop after it.
    """
    turned = yaws_rad[3::4] - yaws_rad[1::4]
    return float(np.degrees(np.abs(turned)).mean())


CORNERS = 4
CORNER_RAD = 0.5 * math.pi
"""Of a square."""


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


IDENTIFIED = "turtlebot2_identified"
"""Name of the robot that was fitted to the study's figures of the real one."""


@dataclass(frozen=True, slots=True)
class Tested:
    """A robot under its name in tables."""

    name: str
    config: RobotConfig

    def runs(self, wanted: int) -> int:
        """How many runs are worth driving: one of a robot that is always the same."""
        return wanted if self.config.variation != VariationConfig() else 1


def robots_under_test(robot: RobotConfig, beside: Sequence[str]) -> list[Tested]:
    """The robot, then those of these names or files, each name once."""
    found = [Tested(robot.name, robot)]
    for name in beside:
        config = load_model(RobotConfig, find_input("configs/robots", name))
        if config.name not in [tested.name for tested in found]:
            found.append(Tested(config.name, config))
    return found


def run_seed(seed: int, *names: str) -> int:
    """The seed of one run."""
    return random_bits(seed, *names) >> 1


FIFTH_STOP_M: dict[Source, tuple[float, float]] = {
    "theory": (6.0, 0.0),
    "reality": (5.5, 0.3),
    "unity": (5.0, 1.5),
    "gazebo": (6.0, 0.0),
}
"""Mean place of the fifth stop; read from figures, and for Gazebo told as the theoretical one."""
FIFTH_STOP_SPEEDS_M_S = (0.2, 0.25, 0.3)
"""The script that it belongs to, with FIFTH_STOP_DRIVE_S for each drive."""
FIFTH_STOP_DRIVE_S = 20.0
"""In the study each drive lasts so long."""


@dataclass(frozen=True, slots=True)
class SquareFigures:
    """Squares of 2 m, five runs in each direction; None where the study gives no number."""

    largest_error_m: float
    spread_m: float | None
    corner_deg: float | None


SQUARES: dict[Source, SquareFigures] = {
    "reality": SquareFigures(1.06, 1.8, 70.0),
    "unity": SquareFigures(1.56, None, 70.0),
    "gazebo": SquareFigures(0.02, 0.01, None),
}
SQUARE_SIDE_M = 2.0
UNITY_CORNERS_DEG = {0.6: 30.0, 1.4: 70.0}
"""True turn of a corner of 90 degrees in Unity, by the friction of the tyres."""
