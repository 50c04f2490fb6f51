"""Small worlds with looks, and slow second opinions on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from slamsim.config.layout import LooksConfig
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.world.looks.build import Looks, build_looks
from slamsim.world.model import World
from slamsim.world.parts import Parts
from slamsim.world.prism import Prism, PrismSolids, prism_mesh


def room(half_m: float = 2.0, height_m: float = 1.5, seed: int = 0) -> World:
    """A square room about the origin, its walls 0.2 m thick, with a box in one corner."""
    outer, inner = half_m + 0.2, half_m
    frame = shapely.box(-outer, -outer, outer, outer) - shapely.box(-inner, -inner, inner, inner)
    box = shapely.box(inner - 0.6, inner - 0.6, inner - 0.2, inner - 0.2)
    prisms = [Prism(frame, 0.0, height_m), Prism(box, 0.0, 0.4)]
    mesh = prism_mesh(prisms)
    heights = mesh.vertices_m[mesh.triangles][..., 2].max(axis=1)
    inside = (np.abs(mesh.vertices_m[mesh.triangles][..., :2]) < inner).all(axis=(1, 2))
    owners = np.where(inside & (heights == 0.4), 3, 2).astype(np.int32)
    return World(
        name="room",
        seed=seed,
        mesh=mesh,
        parts=Parts(owners, ("nothing", "floor", "wall", "box")),
        solids=PrismSolids(prisms),
        floor_friction=1.0,
        floor_patches=(),
        start_pose=np.zeros(3),
        bounds_m=(-outer, -outer, outer, outer),
        visit_points_m=np.zeros((1, 2)),
        clearance_m=0.6,
    )


def looks_of(world: World, **changes: Any) -> Looks:
    return build_looks(world, LooksConfig.model_validate(changes))


def points_on(world: World, count: int, seed: int = 0) -> tuple[IntArray, FloatArray, Float32Array]:
    """Random points of the mesh: triangles (n,), points (n, 3) and outward normals (n, 3)."""
    rng = np.random.default_rng(seed)
    corners = world.mesh.vertices_m[world.mesh.triangles]
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crossed, axis=1)
    triangles = rng.choice(len(areas), count, p=areas / areas.sum())
    shares = rng.dirichlet((1.0, 1.0, 1.0), count)
    points = np.einsum("nk,nkx->nx", shares, corners[triangles])
    return triangles, points, (crossed / areas[:, None])[triangles].astype(np.float32)


def nothing_between(
    origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
) -> BoolArray:
    return np.zeros(len(origins_m), dtype=bool)
