"""Squares in both directions, and what they say of the wheels."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import RobotConfig, VariationConfig
from slamsim.config.scenarios.basic_drive import RobotNames
from slamsim.config.scenarios.defaults import SCENARIO_PHYSICS, SCENARIO_ROBOT

Side = Annotated[float, Field(gt=0.1, le=50.0)]
Friction = Annotated[float, Field(ge=0.0, le=5.0)]


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
