"""One instant of a view, and what several imagers make of it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.dots import DotPattern
from slamsim.cameras.poses import RowPoses
from slamsim.cameras.settings import ProjectorConfig
from slamsim.core.types import Float32Array, FloatArray
from slamsim.sensors.cameras.sight import Sight, View

if TYPE_CHECKING:
    from slamsim.cameras.appearance import Appearance
    from slamsim.sensors.motion import Motion

_PATTERN = 435
"""Seed of the dots, which are those of a model of camera: the same in all of them."""


class Frame:
    """Number ``number`` since the start, its first row being exposed about ``instant_ns``.

    What imagers ask for is made once. earliest_ns: before it the robot stands where it is then.
    """

    def __init__(
        self,
        view: View,
        appearance: Appearance,
        motion: Motion,
        number: int,
        instant_ns: int,
        earliest_ns: int,
    ) -> None:
        self.number, self.instant_ns = number, instant_ns
        self._view, self._appearance, self._motion = view, appearance, motion
        self._earliest_ns = earliest_ns

    @cached_property
    def poses(self) -> RowPoses:
        """Of each row, in the middle of its exposure."""
        return self._view.poses(self._motion, self.instant_ns, self._earliest_ns)

    @cached_property
    def sight(self) -> Sight:
        """What is seen in the middle of the exposure."""
        return self._view.sight(self.poses)

    @cached_property
    def _sharp(self) -> Float32Array:
        return self._view.radiance(self.sight, self._appearance)

    def radiance(self, exposure_s: float, blur_rays: int) -> Float32Array:
        """(n, 3) linear radiance, the mean of so many instants of an exposure, an odd number."""
        if blur_rays == 1:
            return self._sharp
        total = self._sharp.copy()
        for look in range(blur_rays):
            if 2 * look + 1 != blur_rays:
                away_ns = round(1e9 * exposure_s * ((look + 0.5) / blur_rays - 0.5))
                at_ns = self.instant_ns + away_ns
                poses = self._view.poses(self._motion, at_ns, self._earliest_ns)
                total += self._view.radiance(self._view.sight(poses), self._appearance)
        return np.asarray(total / np.float32(blur_rays))

    @cached_property
    def materials(self) -> NDArray[np.uint8]:
        """(n,) numbers of materials."""
        points_m = self.sight.surface.points_m
        return self._appearance.materials(self.sight.triangles, points_m)

    @cached_property
    def instances(self) -> NDArray[np.int32]:
        """(n,) numbers of things."""
        return self._appearance.instances(self.sight.triangles)

    @cached_property
    def ir_reflectance(self) -> Float32Array:
        """(n,) share of infrared light that surfaces throw back."""
        return self._appearance.ir_reflectances[self.materials]

    @cached_property
    def roughness(self) -> Float32Array:
        """(n,) of surfaces: 1 matt, 0 polished."""
        return self._appearance.roughnesses[self.materials]

    def projected(self, projector: ProjectorConfig, T_base_projector: FloatArray) -> Float32Array:
        """(n,) radiance of a projector's dots. T_base_projector: 4 x 4 of its optical frame."""
        surface = self.sight.surface
        placed = self._view.poses(
            self._motion, self.instant_ns, self._earliest_ns, T_base_projector
        )
        directions = placed.in_view(surface.points_m, np.zeros(len(surface.points_m)))
        squares = np.maximum(np.einsum("ni,ni->n", directions, directions), 1e-4)
        dots = DotPattern(_PATTERN).intensity(directions, np.array(self._view.pixel_rad))
        strength = projector.radiance * self.ir_reflectance * surface.cos_incidence
        return np.asarray(strength * dots / squares, dtype=np.float32)
