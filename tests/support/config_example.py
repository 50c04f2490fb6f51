"""A small configuration with one field of each kind, for the tests of loading."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slamsim.config.base import Config


class Mode(Enum):
    FAST = "fast"
    SLOW = "slow"


class Lidar(Config):
    rate_hz: float = Field(default=10.0, gt=0.0, le=100.0)
    max_range_m: float = Field(default=30.0, gt=0.0)
    beam_count: int = Field(default=360, ge=1, le=10_000)
    flash: bool = False
    offset_m: Annotated[tuple[float, float, float], Field(strict=False)] = (0.0, 0.0, 0.0)


class Box(Config):
    shape: Literal["box"] = "box"
    side_m: float = Field(gt=0.0)


class Ball(Config):
    shape: Literal["ball"] = "ball"
    radius_m: float = Field(gt=0.0)


class Thing(Config):
    body: Annotated[Box | Ball, Field(discriminator="shape")]
    size: float | list[float] = 1.0


class Top(Config):
    name: str = Field(default="x", min_length=1)
    algorithm: Literal["wilson", "prim", "kruskal"] = "prim"
    mode: Annotated[Mode, Field(strict=False)] = Mode.FAST
    lidar: Lidar = Lidar()
    rear: Lidar | None = None
    low_m: float = 0.0
    high_m: float = 1.0
    things: Annotated[tuple[Thing, ...], Field(strict=False, max_length=2)] = ()
    labels: dict[str, int] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.low_m > self.high_m:
            raise ValueError(f"low_m {self.low_m} is above high_m {self.high_m}")
        return self
