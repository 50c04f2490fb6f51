"""From the borders of a floor plan to walls, doors, dents, pillars and blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from slamsim.config.world import DoorsConfig, WorldConfig
from slamsim.core.randomness import random_stream
from slamsim.world.floor_plan import FloorPlan
from slamsim.world.prism import Prism, circle, polygons_of
from slamsim.world.wall_segments import Point, WallSegment


def build_walls(
    plan: FloorPlan, panels: Sequence[WallSegment], config: WorldConfig, seed: int
) -> list[Prism]:
    """All that stands where the plan has walls, doors or no cells."""
    rng = random_stream(seed, "world", "dents")
    walls = [part for panel in panels for part in _dented_wall(panel, plan, config, rng)]
    return [*walls, *_pillars(panels, config, seed), *_blocks(plan, config)]


def _dented_wall(
    panel: WallSegment, plan: FloorPlan, config: WorldConfig, rng: np.random.Generator
) -> list[Prism]:
    """One wall, and by chance a niche cut into it or a bump set before it."""
    dents = config.dents
    chosen, where, is_niche, is_left = rng.random(4).tolist()
    depth, width = float(rng.uniform(*dents.depth_m)), float(rng.uniform(*dents.width_m))
    if panel.is_open:
        return []
    wall = _wall(panel, plan, config)
    if panel.door_at_m is not None or chosen >= dents.share:
        return wall
    half = 0.5 * panel.thickness_m
    begin = half + where * (plan.cell_m - 2.0 * half - width)
    inner, outer = (half - depth, half) if is_niche < 0.5 else (0.0, half + depth)
    on_left = panel.right is None or (panel.left is not None and is_left < 0.5)
    sides = (-inner, outer) if on_left else (outer, -inner)
    ground = panel.rectangle(begin, begin + width, *sides)
    if is_niche >= 0.5:
        return [*wall, Prism(ground, 0.0, panel.height_m)]
    return [
        Prism(part, solid.z_min_m, solid.z_max_m)
        for solid in wall
        for part in polygons_of(shapely.difference(solid.footprint, ground))
    ]


def _wall(panel: WallSegment, plan: FloorPlan, config: WorldConfig) -> list[Prism]:
    """One wall, whole or with a door in it; it reaches around its ends by half its thickness."""
    half, height = 0.5 * panel.thickness_m, panel.height_m
    begin, end = -half, plan.cell_m + half
    if panel.door_at_m is None:
        return [Prism(panel.rectangle(begin, end, half, half), 0.0, height)]
    doors = config.doors
    left, right = panel.door_at_m - 0.5 * doors.width_m, panel.door_at_m + 0.5 * doors.width_m
    parts = [
        Prism(panel.rectangle(begin, left, half, half), 0.0, height),
        Prism(panel.rectangle(right, end, half, half), 0.0, height),
    ]
    if height > doors.height_m:
        parts.append(Prism(panel.rectangle(left, right, half, half), doors.height_m, height))
    return parts + _frame(panel, left, right, doors)


def _frame(panel: WallSegment, left_m: float, right_m: float, doors: DoorsConfig) -> list[Prism]:
    """The posts on both sides of a door."""
    if doors.frame_m == 0.0:
        return []
    out, height = 0.5 * panel.thickness_m + doors.frame_m, min(panel.height_m, doors.height_m)
    spans = ((left_m - doors.frame_m, left_m), (right_m, right_m + doors.frame_m))
    return [Prism(panel.rectangle(*span, out, out), 0.0, height) for span in spans]


def _pillars(panels: Sequence[WallSegment], config: WorldConfig, seed: int) -> list[Prism]:
    """Pillars at corners where walls meet, as high as the highest of them."""
    rng = random_stream(seed, "world", "pillars")
    heights: dict[Point, float] = {}
    for panel in panels:
        if not panel.is_open:
            for corner in (panel.start, panel.end):
                heights[corner] = max(heights.get(corner, 0.0), panel.height_m)
    pillars = []
    for corner in sorted(heights):
        chosen, is_round = rng.random(2).tolist()
        half = 0.5 * float(rng.uniform(*config.pillars.size_m))
        if chosen < config.pillars.share:
            x, y = corner
            ground = (
                circle(corner, half)
                if is_round < 0.5
                else shapely.box(x - half, y - half, x + half, y + half)
            )
            pillars.append(Prism(ground, 0.0, heights[corner]))
    return pillars


def _blocks(plan: FloorPlan, config: WorldConfig) -> list[Prism]:
    """Solid ground plans where the plan has no cells."""
    size = plan.cell_m
    absent = [plan.grid.place(int(cell)) for cell in np.flatnonzero(~plan.present)]
    boxes = [
        shapely.box(column * size, row * size, (column + 1) * size, (row + 1) * size)
        for row, column in absent
    ]
    return [
        Prism(part, 0.0, config.walls.height_m) for part in polygons_of(shapely.union_all(boxes))
    ]
