"""Lamps: where they hang, and how much light each gives to a point; compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slamsim.config.layout import LampsConfig
from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array, FloatArray, Grid, IntArray

_CELL_M = 1.0
_LEAST = 1e-4
"""Light fainter than this, of a lamp, is none: far below a bit of an image."""

_WARM, _COLD = np.array([1.0, 0.87, 0.72]), np.array([0.90, 0.96, 1.0])
"""Tints of lamps of some 3500 K and 7000 K, relative to daylight's white."""


class Lamps(NamedTuple):
    """positions_m: (l, 3) in the map frame. colours: (l, 3) tints, the largest 1.

    strength: radiant intensity straight down. reach_m: no light from here on. shadowing: how many
    lamps light one point at most. ambient: light from everywhere. Cells of 1 m over the ground,
    from low_m on, columns of them: of each, from entry first_of[cell] of ``near`` on, the lamps
    in reach.
    """

    positions_m: FloatArray
    colours: FloatArray
    strength: float
    reach_m: float
    shadowing: int
    ambient: float
    low_m: FloatArray
    columns: int
    first_of: IntArray
    near: IntArray


def hang_lamps(free: Grid, config: LampsConfig, rng: np.random.Generator) -> Lamps:
    """Lamps over the free cells of a grid (0 is free), none nearer to another than the spacing.

    From free cells in random order each that is far enough from all before gets a lamp.
    """
    rows, columns = np.nonzero(free.occupancy == 0.0)
    places = np.column_stack([columns, rows]) + 0.5
    places_m = rng.permutation(places * free.resolution_m + free.origin_m)
    chosen = [places_m[0]]
    left = _farther(places_m, chosen[0], config.spacing_m)
    while len(left):
        chosen.append(left[0])
        left = _farther(left, chosen[-1], config.spacing_m)
    warmth = rng.random((len(chosen), 1))
    positions = np.column_stack([chosen, np.full(len(chosen), config.height_m)])
    return _lamps(positions, _COLD + warmth * (_WARM - _COLD), config)


def _farther(places_m: FloatArray, from_m: FloatArray, distance_m: float) -> FloatArray:
    far: BoolArray = np.sum((places_m - from_m) ** 2, axis=1) >= distance_m**2
    return places_m[far]


def _lamps(positions_m: FloatArray, colours: FloatArray, config: LampsConfig) -> Lamps:
    low = positions_m[:, :2].min(axis=0) - config.reach_m
    size = positions_m[:, :2].max(axis=0) + config.reach_m - low
    columns, rows = np.ceil(size / _CELL_M).astype(int).tolist()
    middles = np.indices((rows, columns)).reshape(2, -1)[::-1].T * _CELL_M + 0.5 * _CELL_M + low
    reach_m = config.reach_m + math.sqrt(0.5) * _CELL_M
    lists = [np.flatnonzero(_near(positions_m, middle, reach_m)) for middle in middles]
    counts = [len(each) for each in lists]
    strength = config.brightness * config.height_m**2
    return Lamps(
        *(positions_m, colours, strength, config.reach_m, config.shadowing, config.ambient),
        *(low, columns, np.cumsum([0, *counts]), np.concatenate(lists)),
    )


def _near(positions_m: FloatArray, place_m: FloatArray, reach_m: float) -> BoolArray:
    return np.asarray(np.sum((positions_m[:, :2] - place_m) ** 2, axis=1) <= reach_m**2)


class Lit(NamedTuple):
    """Light from single lamps, (m,) each: the point and the lamp, and how strongly it would light
    it with nothing between."""

    points: IntArray
    lamps: IntArray
    strengths: Float32Array


@kernel
def lit_by(lamps: Lamps, points_m: FloatArray, normals: Float32Array) -> Lit:
    """The lamps that light (n, 3) points of surfaces with (n, 3) unit normals best.

    What the strongest lamp left out would give is taken off each, so that no edge shows where
    another lamp becomes the last one.
    """
    most = lamps.shadowing
    points = np.empty(len(points_m) * most, dtype=np.int64)
    numbers = np.empty(len(points_m) * most, dtype=np.int64)
    strengths = np.empty(len(points_m) * most, dtype=np.float32)
    best, best_lamps = np.zeros(most + 1), np.zeros(most + 1, dtype=np.int64)
    count = 0
    for i in range(len(points_m)):
        _strongest(lamps, points_m[i], normals[i], best, best_lamps)
        for rank in range(most):
            strength = best[rank] - best[most]
            if strength <= _LEAST:
                break
            points[count], numbers[count], strengths[count] = i, best_lamps[rank], strength
            count += 1
    return Lit(points[:count], numbers[:count], strengths[:count])


