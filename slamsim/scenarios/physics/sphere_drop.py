"""Spheres fall into an inverted pyramid: how deep do they sink into its faces and each other?

Penetrations are computed from the poses alone, at the end of each time step; the engine's own
list of contacts is only held beside them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamsim.config.scenarios.collision import CollisionConfig
from slamsim.config.scenarios.solver import SolverConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray
from slamsim.sim.bodies import BodySurroundings, FreeBodies, Sphere, State, free_bodies

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
