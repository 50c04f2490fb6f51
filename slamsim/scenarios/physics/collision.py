"""How deep bodies sink into each other at which time step.

Spheres fall into an inverted pyramid of four planes without end, so that nothing can slip
through; what a finite and thin wall would let pass shows as a deep penetration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from slamsim.config.scenarios.collision import CollisionConfig
from slamsim.config.scenarios.solver import STANDARD, SolverConfig, all_solvers
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.types import FloatArray, Trajectory
from slamsim.scenarios.base import BodyMotion, Findings, Outcome, Row, Solid, Trial, Value
from slamsim.scenarios.film import POSES_PER_S, filmed
from slamsim.scenarios.physics.collision_findings import collision_findings
from slamsim.scenarios.physics.sphere_drop import Drop, drop_spheres, face_normals
from slamsim.sim.bodies import BurstApart, Sphere, engine_settings

FACE_M = 0.02
"""Thickness of the faces that are shown."""
QUARTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three_quarters": 0.75, "most": 1.0}


class Collision:
    """Scenario 2 of the study."""

    title = "Collision: penetration of spheres in an inverted pyramid"

    def engine(self, config: CollisionConfig) -> Row:
        """See ``engine_settings``."""
        return engine_settings(config.solver)

    def trials(self, config: CollisionConfig, seed: int) -> Sequence[Trial]:
        """All falls of one time step are one trial; then those of the other solvers."""
        steps_s = config.steps.values_s()
        shown_s = steps_s[len(steps_s) // 2]
        more_s = [step_s for step_s in config.other_steps_s if step_s not in steps_s]
        standard = [(STANDARD, step_s) for step_s in sorted({*steps_s, *more_s})]
        others = [
            (name, step_s) for name in config.other_solvers for step_s in config.other_steps_s
        ]
        solvers = all_solvers(config)
        return [
            Trial(
                f"{name} {step_s:g} s",
                partial(falls, config, name, step_s, seed, (name, step_s) == (STANDARD, shown_s)),
                _cost_s(config, solvers[name], step_s),
            )
            for name, step_s in standard + others
        ]

    def conclude(self, config: CollisionConfig, outcomes: Sequence[Outcome]) -> Findings:
        """See ``collision_findings``."""
        return collision_findings(config, [outcome.values for outcome in outcomes])


SCENARIO = Collision()


def falls(
    config: CollisionConfig, name: str, step_s: float, seed: int, shown: bool = False
) -> Outcome:
    """All falls at one time step, as one row."""
    solver = all_solvers(config)[name]
    values: dict[str, Value] = {"solver": name, "step_s": step_s}
    looks_per_s = POSES_PER_S if shown else 10.0
    try:
        drops = [
            drop_spheres(config, step_s, solver, seed, repeat, looks_per_s)
            for repeat in range(config.repeats)
        ]
    except BurstApart as burst:
        return Outcome({**values, **_told([]), "reason": str(burst)})
    motions = _motions(config, drops[0]) if shown else ()
    return Outcome({**values, **_told(drops), "reason": ""}, motions)


def _told(drops: Sequence[Drop]) -> dict[str, Value]:
    """Statistics of the largest penetration at each step of all falls; None for no fall."""
    told: dict[str, Value] = {}
    for kind in ("planes", "spheres"):
        deepest_m = np.concatenate([getattr(drop, f"{kind}_m") for drop in drops] or [[]])
        known = deepest_m.size > 0
        for word, share in QUARTILES.items():
            told[f"{kind}_{word}_m"] = float(np.quantile(deepest_m, share)) if known else None
        told[f"{kind}_mean_m"] = float(deepest_m.mean()) if known else None
    off_m = [drop.listed_off_m for drop in drops if drop.listed_off_m is not None]
    return {
        **told,
        "listed_off_m": max(off_m, default=None),
        "energy_gain_share": max((drop.energy_gain_share for drop in drops), default=None),
    }


def _motions(config: CollisionConfig, drop: Drop) -> tuple[BodyMotion, ...]:
    spheres = filmed(
        [f"sphere {k + 1}" for k in range(len(drop.states[0].centres_m))],
        Sphere(config.sphere_radius_m),
        drop.stamps_s,
        np.array([state.centres_m for state in drop.states]),
        np.array([state.quats_xyzw for state in drop.states]),
    )
    length_m = float(1.5 * np.linalg.norm(drop.states[-1].centres_m, axis=1).max())
    return (*_faces(config.slope_deg, length_m), *spheres)


def _faces(slope_deg: float, length_m: float) -> tuple[BodyMotion, ...]:
    """Rectangles in the four planes, from the lowest point up to where their edges meet."""
    width_m = 2.0 * length_m * math.cos(math.radians(slope_deg))
    faces = []
    for number, normal in enumerate(face_normals(slope_deg), start=1):
        along = np.cross(normal, np.cross([0.0, 0.0, 1.0], normal))
        along /= np.linalg.norm(along)
        rotation = np.column_stack([along, np.cross(normal, along), normal])
        centre_m: FloatArray = along * length_m / 2 - normal * FACE_M / 2
        pose = Trajectory(np.zeros(1, np.int64), centre_m[None], xyzw_from_matrix(rotation)[None])
        faces.append(BodyMotion(f"face {number}", Solid("box", (length_m, width_m, FACE_M)), pose))
    return tuple(faces)


def _cost_s(config: CollisionConfig, solver: SolverConfig, step_s: float) -> float:
    spheres = config.spheres_per_edge**3
    each_s = spheres * (2e-6 + 1e-7 * solver.iterations * solver.substeps)
    return config.repeats * config.duration_s / step_s * each_s
