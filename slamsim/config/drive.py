"""How the robot is driven and how finely its motion is computed."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from slamsim.config.base import Config
from slamsim.config.layout import ascending

Seconds = Annotated[float, Field(ge=0.0, le=600.0)]


class PhysicsConfig(Config):
    """Time step and solver of the physics engine."""

    rate_hz: int = Field(default=240, ge=60, le=10_000)
    """Steps per simulated second; also the rate of the recorded truth."""
    solver_iterations: int = Field(default=50, ge=1, le=1000)
    """Sweeps of the contact solver in each step."""
    settle_s: float = Field(default=0.5, ge=0.0, le=10.0)
    """Time to come to rest on the floor before the drive begins; not recorded."""
    window_s: float = Field(default=10.0, gt=0.01, le=600.0)
    """Length of the pieces in which the motion is handed on; no effect on the data."""


class LimitsConfig(Config):
    """What the twist commands keep to."""

    max_speed_m_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """Forward speed."""
    max_yaw_rate_rad_s: float = Field(default=1.5, gt=0.0, le=20.0)
    """Turning rate."""
    max_acceleration_m_s2: float = Field(default=0.5, gt=0.0, le=20.0)
    """Change of the commanded forward speed."""
    max_yaw_acceleration_rad_s2: float = Field(default=3.0, gt=0.0, le=100.0)
    """Change of the commanded turning rate."""
    max_lateral_acceleration_m_s2: float = Field(default=0.3, gt=0.0, le=20.0)
    """Speed times turning rate: the robot slows down in bends."""


class RouteConfig(Config):
    """Where the robot goes."""

    kind: Literal["tour", "random_goals"] = "tour"
    """tour: past every place of the world and back to the start, on the shortest way.
    random_goals: from one random place to the next, as long as length and duration allow; without
    either, to as many as a tour would visit."""
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    """Seed of random goals and stops; without one, the seed of the world."""
    file: str | None = Field(default=None, min_length=1, max_length=1000)
    """A route to follow instead: YAML or CSV with poses (x_m, y_m, optionally yaw_deg) or twists
    (t_s, v_m_s, w_rad_s)."""
    clearance_m: float = Field(default=0.05, ge=0.0, le=2.0)
    """Distance that the planned path keeps between the robot and any wall."""
    preferred_clearance_m: float = Field(default=0.6, ge=0.0, le=10.0)
    """Up to this distance from walls the path keeps away from them where there is room."""
    resolution_m: float = Field(default=0.04, ge=0.01, le=0.25)
    """Cell size of the grid that the path is searched on."""
    max_path_length_m: float | None = Field(default=None, gt=0.0)
    """The route is cut after this length."""
    max_duration_s: float | None = Field(default=None, gt=0.0)
    """The drive is brought to a stop so that it lasts no longer than this."""


class StopsConfig(Config):
    """Where the robot stops on its way, and what it does there; not for twists of a file."""

    every_m: float | None = Field(default=None, ge=0.5, le=1e6)
    """Length of path from one stop to the next, on average (half as much to half as much again);
    null for no stops."""
    rest_s: Annotated[tuple[Seconds, Seconds], Field(strict=False), AfterValidator(ascending)] = (
        0.5,
        3.0,
    )
    """Shortest and longest time that it stands."""
    turn_deg: float = Field(default=0.0, ge=0.0, le=180.0)
    """Before it stands, it turns on the spot by up to so much to either side."""


class FollowConfig(Config):
    """How the path is followed, and when to give up."""

    control_rate_hz: int = Field(default=40, ge=5, le=1000)
    """Twist commands per second; the physics rate must be a multiple of it."""
    lookahead_m: float = Field(default=0.30, gt=0.02, le=5.0)
    """How far ahead on the path the pure pursuit aims."""
    turn_in_place_deg: float = Field(default=60.0, gt=5.0, le=180.0)
    """Beyond this heading error the robot stops and turns on the spot."""
    standstill_s: float = Field(default=1.5, ge=0.0, le=60.0)
    """Rest at the start, so that the bias of the gyroscope can be seen."""
    final_standstill_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """Rest at the end."""
    stuck_after_s: float = Field(default=4.0, gt=0.2, le=600.0)
    """Commanded to move for this long without getting anywhere counts as stuck."""
    max_recoveries: int = Field(default=2, ge=0, le=100)
    """How often in a row the robot backs up and tries again before it gives up."""
    max_tilt_deg: float = Field(default=35.0, gt=1.0, le=90.0)
    """Leaning further than this counts as tipped over."""


class DriveConfig(Config):
    """One drive through a world."""

    physics: PhysicsConfig = PhysicsConfig()
    """Time step and solver."""
    limits: LimitsConfig = LimitsConfig()
    """Speed and acceleration of the commands."""
    route: RouteConfig = RouteConfig()
    """Where to."""
    stops: StopsConfig = StopsConfig()
    """Where it stops on its way."""
    follow: FollowConfig = FollowConfig()
    """How."""

    @model_validator(mode="after")
    def _control_rate_divides_physics_rate(self) -> Self:
        if self.physics.rate_hz % self.follow.control_rate_hz:
            raise ValueError(
                f"physics.rate_hz ({self.physics.rate_hz}) must be a multiple of "
                f"follow.control_rate_hz ({self.follow.control_rate_hz})"
            )
        return self
