"""Forth and back with growing speed, and where the robot stops."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS, SCENARIO_ROBOT

Speed = Annotated[float, Field(gt=0.0, le=5.0)]
RobotNames = Annotated[tuple[str, ...], Field(strict=False, max_length=8)]


class StraightScript(Config):
    """Straight forward, a stop, straight back, a stop; the same with every speed."""

    speeds_m_s: Annotated[tuple[Speed, ...], Field(strict=False, min_length=1, max_length=20)] = (
        0.2,
        0.25,
        0.3,
    )
    """Commanded speeds, one after the other."""
    drive_s: float = Field(default=20.0, gt=0.0, le=600.0)
    """How long each drive is commanded, there and back."""
    rest_s: float = Field(default=5.0, ge=0.0, le=600.0)
    """How long it stands after each."""


class BasicDriveConfig(StraightScript):
    """The study's basic drive, several times, with what varies from run to run."""

    runs: int = Field(default=6, ge=2, le=1000)
    """Number of runs of each robot; the study asks for at least six."""
    robot: RobotConfig = SCENARIO_ROBOT
    """The robot."""
    beside: RobotNames = ("turtlebot2_identified",)
    """Bundled names or files of robots that drive the same beside it."""
    floor_friction: float = Field(default=1.0, ge=0.0, le=5.0)
    """Coulomb coefficient of the floor, times that of the tyre."""
    physics: PhysicsConfig = SCENARIO_PHYSICS
    """Time step and solver."""
