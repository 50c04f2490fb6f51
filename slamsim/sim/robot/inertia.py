"""Mass and inertia of solid bodies, alone and joined.

Formulas for homogeneous solids and the parallel-axis theorem as in any mechanics text (Goldstein,
Classical Mechanics, ch. 5). Inertia is a 3 x 3 tensor in kg m^2 about the centre of mass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import (
    FINITE,
    BadNumbers,
    require_finite,
    require_number,
    require_rigid,
)

_MOST = math.sqrt(FINITE)
"""Squares of mass and inertia stay finite."""


def box_inertia(mass_kg: float, size_m: Sequence[float]) -> FloatArray:
    """(3, 3) of a cuboid with edges along x, y, z."""
    require_number("a mass in kg", mass_kg, 0.0)
    for edge_m in size_m:
        require_number("an edge in m", edge_m, 0.0)
    x2, y2, z2 = (edge * edge for edge in size_m)
    return np.diag([y2 + z2, x2 + z2, x2 + y2]) * (mass_kg / 12.0)


def cylinder_inertia(mass_kg: float, radius_m: float, length_m: float) -> FloatArray:
    """(3, 3) of a cylinder whose axis is z."""
    require_number("a mass in kg", mass_kg, 0.0)
    require_number("a radius in m", radius_m, 0.0)
    require_number("a length in m", length_m, 0.0)
    across = mass_kg * (3.0 * radius_m**2 + length_m**2) / 12.0
    return np.diag([across, across, 0.5 * mass_kg * radius_m**2])


def sphere_inertia(mass_kg: float, radius_m: float) -> FloatArray:
    """(3, 3) of a ball."""
    require_number("a mass in kg", mass_kg, 0.0)
    require_number("a radius in m", radius_m, 0.0)
    return np.eye(3) * (0.4 * mass_kg * radius_m**2)


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """A rigid body: its mass, its centre of mass (3,) and its inertia (3, 3) about that centre,

    both along the axes of the frame that they are expressed in.
    """

    mass_kg: float
    centre_m: FloatArray
    inertia_kg_m2: FloatArray

    def __post_init__(self) -> None:
        require_number("a mass in kg", self.mass_kg, 0.0, _MOST)
        require_finite("a centre of mass", self.centre_m, (3,))
        require_finite("an inertia", self.inertia_kg_m2, (3, 3), _MOST)

    def seen_from(self, T_parent_frame: FloatArray) -> Inertial:
        """The same body in the axes of another frame; T_parent_frame is 4 x 4."""
        require_rigid("the frame of a body", T_parent_frame)
        rotation = T_parent_frame[:3, :3]
        return Inertial(
            self.mass_kg,
            rotation @ self.centre_m + T_parent_frame[:3, 3],
            rotation @ self.inertia_kg_m2 @ rotation.T,
        )


def join(bodies: Sequence[Inertial]) -> Inertial:
    """Bodies welded together, all given in the same frame.

    Raises BadNumbers for bodies without mass: they have no centre.
    """
    mass_kg = float(sum(body.mass_kg for body in bodies))
    if mass_kg == 0.0:
        raise BadNumbers("bodies without mass have no centre of mass")
    centre_m = sum((body.mass_kg * body.centre_m for body in bodies), np.zeros(3)) / mass_kg
    inertia = np.zeros((3, 3))
    for body in bodies:
        arm = body.centre_m - centre_m
        shift = body.mass_kg * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        inertia += body.inertia_kg_m2 + shift
    return Inertial(mass_kg, centre_m, inertia)
