"""What a world must tell for cameras to see it; and a world of plain grey."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Float32Array, FloatArray, Occluded

_GREY = 0.5
_LEAST_LIT = 0.3
"""Albedo of a world without looks, and the light on a surface that is turned away."""


class Appearance(Protocol):
    """The looks of a world, asked where rays hit it; of no hit the number of the triangle is
    larger than any."""

    def shade(
        self,
        points_m: FloatArray,
        normals: Float32Array,
        triangles: NDArray[Any],
        footprint_m: FloatArray | float,
        occluded: Occluded,
    ) -> Float32Array:
        """(n, 3) linear radiance in red, green and blue."""
        ...

    def materials(self, triangles: NDArray[Any], points_m: FloatArray) -> NDArray[np.uint8]:
        """(n,) numbers of materials, 0 for no hit."""
        ...

    def instances(self, triangles: NDArray[Any]) -> NDArray[np.int32]:
        """(n,) numbers of things, 0 for no hit."""
        ...

    @property
    def ir_reflectances(self) -> Float32Array:
        """(m,) share of infrared light that each material throws back."""
        ...

    @property
    def roughnesses(self) -> Float32Array:
        """(m,) of each material: 1 matt, 0 polished."""
        ...

    @property
    def mirroring(self) -> Float32Array | None:
        """(m,) share of light that each material throws back as a mirror; None where none does."""
        ...


class PlainGrey:
    """A world of one grey material under a lamp above, the darker the steeper: without looks.

    normals are towards who looks. triangles: how many there are with those of the floor.
    """

    def __init__(self, triangles: int) -> None:
        self._triangles = triangles

    def shade(
        self,
        points_m: FloatArray,
        normals: Float32Array,
        triangles: NDArray[Any],
        footprint_m: FloatArray | float,
        occluded: Occluded,
    ) -> Float32Array:
        lit = _LEAST_LIT + (1.0 - _LEAST_LIT) * (0.5 + 0.3 * normals[:, 2] + 0.2 * normals[:, 0])
        grey = np.where(triangles < self._triangles, _GREY * lit, 0.0).astype(np.float32)
        return np.repeat(grey[:, None], 3, axis=1)

    def materials(self, triangles: NDArray[Any], points_m: FloatArray) -> NDArray[np.uint8]:
        return (triangles < self._triangles).astype(np.uint8)

    def instances(self, triangles: NDArray[Any]) -> NDArray[np.int32]:
        return (triangles < self._triangles).astype(np.int32)

    @property
    def ir_reflectances(self) -> Float32Array:
        return np.array([0.0, _GREY], dtype=np.float32)

    @property
    def roughnesses(self) -> Float32Array:
        return np.ones(2, dtype=np.float32)

    @property
    def mirroring(self) -> Float32Array | None:
        return None
