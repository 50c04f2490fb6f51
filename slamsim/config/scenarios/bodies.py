"""Parameters of the scenarios with free bodies: stacking, collision and integrator; how the physics
engine computes contacts, and at which time steps it is tried."""

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


Length = Annotated[float, Field(ge=0.01, le=100.0)]


class StackingConfig(Config):
    """Boxes are put on one another: how many, until the stack collapses?"""

    steps: StepsConfig = StepsConfig(first_s=0.001, last_s=0.030, by_s=0.001)
    """Time steps of the physics."""
    duration_s: float = Field(default=20.0, ge=1.0, le=600.0)
    """A stack that stands for so long has passed."""
    box_size_m: Annotated[tuple[Length, Length, Length], Field(strict=False)] = (1.0, 1.0, 1.0)
    """Length, width and height of a box."""
    box_mass_kg: float = Field(default=1.0, ge=1e-3, le=1e6)
    """Mass of a box."""
    friction: float = Field(default=0.6, ge=0.0, le=10.0)
    """Coefficient of friction of each contact."""
    misplacement_m: float = Field(default=0.0, ge=0.0, le=10.0)
    """Each box is put down by up to so much, at random, beside the one exactly above the first."""
    max_boxes: int = Field(default=40, ge=2, le=200)
    """The search for the smallest stack that collapses ends here."""
    compared_boxes: int = Field(default=10, ge=2, le=200)
    """The largest time step at which a stack of so many stands is told for every solver."""
    solver: SolverConfig = SolverConfig()
    """Settings of the engine for all time steps."""
    other_solvers: Solvers = Field(
        default={
            "few_sweeps": SolverConfig(iterations=6),
            "double_sweeps": SolverConfig(iterations=100),
            "two_substeps": SolverConfig(substeps=2),
            "fast_correction": SolverConfig(contact_erp=0.5),
            "spring_contact": SolverConfig(contact_stiffness_n_m=1e6),
            "articulated": SolverConfig(articulated=True),
        }
    )
    """Other settings, to be compared at other_steps_s."""
    other_steps_s: Steps = (0.02, 0.03)
    """Time steps at which the other settings are tried."""

    @model_validator(mode="after")
    def _boxes_lie_on_one_another(self) -> Self:
        narrowest_m = min(self.box_size_m[:2])
        if self.misplacement_m >= narrowest_m / 4:
            raise ValueError(
                f"misplacement_m ({self.misplacement_m}) must be below a quarter of the narrower "
                f"side of a box ({narrowest_m})"
            )
        return self


class CollisionConfig(Config):
    """Spheres fall into an inverted pyramid: how far do bodies penetrate one another?"""

    steps: StepsConfig = StepsConfig(first_s=0.006, last_s=0.030, by_s=0.002)
    """Time steps of the physics."""
    duration_s: float = Field(default=3.0, ge=0.5, le=60.0)
    """Length of each fall."""
    repeats: int = Field(default=3, ge=1, le=100)
    """Falls at each time step, each from other random places."""
    spheres_per_edge: int = Field(default=3, ge=1, le=6)
    """The spheres begin as a cube with so many along each edge."""
    sphere_radius_m: float = Field(default=0.5, ge=0.01, le=10.0)
    """Radius of a sphere."""
    sphere_mass_kg: float = Field(default=1.0, ge=1e-3, le=1e6)
    """Mass of a sphere."""
    slope_deg: float = Field(default=45.0, ge=5.0, le=80.0)
    """Steepness of the four faces of the pyramid."""
    fall_m: float = Field(default=0.5, ge=0.0, le=100.0)
    """Distance from the nearest face at which the lowest spheres begin."""
    misplacement_m: float = Field(default=0.02, ge=0.0, le=1.0)
    """Each sphere begins by up to so much beside its place in the cube, along each axis; the cube
    is made so much wider that none touch."""
    friction: float = Field(default=0.6, ge=0.0, le=10.0)
    """Coefficient of friction of each contact."""
    restitution: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of its speed that a sphere bounces back with."""
    solver: SolverConfig = SolverConfig()
    """Settings of the engine for all time steps."""
    other_solvers: Solvers = Field(
        default={
            "few_sweeps": SolverConfig(iterations=6),
            "many_sweeps": SolverConfig(iterations=200),
            "four_substeps": SolverConfig(substeps=4),
            "fast_correction": SolverConfig(contact_erp=0.5),
            "spring_contact": SolverConfig(contact_stiffness_n_m=1e5),
            "articulated": SolverConfig(articulated=True),
        }
    )
    """Other settings, to be compared at other_steps_s."""
    other_steps_s: Steps = (0.003, 0.006, 0.010, 0.014, 0.020, 0.030)
    """Time steps at which the settings are compared, also the first."""


class IntegratorConfig(Config):
    """A sphere falls from rest: how far is it from where it should be?"""

    steps: StepsConfig = StepsConfig(first_s=0.001, last_s=0.030, by_s=0.001)
    """Time steps of the physics."""
    duration_s: float = Field(default=10.0, ge=0.5, le=100.0)
    """Length of the fall; it ends with the last whole time step before."""
    sphere_radius_m: float = Field(default=0.5, ge=0.01, le=10.0)
    """Radius of the sphere."""
    sphere_mass_kg: float = Field(default=1.0, ge=1e-3, le=1e6)
    """Mass of the sphere."""
    solver: SolverConfig = SolverConfig()
    """Settings of the engine for all time steps."""
    other_solvers: Solvers = Field(
        default={
            "four_substeps": SolverConfig(substeps=4),
            "articulated": SolverConfig(articulated=True),
            "damping": SolverConfig(damping=0.04),
            "damping_articulated": SolverConfig(damping=0.04, articulated=True),
        }
    )
    """Other settings, to be compared at other_steps_s."""
    other_steps_s: Steps = (0.001, 0.005, 0.01, 0.02, 0.03)
    """Time steps at which the other settings are tried."""
