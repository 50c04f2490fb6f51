"""Parameters of the scenarios with a robot: basic drive, UMBmark, mu-split, ramp, friction turn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import (
    DriveWheelsConfig,
    MotorConfig,
    RobotConfig,
    SuspensionConfig,
    VariationConfig,
)

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


Side = Annotated[float, Field(gt=0.1, le=50.0)]


class SquareScript(Config):
    """Four times: one side, a stop, a corner, a stop; all by time alone, nothing is controlled."""

    speed_m_s: float = Field(default=0.2, gt=0.0, le=5.0)
    """Commanded speed along the sides; a side lasts as long as it takes by this speed."""
    yaw_rate_rad_s: float = Field(default=1.0, gt=0.0, le=20.0)
    """Commanded turning rate in the corners; a corner lasts as long as 90 degrees take by it. The
    study does not give it."""
    rest_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """How long it stands after each side and each corner."""


class UmbmarkConfig(SquareScript):
    """UMBmark of the study, and its calibration on a robot of known faults."""

    sides_m: Annotated[tuple[Side, ...], Field(strict=False, min_length=1, max_length=10)] = (
        2.0,
        4.0,
    )
    """Sides of the squares: the study drives 2 m, Borenstein and Feng 4 m."""
    runs: int = Field(default=5, ge=2, le=1000)
    """Runs in each direction."""
    sets: int = Field(default=8, ge=2, le=100)
    """How often a robot that differs from run to run drives the whole set of runs. Five runs of a
    robot whose errors spread over metres leave their centre of gravity to chance; the study drove
    one set. Calibration is made on the first and judged on the others."""
    robot: RobotConfig = SCENARIO_ROBOT
    """The robot."""
    beside: RobotNames = ("turtlebot2_identified",)
    """Bundled names or files of robots that drive the first of the squares beside it."""
    known_diameter_ratio: float = Field(default=1.01, gt=0.5, lt=2.0)
    """Right wheel over left (E_d) of the robot whose faults are known, for the calibration: about
    five times what two tyres of one batch differ by."""
    known_track_ratio: float = Field(default=1.03, gt=0.5, lt=2.0)
    """True track over nominal (E_b) of that robot."""
    known_variation: VariationConfig = VariationConfig(radius_ratio=0.0003, track=0.002)
    """What differs from run to run of that robot: chance, which no calibration takes away."""
    frictions: Annotated[tuple[Friction, ...], Field(strict=False, max_length=20)] = (0.6, 1.4)
    """Coefficients for the corner that the study saw shrink with the friction: of the tyres, and
    of the supports where they are dragged."""
    odometry_hz: float = Field(default=50.0, gt=0.5, le=1000.0)
    """Readings of the encoders in a second: 50 in the study's Unity, about 30 on its robot."""
    ticks_per_revolution: int = Field(default=2578, ge=1, le=10_000_000)
    """Encoder counts in one turn of a wheel (Kobuki)."""
    floor_friction: float = Field(default=1.0, ge=0.0, le=5.0)
    """Coulomb coefficient of the floor, times that of the tyre."""
    physics: PhysicsConfig = SCENARIO_PHYSICS
    """Time step and solver."""


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
