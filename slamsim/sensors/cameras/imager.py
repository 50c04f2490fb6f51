"""One imager: from what a view sees to images of its kind, packed in threads beside."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.auto_exposure import AutoExposure
from slamsim.cameras.lens import CameraModel
from slamsim.cameras.response import ImageSensor
from slamsim.cameras.settings import ImagerConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import Float32Array
from slamsim.sensors.cameras.frame import Frame
from slamsim.sensors.cameras.packing import packer
from slamsim.sensors.cameras.sight import Sight

Submit = Callable[..., "Future[bytes]"]


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

    def __init__(
        self, config: ImagerConfig, camera: CameraModel, rate_hz: float, seed: int, *name: str
    ) -> None:
        self._config, self._camera = config, camera
        self._seed, self._name = seed, name
        self._sensor = ImageSensor(config.sensor, camera)
        self._auto = AutoExposure(config.exposure, rate_hz)
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
        if self._config.kind == "infrared" and self._config.projector > 0.0:
            grey += self._projected(frame)
        return np.ascontiguousarray(grey[:, None])

    def _projected(self, frame: Frame) -> Float32Array:
        """(n,) radiance of the projector's light, which sits beside the lens."""
        sight = frame.sight
        squares = np.maximum(np.square(sight.ranges_m), np.float32(1e-4))
        strength = frame.ir_reflectance * sight.surface.cos_incidence
        return np.asarray(np.float32(self._config.projector) * strength / squares, np.float32)


class DepthImager:
    """Depth in millimetres along the optical axis; 0 where there is none."""

    def __init__(
        self, config: ImagerConfig, camera: CameraModel, aligned: Callable[..., Any] | None
    ) -> None:
        self._config, self._camera, self._aligned = config, camera, aligned
        self._pack = packer(config)

    def image(self, frame: Frame, submit: Submit) -> Image:
        """The frame's depth, and the same in another imager's pixels."""
        depths_mm = self._measured(frame.sight)
        image = Image(0.0, 1.0, submit(self._pack, depths_mm))
        if self._aligned is not None:
            aligned = self._aligned
            image.aligned = submit(lambda: self._pack(aligned(depths_mm)))
        return image

    def _measured(self, sight: Sight) -> NDArray[np.uint16]:
        limits, depths_m = self._config.depth, sight.depths_m
        inside = (depths_m >= limits.min_m) & (depths_m <= limits.max_m)
        depths_mm = np.rint(np.float32(1e3) * np.where(inside, depths_m, np.float32(0.0)))
        shape = (self._camera.height, self._camera.width)
        return np.asarray(depths_mm, dtype=np.uint16).reshape(shape)
