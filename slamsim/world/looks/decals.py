"""Flat sheets on surfaces: posters, tags, panes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.world.looks.finishes import MaterialId
from slamsim.world.looks.places import Place


@dataclass(frozen=True, slots=True, eq=False)
class Decal:
    """A sheet at a place of a plane.

    pixels: (rows, columns, 3) linear colours, the first row at the top; decals may share them.
    is_crisp: pixels have sharp edges, as print has; those of others are blurred into each other.
    """

    place: Place
    material: MaterialId
    pixels: Float32Array
    is_crisp: bool = False


class DecalTable(NamedTuple):
    """Decals as kernels read them, those of one plane one behind the other.

    first_of: (p + 1,) number of the first decal of each plane. Of each decal: places_m (d, 4)
    corner and sides, materials (d,), shapes (d, 2) rows and columns of its pixels, blurs (d,) in
    pixels, starts (d,) of its table in sums. sums: (m, 3) summed tables, each of
    (rows + 1) x (columns + 1) entries (Crow 1984).
    """

    first_of: IntArray
    places_m: FloatArray
    materials: NDArray[np.uint8]
    shapes: IntArray
    starts: IntArray
    blurs: FloatArray
    sums: FloatArray


def decal_table(decals: Sequence[Decal], planes: int) -> DecalTable:
    """The table of decals on so many planes."""
    ordered = sorted(decals, key=lambda decal: decal.place.plane)
    places = [(d.place.u_m, d.place.v_m, d.place.width_m, d.place.height_m) for d in ordered]
    on_planes = np.array([decal.place.plane for decal in ordered], dtype=np.int64)
    starts, sums = _tables(ordered)
    return DecalTable(
        np.searchsorted(on_planes, np.arange(planes + 1)),
        np.array(places, dtype=np.float64).reshape(-1, 4),
        np.array([decal.material for decal in ordered], dtype=np.uint8),
        np.array([d.pixels.shape[:2] for d in ordered], dtype=np.int64).reshape(-1, 2),
        starts,
        np.array([0.0 if decal.is_crisp else 1.0 for decal in ordered], dtype=np.float64),
        sums,
    )


def _tables(decals: Sequence[Decal]) -> tuple[IntArray, FloatArray]:
    """(d,) where the summed table of each decal begins, and all of them, none twice."""
    starts: dict[int, int] = {}
    tables, count = [np.zeros((0, 3))], 0
    for decal in decals:
        if id(decal.pixels) not in starts:
            starts[id(decal.pixels)] = count
            tables.append(_summed(decal.pixels))
            count += len(tables[-1])
    return np.array([starts[id(d.pixels)] for d in decals], dtype=np.int64), np.concatenate(tables)


def _summed(pixels: Float32Array) -> FloatArray:
    """((rows + 1) * (columns + 1), 3) sums of all pixels above and left of each corner."""
    sums = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1, 3))
    sums[1:, 1:] = pixels.astype(np.float64).cumsum(axis=0).cumsum(axis=1)
    return sums.reshape(-1, 3)
