"""Worlds to order, and slow second opinions, that several tests of worlds share."""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import Any

import numpy as np
import shapely
from shapely import Polygon

from slamsim.config.world import WorldConfig
from slamsim.core.types import BoolArray, TriangleMesh
from slamsim.world.build import build_world
from slamsim.world.model import World
from slamsim.world.prism import Prism, PrismSolids
from slamsim.world.raster import Raster

PLAIN: dict[str, Any] = {
    "maze": {"rows": 4, "columns": 5, "dead_ends_opened": 0.0, "walls_removed": 0.0},
    "doors": {"share": 0.0},
    "pillars": {"share": 0.0},
    "dents": {"share": 0.0},
    "clutter": {"per_cell": 0.0},
}


def world(seed: int = 0, **changes: Any) -> World:
    """A bare maze with the sections of ``changes`` laid over it, key by key."""
    keys = dict(PLAIN)
    for name, value in changes.items():
        is_section = isinstance(value, dict) and isinstance(keys.get(name), dict)
        keys[name] = {**keys[name], **value} if is_section else value
    return build_world(WorldConfig.model_validate(keys), seed)


def prisms(of: World) -> list[Prism]:
    assert isinstance(of.solids, PrismSolids)
    return list(of.solids.prisms)


def ground_m2(of: World, height_m: float = 0.3) -> float:
    return float(shapely.union_all([prism.section(height_m) for prism in prisms(of)]).area)


def unmatched_edges(mesh: TriangleMesh) -> int:
    """How many directed edges have no partner in the other direction; 0 if closed."""
    corners = [tuple(point) for point in mesh.vertices_m.tolist()]
    edges: Counter[tuple[tuple[float, ...], tuple[float, ...]]] = Counter()
    for a, b, c in mesh.triangles.tolist():
        for i, j in ((a, b), (b, c), (c, a)):
            edges[corners[i], corners[j]] += 1
    return sum(count != edges[b, a] for (a, b), count in edges.items())


def covered_cells(polygons: list[Polygon], raster: Raster) -> tuple[BoolArray, BoolArray]:
    """Which cells share area with any polygon, and where that is too little to be sure."""
    cells = np.argwhere(np.ones(raster.shape, dtype=bool))
    low = raster.centres_m(cells) - 0.5 * raster.resolution_m
    high = low + raster.resolution_m
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    box, polygon = shapely.STRtree(polygons).query(boxes, predicate="intersects")
    whole = np.array(polygons)
    shapely.prepare(whole)
    shared = shapely.area(
        boxes[box]
    )  # of cells within a polygon, most of them: two to four times faster
    rim = ~shapely.covers(whole[polygon], boxes[box])
    shared[rim] = shapely.area(shapely.intersection(boxes[box[rim]], whole[polygon[rim]]))
    area = np.zeros(len(boxes))
    np.maximum.at(area, box, shared)
    area = area.reshape(raster.shape)
    return area > 0.0, (area > 0.0) & (area < 1e-8)


def digest(world: World) -> str:
    """A hash of all that another stage could see of a world."""
    found = hashlib.sha256()
    for part in (
        world.mesh.vertices_m,
        world.mesh.triangles,
        world.start_pose,
        world.visit_points_m,
        world.solids.section(0.3),
    ):
        found.update(np.ascontiguousarray(part).tobytes())
    return found.hexdigest()
