"""How the physics engine computes contacts, and at which time steps it is tried."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Annotated, Protocol, Self

from pydantic import AfterValidator, Field, model_validator

from slamsim.config.base import Config

Step = Annotated[float, Field(ge=1e-4, le=0.1)]
"""Time step of the physics in seconds."""
MAX_STEPS = 300
STANDARD = "standard"
"""Name of the settings that all time steps are tried with."""


def _own_name(name: str) -> str:
    if name == STANDARD:
        raise ValueError(f"{STANDARD!r} is the name of the settings under solver")
    if not re.fullmatch("[a-z][a-z0-9_]{0,40}", name):
        raise ValueError("a name is made of small letters, digits and _, and begins with a letter")
    return name


def _each_once(steps_s: tuple[float, ...]) -> tuple[float, ...]:
    if any(later <= sooner for sooner, later in pairwise(steps_s)):
        raise ValueError("the time steps must ascend")
    return steps_s


Name = Annotated[str, AfterValidator(_own_name)]
Steps = Annotated[tuple[Step, ...], Field(strict=False, max_length=100), AfterValidator(_each_once)]


class SolverConfig(Config):
    """Settings of PyBullet beside its time step."""

    iterations: int = Field(default=50, ge=1, le=1000)
    """Sweeps of the contact solver in each step; 50 is what PyBullet is shipped with."""
    substeps: int = Field(default=1, ge=1, le=100)
    """Equal pieces that each step is computed in, each with all its sweeps."""
    contact_erp: float = Field(default=0.08, ge=0.0, le=1.0)
    """Share of a penetration that is taken back in each step; 0.08 is what PyBullet is shipped
    with."""
    contact_stiffness_n_m: float | None = Field(default=None, gt=0.0, le=1e12)
    """Each contact point is a spring of this stiffness; null for hard ones, which contact_erp
    repairs."""
    contact_damping_n_s_m: float = Field(default=1000.0, ge=0.0, le=1e12)
    """Damping of such springs."""
    articulated: bool = False
    """Bodies are of PyBullet's articulated kind (Featherstone), as robots are, instead of single
    rigid ones in maximal coordinates."""
    damping: float = Field(default=0.0, ge=0.0, le=1.0)
    """PyBullet's drag on linear and angular speed; it is shipped with 0.04, we take it off."""


Solvers = Annotated[dict[Name, SolverConfig], Field(max_length=20)]


class TriedSolvers(Protocol):
    """The part of a scenario's parameters that says which settings are tried."""

    @property
    def solver(self) -> SolverConfig: ...

    @property
    def other_solvers(self) -> dict[str, SolverConfig]: ...


def all_solvers(config: TriedSolvers) -> dict[str, SolverConfig]:
    """By name, the standard one first."""
    return {STANDARD: config.solver, **config.other_solvers}


class StepsConfig(Config):
    """Time steps at equal distances."""

    first_s: Step
    """The smallest."""
    last_s: Step
    """The largest."""
    by_s: float = Field(ge=1e-5, le=0.1)
    """From one to the next."""

    @model_validator(mode="after")
    def _few_and_ascending(self) -> Self:
        if self.last_s < self.first_s:
            raise ValueError(f"last_s ({self.last_s}) must not be below first_s ({self.first_s})")
        if (self.last_s - self.first_s) / self.by_s > MAX_STEPS:
            raise ValueError(f"by_s ({self.by_s}) makes more than {MAX_STEPS} time steps")
        return self

    def values_s(self) -> tuple[float, ...]:
        """All of them, ascending, free of the noise of adding them up."""
        count = int((self.last_s - self.first_s) / self.by_s + 1e-6) + 1
        return tuple(round(self.first_s + k * self.by_s, 9) for k in range(count))
