"""Parameters of the scenario collision."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.scenarios.solver import SolverConfig, Solvers, Steps, StepsConfig


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
