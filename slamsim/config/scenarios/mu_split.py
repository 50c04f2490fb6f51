"""One wheel on a slippery floor."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS, SPRUNG_ROBOT, Friction, MotorKind


class MuSplitConfig(Config):
    """Straight on, with the right wheel on less and less friction."""

    left_friction: float = Field(default=1.4, gt=0.0, le=5.0)
    """Coulomb coefficient between the left wheel and the floor."""
    right_frictions: Annotated[
        tuple[Friction, ...], Field(strict=False, min_length=1, max_length=100)
    ] = (0.0, 0.02, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30, 0.35, 0.40, 1.4)
    """Coulomb coefficients between the right wheel and the floor, one for each run."""
    motors: Annotated[tuple[MotorKind, ...], Field(strict=False, min_length=1, max_length=3)] = (
        "velocity",
        "ideal",
    )
    """Kinds of motor that are tried, one after the other."""
    support_frictions: Annotated[tuple[Friction, ...], Field(strict=False, max_length=20)] = (
        0.02,
        0.04,
        0.06,
        0.1,
    )
    """Friction of dragged support wheels; tried at the lowest of right_frictions."""
    speed_m_s: float = Field(default=0.2, gt=0.0, le=5.0)
    """Commanded speed, from the first instant on."""
    duration_s: float = Field(default=10.0, gt=0.1, le=600.0)
    """How long it is commanded."""
    robot: RobotConfig = SPRUNG_ROBOT
    """The robot; its drive wheels' friction is what the floor's is made to fit."""
    physics: PhysicsConfig = SCENARIO_PHYSICS
    """Time step and solver."""
