"""The colour of surfaces at points, from their finishes and from what hangs on them; compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.world.looks.decals import DecalTable
from slamsim.world.looks.finishes import FinishTable
from slamsim.world.looks.patterns import pattern_at

Colour = tuple[float, float, float]


class Painting(NamedTuple):
    """Of each triangle, the floor's two included: its finish and its plane, (t,) each; of each
    plane: u_axes and v_axes (p, 3). texture: 0 for no contrast, 1 for all of it."""

    finish_of: NDArray[np.int64]
    plane_of: NDArray[np.int64]
    u_axes: FloatArray
    v_axes: FloatArray
    finishes: FinishTable
    decals: DecalTable
    texture: float


@kernel
def colours_at(
    painting: Painting, triangles: IntArray, points_m: FloatArray, footprint_m: FloatArray
) -> Float32Array:
    """(n, 3) linear colours where (n,) triangles were hit; 0 where the number is that of none."""
    colours = np.zeros((len(triangles), 3), dtype=np.float32)
    for i in range(len(triangles)):
        triangle = triangles[i]
        if not 0 <= triangle < len(painting.plane_of):
            continue
        plane = painting.plane_of[triangle]
        u, v = _on_plane(painting, plane, points_m[i])
        decal = decal_at(painting.decals, plane, u, v)
        if decal < 0:
            colour = _finish_colour(painting, painting.finish_of[triangle], u, v, footprint_m[i])
        else:
            colour = _decal_colour(painting.decals, decal, u, v, footprint_m[i])
        for channel in range(3):
            colours[i, channel] = min(max(colour[channel], 0.0), 1.0)
    return colours


@kernel
def decals_at(painting: Painting, triangles: IntArray, points_m: FloatArray) -> IntArray:
    """(n,) number of the decal that was hit, -1 for none."""
    found = np.full(len(triangles), -1, dtype=np.int64)
    for i in range(len(triangles)):
        if 0 <= triangles[i] < len(painting.plane_of):
            plane = painting.plane_of[triangles[i]]
            u, v = _on_plane(painting, plane, points_m[i])
            found[i] = decal_at(painting.decals, plane, u, v)
    return found


@kernel
def _on_plane(painting: Painting, plane: int, point_m: FloatArray) -> tuple[float, float]:
    a, b = painting.u_axes[plane], painting.v_axes[plane]
    u = a[0] * point_m[0] + a[1] * point_m[1] + a[2] * point_m[2]
    v = b[0] * point_m[0] + b[1] * point_m[1] + b[2] * point_m[2]
    return u, v


@kernel
def decal_at(decals: DecalTable, plane: int, u: float, v: float) -> int:
    """Number of the decal at a place of a plane, -1 for none."""
    for decal in range(decals.first_of[plane], decals.first_of[plane + 1]):
        x, y = u - decals.places_m[decal, 0], v - decals.places_m[decal, 1]
        if 0.0 <= x < decals.places_m[decal, 2] and 0.0 <= y < decals.places_m[decal, 3]:
            return decal
    return -1


@kernel
def _finish_colour(painting: Painting, finish: int, u: float, v: float, px: float) -> Colour:
    numbers = painting.finishes.numbers[finish]
    mix, tone = pattern_at(
        painting.finishes.patterns[finish],
        *(u, v),
        painting.finishes.seeds[finish],
        *(numbers[0], numbers[1], numbers[2]),
        max(px, 1e-6),
    )
    mix = painting.texture * mix
    tone = max(1.0 + painting.texture * (tone - 1.0), 0.0)
    r = tone * ((1.0 - mix) * numbers[3] + mix * numbers[6])
    g = tone * ((1.0 - mix) * numbers[4] + mix * numbers[7])
    b = tone * ((1.0 - mix) * numbers[5] + mix * numbers[8])
    return r, g, b


@kernel
def _decal_colour(decals: DecalTable, decal: int, u: float, v: float, px: float) -> Colour:
    """The mean of a sheet over the pixel, cut to the sheet: four looks at its summed table."""
    rows, columns = decals.shapes[decal]
    place = decals.places_m[decal]
    x, y = columns * (u - place[0]) / place[2], rows * (1.0 - (v - place[1]) / place[3])
    wide, high = columns * px / place[2], rows * px / place[3]
    smallest = decals.blurs[decal]
    half_x, half_y = 0.5 * max(wide, smallest), 0.5 * max(high, smallest)
    left, right = max(x - half_x, 0.0), min(x + half_x, 1.0 * columns)
    top, low = max(y - half_y, 0.0), min(y + half_y, 1.0 * rows)
    share = 1.0 / max((right - left) * (low - top), 1e-12)
    all_, first, stride = decals.sums, decals.starts[decal], columns + 1
    a, b = _sum_to(all_, first, stride, low, right), _sum_to(all_, first, stride, top, left)
    c, d = _sum_to(all_, first, stride, low, left), _sum_to(all_, first, stride, top, right)
    r = share * (a[0] + b[0] - c[0] - d[0])
    g = share * (a[1] + b[1] - c[1] - d[1])
    return r, g, share * (a[2] + b[2] - c[2] - d[2])


@kernel
def _sum_to(sums: FloatArray, first: int, stride: int, y: float, x: float) -> Colour:
    """The integral of a sheet from its corner to (x, y): exact, for its pixels are constant."""
    row, column = math.floor(y), math.floor(x)
    t, s = y - row, x - column
    at = first + row * stride + column
    right, below = (1 if s > 0.0 else 0), (stride if t > 0.0 else 0)
    w00, w01, w10, w11 = (1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s
    r = w00 * sums[at, 0] + w01 * sums[at + right, 0]
    r += w10 * sums[at + below, 0] + w11 * sums[at + below + right, 0]
    g = w00 * sums[at, 1] + w01 * sums[at + right, 1]
    g += w10 * sums[at + below, 1] + w11 * sums[at + below + right, 1]
    b = w00 * sums[at, 2] + w01 * sums[at + right, 2]
    b += w10 * sums[at + below, 2] + w11 * sums[at + below + right, 2]
    return r, g, b
