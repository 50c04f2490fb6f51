"""Small worlds for the tests of robot, route and drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from slamsim.core.types import FloatArray
from slamsim.sim.drive.legs import Route
from slamsim.world.model import FloorPatch, World
from slamsim.world.parts import Parts
from slamsim.world.prism import Prism, PrismSolids, prism_mesh


def world_of(
    blocks: Sequence[tuple[float, float, float, float, float]],
    visits: Sequence[tuple[float, float]] = (),
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    patches: Sequence[FloorPatch] = (),
    floor_friction: float = 1.0,
) -> World:
    """Blocks (x_min, y_min, x_max, y_max, height) on a plane."""
    prisms = [Prism(shapely.box(*block[:4]), 0.0, block[4]) for block in blocks]
    table = np.array(blocks)
    mesh = prism_mesh(prisms)
    return World(
        name="test",
        seed=0,
        mesh=mesh,
        parts=Parts.all_wall(mesh),
        solids=PrismSolids(prisms),
        floor_friction=floor_friction,
        floor_patches=tuple(patches),
        start_pose=np.array(start),
        bounds_m=(
            float(table[:, 0].min()),
            float(table[:, 1].min()),
            float(table[:, 2].max()),
            float(table[:, 3].max()),
        ),
        visit_points_m=np.array(visits, dtype=np.float64).reshape(-1, 2),
        clearance_m=0.6,
    )


def walls_around(
    x_min: float, y_min: float, x_max: float, y_max: float
) -> list[tuple[float, float, float, float, float]]:
    """Four walls of 0.1 m whose inner faces are the given rectangle."""
    t = 0.1
    return [
        (x_min - t, y_min - t, x_max + t, y_min, 0.5),
        (x_min - t, y_max, x_max + t, y_max + t, 0.5),
        (x_min - t, y_min, x_min, y_max, 0.5),
        (x_max, y_min, x_max + t, y_max, 0.5),
    ]


def hall(half_m: float = 6.0, **kwargs: object) -> World:
    """A square room about the origin."""
    blocks = walls_around(-half_m, -half_m, half_m, half_m)
    return world_of(blocks, **kwargs)  # type: ignore[arg-type]


def line_of(route: Route) -> FloatArray:
    """(n, 2) the points of all legs of a route, one after the other."""
    return np.vstack([leg.points_m for leg in route.legs])
