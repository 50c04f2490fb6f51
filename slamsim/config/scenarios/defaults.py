"""What scenarios with a robot have in common."""

from __future__ import annotations

from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import MotorConfig, RobotConfig

SCENARIO_ROBOT = RobotConfig(motor=MotorConfig(rotor_inertia_kg_m2=0.0012))
"""A TurtleBot2 with the inertia of its motors' rotors: without it, wheels of unequal size need
ten times the solver iterations to turn as they should."""
SCENARIO_PHYSICS = PhysicsConfig(solver_iterations=20)
"""Enough for that robot: its wheels then turn as commanded to a millionth."""
