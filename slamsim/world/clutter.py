"""Clutter: boxes, cylinders, tables, chairs, L shapes and leaning panels."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from slamsim.config.world import ClutterConfig, ClutterShape
from slamsim.core.geometry import transform_points
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.world.floor_plan import FloorPlan
from slamsim.world.parts import Thing
from slamsim.world.prism import Prism, circle, moved

MAX_THINGS = 20_000
_TRIES = 30
_BOARD_M = 0.03
"""Thickness of table tops, seats and panels."""


def place_clutter(
    plan: FloorPlan, ways: Polygon, walls: Sequence[Prism], config: ClutterConfig, seed: int
) -> list[Thing]:
    """Things at random places that touch neither walls nor ways nor each other.

    Each thing draws from a stream of its own, so that one which finds no room moves no other.
    Raises SlamsimError for too many things.
    """
    wanted = round(config.per_cell * int(plan.present.sum()))
    if wanted > MAX_THINGS:
        raise SlamsimError(
            f"clutter.per_cell {config.per_cell:g} makes {wanted} things in this world; at most "
            f"{MAX_THINGS} are placed"
        )
    taken = shapely.union_all([ways, *(wall.footprint for wall in walls)])
    shapely.prepare(taken)
    placed: list[Thing] = []
    near = _Neighbourhood(plan.cell_m)
    for number in range(wanted):
        rng = random_stream(seed, "world", "clutter", str(number))
        shape = config.shapes[int(rng.integers(len(config.shapes)))]
        thing = _MAKERS[shape](config, rng)
        poses = _draw_poses(plan, rng)
        grounds = _moved_grounds(thing, poses)
        for at in np.flatnonzero(~shapely.intersects(taken, grounds)).tolist():
            if not near.touches(grounds[at]):
                near.add(grounds[at])
                parts = tuple(moved(part, poses[at]) for part in thing)
                placed.append(Thing(shape, parts))
                break
    return placed


def _draw_poses(plan: FloorPlan, rng: np.random.Generator) -> FloatArray:
    """(tries, 3) x_m, y_m, yaw_rad anywhere in the cells of the plan."""
    cells = rng.choice(np.flatnonzero(plan.present), _TRIES)
    middles = np.array([plan.centre_m(cell) for cell in cells.tolist()])
    shifts = rng.uniform(-0.5, 0.5, (_TRIES, 2)) * plan.cell_m
    return np.column_stack([middles + shifts, rng.uniform(-np.pi, np.pi, _TRIES)])


def _moved_grounds(thing: Sequence[Prism], poses: FloatArray) -> NDArray[np.object_]:
    """(tries,) the convex ground that a thing claims at any height, at each of the poses."""
    shadows = [part.shadow(-np.inf, np.inf) for part in thing]
    corners = shapely.get_coordinates(shapely.convex_hull(shapely.union_all(shadows)))
    return np.asarray(shapely.polygons(transform_points(poses[:, None], corners)))


class _Neighbourhood:
    """Polygons in square buckets, so that only near ones are compared."""

    def __init__(self, bucket_m: float) -> None:
        self._bucket_m = bucket_m
        self._buckets: dict[tuple[int, int], list[Polygon]] = {}

    def _keys(self, polygon: Polygon) -> list[tuple[int, int]]:
        low_x, low_y, high_x, high_y = (int(b // self._bucket_m) for b in polygon.bounds)
        return [(x, y) for x in range(low_x, high_x + 1) for y in range(low_y, high_y + 1)]

    def add(self, polygon: Polygon) -> None:
        for key in self._keys(polygon):
            self._buckets.setdefault(key, []).append(polygon)

    def touches(self, polygon: Polygon) -> bool:
        return any(
            other.intersects(polygon)
            for key in self._keys(polygon)
            for other in self._buckets.get(key, [])
        )


def _rectangle(centre_x: float, centre_y: float, size_x: float, size_y: float) -> Polygon:
    return shapely.box(
        centre_x - 0.5 * size_x,
        centre_y - 0.5 * size_y,
        centre_x + 0.5 * size_x,
        centre_y + 0.5 * size_y,
    )


def _box(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    ground = _rectangle(0.0, 0.0, rng.uniform(*config.size_m), rng.uniform(*config.size_m))
    return [Prism(ground, 0.0, rng.uniform(*config.height_m))]


def _cylinder(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    ground = circle((0.0, 0.0), 0.5 * rng.uniform(*config.size_m))
    return [Prism(ground, 0.0, rng.uniform(*config.height_m))]


def _l_shape(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    long_x, long_y = rng.uniform(*config.size_m, 2)
    arm = rng.uniform(0.25, 0.5) * min(long_x, long_y)
    corners = [(0, 0), (long_x, 0), (long_x, arm), (arm, arm), (arm, long_y), (0, long_y)]
    return [Prism(Polygon(corners), 0.0, rng.uniform(*config.height_m))]


def _panel(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    """A board on its edge whose top leans over by up to half its height."""
    height = rng.uniform(*config.height_m)
    ground = _rectangle(0.0, 0.0, rng.uniform(*config.size_m), _BOARD_M)
    return [Prism(ground, 0.0, height, (0.0, rng.uniform(0.15, 0.5) * height))]


def _legs(size_x: float, size_y: float, thickness: float, height: float) -> list[Prism]:
    """Four square legs flush with the corners of a rectangle."""
    x, y = 0.5 * (size_x - thickness), 0.5 * (size_y - thickness)
    return [
        Prism(_rectangle(sx * x, sy * y, thickness, thickness), 0.0, height)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


def _table(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    del config
    size_x, size_y = rng.uniform(0.5, 0.9), rng.uniform(0.45, 0.7)
    height = rng.uniform(0.7, 0.76)
    top = Prism(_rectangle(0.0, 0.0, size_x, size_y), height - _BOARD_M, height)
    return [*_legs(size_x, size_y, rng.uniform(0.035, 0.06), height - _BOARD_M), top]


def _chair(config: ClutterConfig, rng: np.random.Generator) -> list[Prism]:
    del config
    size, seat_at = rng.uniform(0.36, 0.46), rng.uniform(0.42, 0.47)
    seat = Prism(_rectangle(0.0, 0.0, size, size), seat_at - _BOARD_M, seat_at)
    back = Prism(_rectangle(0.0, 0.5 * (size - _BOARD_M), size, _BOARD_M), seat_at, seat_at + 0.45)
    return [*_legs(size, size, rng.uniform(0.025, 0.04), seat_at - _BOARD_M), seat, back]


Maker = Callable[[ClutterConfig, np.random.Generator], list[Prism]]
_MAKERS: dict[ClutterShape, Maker] = {
    "box": _box,
    "cylinder": _cylinder,
    "table": _table,
    "chair": _chair,
    "l_shape": _l_shape,
    "panel": _panel,
}
