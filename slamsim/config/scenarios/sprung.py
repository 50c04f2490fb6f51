"""The robot of the contact scenarios: as it is built, with springs and rotors."""

from __future__ import annotations

from slamsim.config.robot import DriveWheelsConfig, MotorConfig, RobotConfig, SuspensionConfig

ROTOR_INERTIA_KG_M2 = 0.0012


def sprung_robot(motor: MotorConfig | None = None) -> RobotConfig:
    """A TurtleBot2 whose drive wheels hang on springs.

    Four rigid wheels share the weight at random once the robot is not level; springs make each
    wheel's load follow from statics, as in reality.
    """
    return RobotConfig(
        drive_wheels=DriveWheelsConfig(suspension=SuspensionConfig()),
        motor=motor or MotorConfig(rotor_inertia_kg_m2=ROTOR_INERTIA_KG_M2),
    )
