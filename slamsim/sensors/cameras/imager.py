"""One imager: from what a view sees to images of its kind, packed in threads beside."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.auto_exposure import AutoExposure
from slamsim.cameras.depth_model import DepthModel
from slamsim.cameras.response import ImageSensor
from slamsim.core.jit import kernel
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, Float32Array
from slamsim.sensors.cameras.frame import Frame
from slamsim.sensors.cameras.packing import packer
from slamsim.sensors.cameras.sight import Sight

if TYPE_CHECKING:
    from slamsim.sensors.cameras.entry import CameraSettings

Submit = Callable[..., "Future[bytes]"]
Align = Callable[[NDArray[np.uint16]], NDArray[np.uint16]]


@dataclass(slots=True, eq=False)
class Image:
    """One image of an imager. payload: packed bytes, or those of the pixels. aligned: likewise, of
    the same depth in another imager's pixels. exposure_s, gain: 0 and 1 of depth."""

    exposure_s: float
    gain: float
    payload: Future[bytes]
    aligned: Future[bytes] | None = None


class LightImager:
    """Colour, grey or infrared. The noise of a frame depends on its number alone."""

    def __init__(self, entry: CameraSettings, name: str, seed: int) -> None:
        config = entry.imagers[name]
        self._config, self._camera = config, config.lens.model()
        self._seed, self._name = seed, (entry.name, name)
        self._sensor = ImageSensor(config.sensor, self._camera)
        self._auto = AutoExposure(config.exposure, entry.rate_hz)
        self._projector = entry.projector if config.kind == "infrared" else None
        self._T_base_projector = entry.T_base_projector
        self._pack = packer(config)

    def image(self, frame: Frame, submit: Submit) -> Image:
        """What the sensor makes of the frame, which also sets the exposure of the next one."""
        exposure_s, gain = self._auto.exposure_s, self._auto.gain
        rng = random_stream(self._seed, *self._name, "noise", str(frame.number))
        pixels, mean = self._sensor.exposed(self._light(frame, exposure_s), exposure_s, gain, rng)
        self._auto.measured(mean)
        shape = (self._camera.height, self._camera.width, pixels.shape[1])
        shaped = pixels.reshape(shape if pixels.shape[1] > 1 else shape[:2])
        return Image(exposure_s, gain, submit(self._pack, shaped))

    def _light(self, frame: Frame, exposure_s: float) -> Float32Array:
        """(n, 3) or (n, 1) radiance."""
        radiance = frame.radiance(exposure_s, self._config.exposure.blur_rays)
        if self._config.kind == "color":
            return radiance
        grey = radiance.mean(axis=1, dtype=np.float32)
        if self._projector is not None:
            grey += frame.projected(self._projector, self._T_base_projector)
        return np.ascontiguousarray(grey[:, None])


class DepthImager:
    """Depth in millimetres along the optical axis; 0 where there is none. The errors of a frame
    depend on its number alone. aligned: what sees the same from another imager."""

    def __init__(
        self, entry: CameraSettings, name: str, seed: int, aligned: Align | None = None
    ) -> None:
        self._config, self._aligned = entry.imagers[name], aligned
        self._camera, self._errors = self._config.lens.model(), DepthModel.of(self._config.depth)
        self._seed, self._name = seed, (entry.name, name)
        self._pack = packer(self._config)

    def image(self, frame: Frame, submit: Submit) -> Image:
        """The frame's depth, and the same in another imager's pixels."""
        is_exact = self._config.depth.is_exact
        depths_mm = self._exact(frame.sight) if is_exact else self._measured(frame)
        image = Image(0.0, 1.0, submit(self._pack, depths_mm))
        if self._aligned is not None:
            aligned = self._aligned
            image.aligned = submit(lambda: self._pack(aligned(depths_mm)))
        return image

    def _exact(self, sight: Sight) -> NDArray[np.uint16]:
        limits, depths_m = self._config.depth, sight.depths_m
        inside = (depths_m >= limits.depth_min_m) & (depths_m <= limits.depth_max_m)
        depths_mm = np.rint(np.float32(1e3) * np.where(inside, depths_m, np.float32(0.0)))
        return np.asarray(depths_mm, dtype=np.uint16).reshape(self._shape)

    def _measured(self, frame: Frame) -> NDArray[np.uint16]:
        shape, rng = self._shape, random_stream(self._seed, *self._name, "depth", str(frame.number))
        depths_m = frame.sight.depths_m.reshape(shape)
        scale = float(self._camera.focal_px[0]) * self._config.depth.baseline_m
        return self._errors.measured(
            depths_m,
            frame.sight.surface.cos_incidence.reshape(shape),
            frame.ir_reflectance.reshape(shape),
            hidden_from_right(depths_m, scale),
            self._camera,
            rng,
            frame.roughness.reshape(shape),
        )

    @property
    def _shape(self) -> tuple[int, int]:
        return self._camera.height, self._camera.width


def hidden_from_right(depths_m: Float32Array, scale: float) -> BoolArray:
    """(h, w) what a camera to the right does not see of (h, w) depths of a rectified pair.

    scale: focal length times baseline, m px. Something farther right in the image that would lie
    farther left in the other one is before it. What the left camera does not see hides nothing.
    """
    hidden = np.zeros(depths_m.shape, dtype=np.bool_)
    _hide(depths_m, scale, hidden)
    return hidden


@kernel
def _hide(depths_m: Float32Array, scale: float, hidden: BoolArray) -> None:
    for row in range(depths_m.shape[0]):
        leftmost = np.inf
        for column in range(depths_m.shape[1] - 1, -1, -1):
            place = column - scale / depths_m[row, column]
            hidden[row, column] = place > leftmost
            leftmost = min(leftmost, place)
