"""Parameters of the scenario stacking."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.scenarios.solver import SolverConfig, Solvers, Steps, StepsConfig

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
