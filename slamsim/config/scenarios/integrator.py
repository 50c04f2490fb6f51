"""Parameters of the scenario integrator."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.scenarios.solver import SolverConfig, Solvers, Steps, StepsConfig


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
