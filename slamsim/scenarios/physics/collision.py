"""How deep bodies sink into each other at which time step.

Spheres fall into an inverted pyramid of four planes without end, so that nothing can slip
through; what a finite and thin wall would let pass shows as a deep penetration.

Penetrations are computed from the poses alone, at the end of each time step; the engine's own list
of contacts is only held beside them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from slamsim.config.scenarios.bodies import STANDARD, CollisionConfig, SolverConfig, all_solvers
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray, Trajectory
from slamsim.scenarios.base import BodyMotion, Outcome, Scenario, Solid, Trial, Value
from slamsim.scenarios.film import POSES_PER_S, filmed
from slamsim.scenarios.physics.collision_findings import collision_findings
from slamsim.sim.bodies import (
    BodySurroundings,
    BurstApart,
    FreeBodies,
    Sphere,
    State,
    engine_settings,
    free_bodies,
)

FACE_M = 0.02
"""Thickness of the faces that are shown."""
QUARTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three_quarters": 0.75, "most": 1.0}


def _trials(config: CollisionConfig, seed: int) -> Sequence[Trial]:
    """All falls of one time step are one trial; then those of the other solvers."""
    steps_s = config.steps.values_s()
    shown_s = steps_s[len(steps_s) // 2]
    more_s = [step_s for step_s in config.other_steps_s if step_s not in steps_s]
    standard = [(STANDARD, step_s) for step_s in sorted({*steps_s, *more_s})]
    others = [(name, step_s) for name in config.other_solvers for step_s in config.other_steps_s]
    solvers = all_solvers(config)
    return [
        Trial(
            f"{name} {step_s:g} s",
            partial(falls, config, name, step_s, seed, (name, step_s) == (STANDARD, shown_s)),
            _cost_s(config, solvers[name], step_s),
        )
        for name, step_s in standard + others
    ]


SCENARIO = Scenario[CollisionConfig](
    "Collision: penetration of spheres in an inverted pyramid",
    lambda config: engine_settings(config.solver),
    _trials,
    lambda config, outcomes: collision_findings(config, [outcome.values for outcome in outcomes]),
)
"""Scenario 2 of the study."""


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


ROOM = 1.05
"""Distance of neighbours at the start over the least at which they could touch."""
SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
LISTED_EVERY = 10
"""In so many steps the engine's list is looked at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Drop:
    """One fall of n spheres in m steps. planes_m, spheres_m: (m,) the largest penetration at the
    end of each step, 0 for none. listed_off_m: the largest difference from the engine's list;
    None if it cannot be compared. energy_gain_share: the most energy there was, over that at the
    start. states: of those steps that are shown, with their time in stamps_s.
    """

    planes_m: FloatArray
    spheres_m: FloatArray
    listed_off_m: float | None
    energy_gain_share: float
    stamps_s: FloatArray
    states: tuple[State, ...]


def drop_spheres(
    config: CollisionConfig,
    step_s: float,
    solver: SolverConfig,
    seed: int,
    repeat: int,
    looks_per_s: float = 10.0,
) -> Drop:
    """One fall from random places. looks_per_s: of the states. Raises BurstApart."""
    normals = face_normals(config.slope_deg)
    around = BodySurroundings(normals, config.friction, config.restitution)
    ball, start_m = Sphere(config.sphere_radius_m), start_places(config, seed, repeat)
    steps = math.ceil(config.duration_s / step_s - 1e-9)
    every = max(1, round(1.0 / looks_per_s / step_s))
    deepest, off_m, looks = np.zeros((steps, 2)), list[float](), list[tuple[float, State]]()
    with free_bodies(ball, config.sphere_mass_kg, start_m, around, step_s, solver) as spheres:
        looks.append((0.0, spheres.state()))
        for step in range(steps):
            spheres.advance()
            deepest[step] = penetrations_m(spheres.centres_m(), config.sphere_radius_m, normals)
            if step % LISTED_EVERY == 1:
                off_m.append(abs(_listed_m(spheres) - float(deepest[step - 1].max())))
            if (step + 1) % every == 0:
                looks.append(((step + 1) * step_s, spheres.state()))
        energy_j = [spheres.energy_j(state) for _, state in looks]
    return Drop(
        planes_m=deepest[:, 0],
        spheres_m=deepest[:, 1],
        # Substeps end at poses that are not recorded.
        listed_off_m=max(off_m, default=None) if solver.substeps == 1 else None,
        energy_gain_share=max(energy_j) / energy_j[0] - 1.0,
        stamps_s=np.array([stamp_s for stamp_s, _ in looks]),
        states=tuple(state for _, state in looks),
    )


def _listed_m(spheres: FreeBodies) -> float:
    """The engine looks for contacts as a step begins: the list is that of the step before."""
    return max(spheres.deepest_listed_m(), 0.0)


def face_normals(slope_deg: float) -> FloatArray:
    """(4, 3) unit, pointing up and inwards, of faces through the origin."""
    slope_rad = math.radians(slope_deg)
    flat, up = math.sin(slope_rad), math.cos(slope_rad)
    return np.array([(flat * x, flat * y, up) for x, y in SIDES])


def start_places(config: CollisionConfig, seed: int, repeat: int) -> FloatArray:
    """(n, 3) centres: a cube whose lowest spheres are ``fall_m`` or little more from the faces."""
    count, radius_m, aside_m = (
        config.spheres_per_edge,
        config.sphere_radius_m,
        config.misplacement_m,
    )
    spacing_m = 2.0 * (radius_m + aside_m) * ROOM
    numbers = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    places = (numbers - [(count - 1) / 2, (count - 1) / 2, 0.0]) * spacing_m
    slope_rad = math.radians(config.slope_deg)
    edge_m = (count - 1) / 2 * spacing_m + aside_m
    height_m = (radius_m + config.fall_m + edge_m * math.sin(slope_rad)) / math.cos(slope_rad)
    draw = random_stream(seed, "collision", f"places {repeat}")
    aside = draw.uniform(-aside_m, aside_m, places.shape)
    return np.array([0.0, 0.0, height_m + aside_m]) + places + aside


def penetrations_m(
    centres_m: FloatArray, radius_m: float, normals: FloatArray
) -> tuple[float, float]:
    """The deepest of any sphere in any half-space, and of any sphere in any other; 0 for none.

    centres_m: (n, 3). normals: (k, 3) unit, of half-spaces through the origin.
    """
    in_plane_m = radius_m - (centres_m @ normals.T).min()
    if len(centres_m) < 2:
        return max(float(in_plane_m), 0.0), 0.0
    first, second = np.triu_indices(len(centres_m), 1)
    apart_m = np.linalg.norm(centres_m[first] - centres_m[second], axis=1).min()
    return max(float(in_plane_m), 0.0), max(float(2.0 * radius_m - apart_m), 0.0)