@kernel
def _strongest(
    lamps: Lamps, point: FloatArray, normal: Float32Array, best: FloatArray, numbers: IntArray
) -> None:
    """Fill in the strongest lights, the strongest first, and the numbers of their lamps."""
    best[:] = 0.0
    column = math.floor((point[0] - lamps.low_m[0]) / _CELL_M)
    cell = math.floor((point[1] - lamps.low_m[1]) / _CELL_M) * lamps.columns + column
    if not (0 <= column < lamps.columns and 0 <= cell < len(lamps.first_of) - 1):
        return
    for at in range(lamps.first_of[cell], lamps.first_of[cell + 1]):
        lamp = lamps.near[at]
        strength = light_of(lamps, lamp, point, normal)
        rank = len(best) - 1
        if strength <= best[rank]:
            continue
        while rank > 0 and strength > best[rank - 1]:
            best[rank], numbers[rank] = best[rank - 1], numbers[rank - 1]
            rank -= 1
        best[rank], numbers[rank] = strength, lamp


@kernel
def light_of(lamps: Lamps, lamp: int, point: FloatArray, normal: Float32Array) -> float:
    """Irradiance of a surface from one lamp: a small flat panel that faces the floor (Lambert),
    faded out towards its reach (the window of Karis 2013, "Real shading in Unreal Engine 4")."""
    x, y = lamps.positions_m[lamp, 0] - point[0], lamps.positions_m[lamp, 1] - point[1]
    z = lamps.positions_m[lamp, 2] - point[2]
    square = x * x + y * y + z * z
    facing = x * normal[0] + y * normal[1] + z * normal[2]
    share = square / (lamps.reach_m * lamps.reach_m)
    if z <= 0.0 or facing <= 0.0 or share >= 1.0:
        return 0.0
    window = 1.0 - share * share
    return float(lamps.strength * window * window * facing * z / (square * square))


@kernel
def shadow_rays(
    lamps: Lamps, lit: Lit, points_m: FloatArray, normals: Float32Array, lift_m: float
) -> tuple[FloatArray, Float32Array, Float32Array]:
    """Rays from lit points to their lamps: origins (m, 3), so far above the surface; unit
    directions (m, 3); distances (m,), ending as far before the lamp."""
    count = len(lit.points)
    origins = np.empty((count, 3))
    directions = np.empty((count, 3), dtype=np.float32)
    distances = np.empty(count, dtype=np.float32)
    for i in range(count):
        point, lamp = lit.points[i], lit.lamps[i]
        square = 0.0
        for k in range(3):
            origins[i, k] = points_m[point, k] + lift_m * normals[point, k]
            square += (lamps.positions_m[lamp, k] - origins[i, k]) ** 2
        distance = math.sqrt(square)
        for k in range(3):
            directions[i, k] = (lamps.positions_m[lamp, k] - origins[i, k]) / distance
        distances[i] = distance - lift_m
    return origins, directions, distances


@kernel
def radiance_of(
    lamps: Lamps, lit: Lit, hidden: BoolArray, normals: Float32Array, albedo: Float32Array
) -> Float32Array:
    """(n, 3) linear radiance of matt surfaces: albedo times the light of all lamps not hidden,
    and of the ambient, of which three quarters come from all around and the rest from above."""
    radiance = np.empty_like(albedo)
    for i in range(len(albedo)):
        ambient = lamps.ambient * (0.75 + 0.25 * normals[i, 2])
        for channel in range(3):
            radiance[i, channel] = ambient
    for i in range(len(lit.points)):
        if not hidden[i]:
            for channel in range(3):
                tint = lamps.colours[lit.lamps[i], channel]
                radiance[lit.points[i], channel] += lit.strengths[i] * tint
    for i in range(len(albedo)):
        for channel in range(3):
            radiance[i, channel] *= albedo[i, channel]
    return radiance
