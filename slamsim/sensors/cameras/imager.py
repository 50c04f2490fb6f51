"""One imager: from one instant of a view to images of its kind, packed in threads beside."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.auto_exposure import AutoExposure
from slamsim.cameras.depth_model import DepthModel
from slamsim.cameras.dots import DotPattern
from slamsim.cameras.poses import RowPoses
from slamsim.cameras.response import ImageSensor
from slamsim.cameras.settings import ImagerConfig, ProjectorConfig
from slamsim.core.jit import kernel
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.sensors.cameras.sight import Sight, View

if TYPE_CHECKING:
    from slamsim.cameras.appearance import Appearance
    from slamsim.sensors.cameras.entry import CameraSettings
    from slamsim.sensors.motion import Motion


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


Pixels = NDArray[Any]

_RAW = {"color": "rgb8", "grey": "mono8", "infrared": "mono8", "depth": "16UC1"}
_MESSAGE, _PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def raw_encoding(config: ImagerConfig) -> str:
    """Of the pixels, as sensor_msgs/image_encodings names it."""
    return _RAW[config.kind]


def image_topic(config: ImagerConfig, at: str) -> tuple[str, str]:
    """(topic, type) of the images below a topic, as image_transport names them."""
    if config.encoding == "raw":
        return f"{at}/image_raw", _MESSAGE
    return f"{at}/image_raw/{'compressedDepth' if config.is_depth else 'compressed'}", _PACKED


def told_format(config: ImagerConfig) -> str:
    """What a CompressedImage says of itself, as ROS' image transports write it."""
    encoding = raw_encoding(config)
    if config.is_depth:
        return f"{encoding}; compressedDepth {config.encoding}"
    inside = "bgr8" if config.kind == "color" else "mono8"
    return f"{encoding}; {config.encoding} compressed {inside}"


def packer(config: ImagerConfig) -> Callable[[Pixels], bytes]:
    """What makes the data of a message of (h, w) or (h, w, 3) pixels; safe in any thread."""
    if config.encoding == "raw":
        return lambda pixels: np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")).tobytes()
    if config.is_depth:
        from slamsim.cameras.codecs.depth import encode_compressed_depth

        codec: Any = config.encoding
        return lambda pixels: encode_compressed_depth(pixels, codec)[1]
    from slamsim.cameras.codecs.pictures import encode_jpeg, encode_png

    if config.encoding == "png":
        return encode_png
    return lambda pixels: encode_jpeg(pixels, config.jpeg_quality)
