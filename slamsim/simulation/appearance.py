"""The looks of a world as cameras ask for them; drives in pieces that cameras can be sensed in."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.appearance import Appearance, Occluded
from slamsim.config.looks import LooksConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Drive, Float32Array, FloatArray
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.world.looks.build import build_looks
from slamsim.world.looks.looks import Looks
from slamsim.world.looks.materials import MATERIALS
from slamsim.world.model import World

_PIECE_STEPS = 120
"""Half a second of the default physics: of images of the truth no more are held in memory."""


@dataclass(frozen=True, eq=False)
class WorldAppearance:
    """A ``slamsim.cameras.appearance.Appearance`` of looks."""

    looks: Looks

    def shade(
        self,
        points_m: FloatArray,
        normals: Float32Array,
        triangles: NDArray[np.uint32],
        footprint_m: FloatArray | float,
        occluded: Occluded,
    ) -> Float32Array:
        return self.looks.shade(points_m, normals, triangles, footprint_m, occluded)

    def materials(self, triangles: NDArray[np.uint32], points_m: FloatArray) -> NDArray[np.uint8]:
        return self.looks.materials(triangles, points_m)

    def instances(self, triangles: NDArray[np.uint32]) -> NDArray[np.int32]:
        return self.looks.instances(triangles)

    @property
    def ir_reflectances(self) -> Float32Array:
        return np.array([each.ir_reflectance for each in MATERIALS], dtype=np.float32)

    @property
    def roughnesses(self) -> Float32Array:
        return np.array([each.roughness for each in MATERIALS], dtype=np.float32)

    @cached_property
    def mirroring(self) -> Float32Array | None:
        """That of a mirror and of the surface of glass, which what is behind does not dim."""
        shares = [e.ir_reflectance * (e.is_mirror or e.is_glass) for e in MATERIALS]
        found = np.array(shares, dtype=np.float32)
        hung = self.looks.painting.decals.materials
        return found if found[hung].any() else None


def appearance_of(world: World, config: LooksConfig) -> Callable[[], Appearance]:
    """What gives the looks of a world, which are made when the first camera asks."""

    @cache
    def made() -> Appearance:
        return WorldAppearance(build_looks(world, config))

    return made


def casting_threads(sensors: SensorsConfig) -> int:
    """All cores where there are cameras, whose rays are many; what is sensed is the same."""
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    return (os.cpu_count() or 1) if has_cameras else 1


def in_pieces(window: Drive, sensors: SensorsConfig) -> Iterator[Drive]:
    """A window as it is, or in short pieces where there are cameras, whose images fill memory.

    What is sensed does not depend on it.
    """
    has_cameras = any(isinstance(entry, CameraEntry) for entry in sensors.additional)
    if not has_cameras or len(window) <= 2 * _PIECE_STEPS:
        yield window
        return
    starts = np.arange(0, len(window) - _PIECE_STEPS, _PIECE_STEPS)
    for start, end in zip(starts, [*starts[1:], len(window)], strict=True):
        yield Drive(**{f.name: getattr(window, f.name)[start:end] for f in fields(Drive)})
