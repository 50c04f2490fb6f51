"""Measurements of a real robot: the figures to which ``slamsim identify`` fits a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.bundled import Kind, find_input
from slamsim.config.loading import overridden, validated, with_presets
from slamsim.config.merging import mount
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.robots import SCENARIO_ROBOT, SquareScript, StraightScript
from slamsim.guard.yaml import KeyPath, load_yaml

_SECTIONS: dict[KeyPath, Kind] = {("robot",): "configs/robots"}

Quantity = Literal[
    "basic_drive.stop_x_m",
    "basic_drive.stop_y_m",
    "basic_drive.stop_scatter_m",
    "umbmark.corner_deg",
    "umbmark.e_max_m",
    "umbmark.spread_m",
    "umbmark.clockwise_x_m",
    "umbmark.clockwise_y_m",
    "umbmark.counter_clockwise_x_m",
    "umbmark.counter_clockwise_y_m",
    "ramp.travel_m",
    "ramp.slides_from_deg",
    "ramp.stalls_from_deg",
]
MAY_BE_NEGATIVE = ("_x_m", "_y_m", "travel_m")

ParameterName = Literal[
    "radius_scale",
    "radius_ratio",
    "track_scale",
    "droop_m_s",
    "gear_friction_ratio",
    "battery_sag_per_min",
    "motor_gain_n_m_s",
    "max_torque_n_m",
    "tyre_friction",
    "variation_radius_ratio",
    "variation_track",
    "variation_gear_friction",
    "variation_gear_friction_ratio",
]


class FigureConfig(Config):
    """One measured number."""

    quantity: Quantity
    """What was measured: scenario, then name. stop_x_m and stop_y_m: mean place of a stop of the
    basic drive; stop_scatter_m: root mean square distance of the runs from it; corner_deg: true
    turn of a corner that is commanded as 90 degrees; e_max_m, spread_m and the centres of gravity
    of the squares clockwise and counter-clockwise: true end less end by odometry; travel_m: way up
    a slope; slides_from_deg, stalls_from_deg: least slope at which wheels slide or motors stall."""
    value: float = Field(ge=-1e4, le=1e4)
    """The measured number, in the unit that the quantity's name ends with."""
    sigma: float = Field(gt=0.0, le=1e4)
    """How uncertain the number is as it was read, one standard deviation, same unit. What few
    repeats leave to chance is added by itself."""
    bound: Literal["at_most", "at_least"] | None = None
    """Whether the truth is only known to be at most, or at least, the value; null for about it."""
    stop: int | None = Field(default=None, ge=1, le=100)
    """Which stop of the basic drive, counted from 1."""
    slope_deg: float | None = Field(default=None, gt=0.0, lt=90.0)
    """Which slope, for travel_m."""
    source: str = Field(min_length=1, max_length=1000)
    """Where the number and its uncertainty come from."""
    others: dict[str, float] = Field(default_factory=dict, max_length=8)
    """What other simulators or robots give for it, by their names; shown beside, not fitted to."""

    @property
    def scenario(self) -> str:
        """The scenario that it belongs to."""
        return self.quantity.partition(".")[0]

    @property
    def label(self) -> str:
        """The quantity, with what tells it from its like."""
        which = f" {self.stop}" if self.stop is not None else ""
        which += f" at {self.slope_deg:g} deg" if self.slope_deg is not None else ""
        return f"{self.quantity}{which}"

    @model_validator(mode="after")
    def _check(self) -> Self:
        needs_stop = self.quantity.startswith("basic_drive.")
        if needs_stop != (self.stop is not None):
            raise ValueError(f"{self.quantity} {'needs' if needs_stop else 'has no'} stop")
        needs_slope = self.quantity == "ramp.travel_m"
        if needs_slope != (self.slope_deg is not None):
            raise ValueError(f"{self.quantity} {'needs' if needs_slope else 'has no'} slope_deg")
        if self.value < 0.0 and not self.quantity.endswith(MAY_BE_NEGATIVE):
            raise ValueError(f"{self.quantity} cannot be negative: {self.value:g}")
        if self.quantity.endswith("_deg") and self.value > 360.0:
            raise ValueError(f"{self.quantity} is in degrees: {self.value:g} is beyond a turn")
        return self


class PriorConfig(Config):
    """What is known of a parameter without the figures."""

    value: float = Field(gt=0.0, le=1e3)
    """Most likely value."""
    sigma: float = Field(gt=0.0, le=5.0)
    """How uncertain that is: natural logarithm of a factor, 0.05 for about 5 %."""
    why: str = Field(min_length=1, max_length=1000)
    """Where that comes from."""


class MeasuredStraight(StraightScript):
    """The basic drive as it was driven with the robot that was measured."""

    runs: int = Field(default=6, ge=1, le=1000)
    """Number of runs whose mean was taken."""


class MeasuredSquares(SquareScript):
    """The squares as they were driven with the robot that was measured."""

    side_m: float = Field(default=2.0, gt=0.1, le=50.0)
    """Commanded side of the square."""
    runs: int = Field(default=5, ge=2, le=1000)
    """Number of runs in each direction."""


class MeasuredRamp(Config):
    """The ramp as it was driven with the robot that was measured."""

    speed_m_s: float = Field(default=0.2, gt=0.0, le=5.0)
    """Commanded speed."""
    drive_s: float = Field(default=10.0, gt=0.0, le=600.0)
    """How long it was commanded."""


class MeasurementsConfig(Config):
    """A robot, how it was driven, and what was measured."""

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    """Name of the robot that was measured; the identified one is called so too."""
    robot: RobotConfig = SCENARIO_ROBOT
    """The robot as drawn and as its driver believes it to be: a bundled name, a file, or keys."""
    basic_drive: MeasuredStraight = MeasuredStraight()
    """Forth and back with growing speed."""
    umbmark: MeasuredSquares = MeasuredSquares()
    """Squares in both directions."""
    ramp: MeasuredRamp = MeasuredRamp()
    """Up a slope."""
    figures: Annotated[tuple[FigureConfig, ...], Field(strict=False, min_length=1, max_length=1000)]
    """What was measured."""
    priors: dict[ParameterName, PriorConfig] = Field(default_factory=dict)
    """What is known of parameters beforehand, in place of what holds for a robot of this kind."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        stops = 2 * len(self.basic_drive.speeds_m_s)
        labels = set[str]()
        for figure in self.figures:
            if figure.stop is not None and figure.stop > stops:
                raise ValueError(f"{figure.label}: the basic drive has {stops} stops")
            if figure.label in labels:
                raise ValueError(f"{figure.label} is given twice")
            labels.add(figure.label)
        return self


def load_measurements(name: str, overrides: Sequence[str] = ()) -> MeasurementsConfig:
    """The measurements of that path or bundled name. Raises as ``load_model`` does."""
    tree = with_presets(mount(load_yaml(find_input("configs/measurements", name))), _SECTIONS)
    for text in overrides:
        tree = overridden(tree, text, _SECTIONS)
    return validated(MeasurementsConfig, tree)
