"""Up a slope."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import MotorConfig, RobotConfig, SuspensionConfig
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS, SCENARIO_ROBOT, SPRUNG_ROBOT

ROTOR_KG_M2 = SCENARIO_ROBOT.motor.rotor_inertia_kg_m2
Slope = Annotated[float, Field(ge=0.0, le=60.0)]
Slopes = Annotated[tuple[Slope, ...], Field(strict=False, min_length=1, max_length=100)]


class ClimbConfig(Config):
    """A motor on a floor."""

    motor: MotorConfig
    """Both motors of the robot."""
    floor_friction: float = Field(default=1.0, ge=0.0, le=20.0)
    """Coulomb coefficient of the floor, times that of the tyres."""


class HandConfig(Config):
    """A hand that holds the robot back while its wheels go on turning."""

    slopes_deg: Slopes = (20.0, 30.0, 36.0, 40.0, 45.0)
    """Slopes on which it is held."""
    height_m: float = Field(default=0.01, ge=0.0, le=1.0)
    """How high above the floor it holds the axis of the robot."""
    duration_s: float = Field(default=5.0, gt=0.1, le=60.0)
    """How long."""
    load_kg: float = Field(default=2.5, ge=0.0, le=50.0)
    """What the robot carries on its plate, beside the weight of cables and fixings: a notebook."""
    suspension: SuspensionConfig = SuspensionConfig(
        travel_m=0.02, stiffness_n_m=300.0, preload_n=16.0
    )
    """Its springs, in the runs on springs; softer than those of the drives, and longer."""


class RampConfig(Config):
    """The robot starts on the ramp and drives up, with motors of several kinds."""

    slopes_deg: Slopes = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 32.0, 34.0, 36.0)
    """Slopes, one for each run."""
    climbs: dict[str, ClimbConfig] = Field(
        default={
            "ideal": ClimbConfig(
                motor=MotorConfig(kind="ideal", rotor_inertia_kg_m2=ROTOR_KG_M2),
                floor_friction=3.5,
            ),
            "velocity": ClimbConfig(motor=MotorConfig(rotor_inertia_kg_m2=ROTOR_KG_M2)),
            "pid": ClimbConfig(motor=MotorConfig(kind="pid", rotor_inertia_kg_m2=ROTOR_KG_M2)),
            "proportional": ClimbConfig(
                motor=MotorConfig(
                    kind="pid",
                    pid_proportional=0.4,
                    pid_integral=0.0,
                    rotor_inertia_kg_m2=ROTOR_KG_M2,
                )
            ),
        },
        min_length=1,
        max_length=8,
    )
    """Motors by the name that stands in tables; the first stands for Gazebo's."""
    speed_m_s: float = Field(default=0.2, gt=0.0, le=5.0)
    """Commanded speed, from the first instant on."""
    duration_s: float = Field(default=16.5, gt=0.1, le=600.0)
    """How long it is commanded."""
    wall_behind_m: float = Field(default=0.06, gt=0.0, le=10.0)
    """From the robot's back to a wall that keeps it from rolling away."""
    start_yaw_deg: float = Field(default=0.5, ge=-45.0, le=45.0)
    """How far from straight up the robot is placed: by hand it is never perfect."""
    hand: HandConfig | None = HandConfig()
    """The runs in which it is held; null for none."""
    robot: RobotConfig = SPRUNG_ROBOT
    """The robot; its motor is replaced in each climb."""
    physics: PhysicsConfig = SCENARIO_PHYSICS
    """Time step and solver."""
