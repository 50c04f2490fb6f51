"""What scenarios with a robot have in common."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import DriveWheelsConfig, MotorConfig, RobotConfig, SuspensionConfig

Friction = Annotated[float, Field(ge=0.0, le=5.0)]
MotorKind = Literal["velocity", "pid", "ideal"]

SCENARIO_ROBOT = RobotConfig(motor=MotorConfig(rotor_inertia_kg_m2=0.0012))
"""A TurtleBot2 with the inertia of its motors' rotors: without it, wheels of unequal size need
ten times the solver iterations to turn as they should."""
SPRUNG_ROBOT = SCENARIO_ROBOT.model_copy(
    update={"drive_wheels": DriveWheelsConfig(suspension=SuspensionConfig())}
)
"""The same with drive wheels on springs: four rigid wheels share the weight at random once the
robot is not level; springs make each wheel's load follow from statics, as in reality."""
SCENARIO_PHYSICS = PhysicsConfig(solver_iterations=20)
"""Enough for that robot: its wheels then turn as commanded to a millionth."""
