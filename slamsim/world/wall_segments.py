"""Wall segments: the borders of the cells of a floor plan, and the passages between them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import shapely
from shapely import LineString, Polygon

from slamsim.config.world import WorldConfig
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import SlamsimError
from slamsim.world.cells import Edge
from slamsim.world.floor_plan import FloorPlan

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class WallSegment:
    """The border between two neighbouring places, at least one of them a cell.

    start, end: corners of the cells, x and y in metres. left, right: the cells on both sides,
    seen from start to end; None where there is no cell. is_open: one may pass and nothing
    stands here. door_at_m: distance of the door's middle from start, None without a door.
    thickness_m, height_m: of the wall, if there is one.
    """

    start: Point
    end: Point
    left: int | None
    right: int | None
    is_open: bool
    door_at_m: float | None
    thickness_m: float
    height_m: float

    @property
    def along(self) -> Point:
        """Unit vector from start to end."""
        length = math.dist(self.start, self.end)
        return (self.end[0] - self.start[0]) / length, (self.end[1] - self.start[1]) / length

    def point(self, along_m: float, left_m: float) -> Point:
        """The point so far from start along the panel and to the left of it."""
        ux, uy = self.along
        return (
            self.start[0] + along_m * ux - left_m * uy,
            self.start[1] + along_m * uy + left_m * ux,
        )

    def rectangle(self, from_m: float, to_m: float, right_m: float, left_m: float) -> Polygon:
        """The ground from one distance along the panel to another, and from so far to its
        right to so far to its left."""
        return Polygon(
            [
                self.point(from_m, -right_m),
                self.point(to_m, -right_m),
                self.point(to_m, left_m),
                self.point(from_m, left_m),
            ]
        )


def lay_panels(plan: FloorPlan, config: WorldConfig, seed: int) -> list[WallSegment]:
    """All borders of cells in a fixed order, the thickness and height of each wall drawn."""
    sizes = random_stream(seed, "world", "walls")
    offsets = random_stream(seed, "world", "door offsets")
    passages = frozenset(plan.passages)
    panels = []
    for start, end, left, right in _borders(plan):
        thickness, height, offset = *sizes.uniform(-1.0, 1.0, 2), offsets.uniform(-1.0, 1.0)
        edge = _edge(left, right)
        is_door = edge in plan.doors
        panels.append(
            WallSegment(
                start,
                end,
                left,
                right,
                edge in passages and not is_door,
                0.5 * plan.cell_m + float(offset) * config.doors.offset_m if is_door else None,
                config.walls.thickness_m + float(thickness) * config.walls.thickness_jitter_m,
                config.walls.height_m + float(height) * config.walls.height_jitter_m,
            )
        )
    return panels


def _edge(left: int | None, right: int | None) -> Edge | None:
    return None if left is None or right is None else (min(left, right), max(left, right))


def _borders(plan: FloorPlan) -> Iterator[tuple[Point, Point, int | None, int | None]]:
    """Start, end, left and right cell of each side of a cell, once."""
    rows, columns, size = plan.grid.rows, plan.grid.columns, plan.cell_m

    def present(row: int, column: int) -> int | None:
        if not (0 <= row < rows and 0 <= column < columns and plan.present[row, column]):
            return None
        return plan.grid.cell(row, column)

    for row in range(rows + 1):
        for column in range(columns + 1):
            corner = (column * size, row * size)
            here, south, west = (
                present(row, column),
                present(row - 1, column),
                present(row, column - 1),
            )
            if here is not None or south is not None:
                yield corner, ((column + 1) * size, row * size), here, south
            if here is not None or west is not None:
                yield corner, (column * size, (row + 1) * size), west, here


def check_fit(plan: FloorPlan, config: WorldConfig) -> None:
    """Raise SlamsimError, with the numbers, if something could reach into a way.

    With these inequalities no wall, dent, pillar or door frame can touch ``reserve_ways``.
    """
    thickest = config.walls.thickness_m + config.walls.thickness_jitter_m
    reach = {"walls.thickness_m and its jitter": 0.5 * thickest}
    if config.dents.share > 0.0:
        reach["walls.thickness_m and dents.depth_m"] = 0.5 * thickest + config.dents.depth_m[1]
        _check_dents(plan, config, thickest)
    if config.pillars.share > 0.0:
        reach["pillars.size_m"] = 0.5 * config.pillars.size_m[1]
    aside = 0.0
    if plan.doors:
        reach["walls.thickness_m and doors.frame_m"] = 0.5 * thickest + config.doors.frame_m
        aside = config.doors.offset_m
        _check_doors(plan, config, thickest)
    widest = max(reach, key=lambda name: reach[name])
    _require(
        "clearance_m" + (" + 2 x doors.offset_m" if aside else ""),
        config.clearance_m + 2.0 * aside,
        plan.cell_m - 2.0 * reach[widest],
        f"cell_m {plan.cell_m:g} less twice {reach[widest]:g} m of {widest}",
    )


def _check_doors(plan: FloorPlan, config: WorldConfig, thickest_m: float) -> None:
    doors = config.doors
    _require("clearance_m", config.clearance_m, doors.width_m, "doors.width_m")
    _require(
        "doors.width_m + 2 x (frame_m + offset_m)",
        doors.width_m + 2.0 * (doors.frame_m + doors.offset_m),
        plan.cell_m - thickest_m,
        f"cell_m {plan.cell_m:g} less walls.thickness_m and its jitter",
    )


def _check_dents(plan: FloorPlan, config: WorldConfig, thickest_m: float) -> None:
    thinnest = config.walls.thickness_m - config.walls.thickness_jitter_m
    _require(
        "dents.depth_m",
        config.dents.depth_m[1],
        0.8 * thinnest,
        f"0.8 of the thinnest wall, {thinnest:g} m",
    )
    _require(
        "dents.width_m",
        config.dents.width_m[1],
        plan.cell_m - thickest_m,
        f"cell_m {plan.cell_m:g} less walls.thickness_m and its jitter",
    )


def _require(name: str, need_m: float, have_m: float, what: str) -> None:
    if need_m > have_m + 1e-9:
        raise SlamsimError(
            f"the world does not fit: {name} is {need_m:.3g} m, more than {have_m:.3g} m ({what})"
        )


def reserve_ways(plan: FloorPlan, panels: list[WallSegment], config: WorldConfig) -> Polygon:
    """The ground that stays free: from the middle of each cell straight through its passages,
    ``clearance_m`` wide; it hangs together if the plan does."""
    lines = [_way(plan, panel, config) for panel in panels if _passable(panel)]
    middles = [
        shapely.Point(plan.centre_m(cell))
        for cell in range(len(plan.grid))
        if plan.present.flat[cell]
    ]
    ways = shapely.union_all([*lines, *middles]).buffer(0.5 * config.clearance_m)
    assert isinstance(ways, Polygon), "the cells of a plan hang together"
    return ways


def _passable(panel: WallSegment) -> bool:
    return panel.is_open or panel.door_at_m is not None


def _way(plan: FloorPlan, panel: WallSegment, config: WorldConfig) -> LineString:
    """From cell to cell; through a door square to the wall, so that its posts stay clear."""
    assert panel.left is not None and panel.right is not None, "ways join cells"
    left, right = plan.centre_m(panel.left), plan.centre_m(panel.right)
    if panel.door_at_m is None:
        return LineString([left, right])
    reach = 0.5 * (panel.thickness_m + config.clearance_m) + config.doors.frame_m
    at = panel.door_at_m
    return LineString([left, panel.point(at, reach), panel.point(at, -reach), right])
