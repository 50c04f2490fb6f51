"""Against a heavy box."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS, SPRUNG_ROBOT, Friction, MotorKind


class BoxConfig(Config):
    """The box that is driven against."""

    length_m: float = Field(default=2.0, gt=0.1, le=100.0)
    """Along the side that is touched."""
    width_m: float = Field(default=1.0, gt=0.05, le=100.0)
    """Away from that side."""
    height_m: float = Field(default=0.4, gt=0.05, le=10.0)
    """Height."""
    mass_kg: float = Field(default=100.0, ge=0.0, le=1e5)
    """Mass; 0 for a box that nothing can move."""
    side_angle_deg: float = Field(default=20.0, gt=0.0, lt=90.0)
    """Between its side and the direction in which the robot drives."""


class FrictionTurnConfig(Config):
    """The robot drives against the side of a heavy box, at a small angle."""

    box: BoxConfig = BoxConfig()
    """The box."""
    body_frictions: Annotated[
        tuple[Friction, ...], Field(strict=False, min_length=1, max_length=50)
    ] = (1.4, 0.6, 0.3, 0.15, 0.05)
    """Coulomb coefficients between robot and box, one for each run; the first is the study's."""
    motors: Annotated[tuple[MotorKind, ...], Field(strict=False, min_length=1, max_length=3)] = (
        "pid",
        "velocity",
        "ideal",
    )
    """Kinds of motor that are tried, one after the other."""
    approach_s: float = Field(default=1.3, gt=0.0, le=60.0)
    """Time to the contact, if the robot had its full speed at once."""
    speed_m_s: float = Field(default=0.2, gt=0.0, le=5.0)
    """Commanded speed, from the first instant on."""
    duration_s: float = Field(default=6.0, gt=0.1, le=600.0)
    """How long it is commanded."""
    robot: RobotConfig = SPRUNG_ROBOT
    """The robot; its body's friction is replaced by each of body_frictions."""
    physics: PhysicsConfig = SCENARIO_PHYSICS
    """Time step and solver."""
