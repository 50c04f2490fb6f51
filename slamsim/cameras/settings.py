"""What an image of a camera is: its lens, shutter, exposure, sensor and encoding.

A camera has one or more imagers. Light is counted in units of the radiance of a white matt surface
in light of strength one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from slamsim.cameras.depth_settings import DepthNoiseConfig
from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.config.base import Config

ImagerKind = Literal["color", "grey", "infrared", "depth"]
Truth = Literal["depth", "normals", "instances", "materials", "flow"]
Pair = Annotated[tuple[float, float], Field(strict=False)]


class OffsetConfig(Config):
    """A place in the camera's frame (x forward, y left, z up); turned about fixed x, y, then z."""

    x_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """Forward."""
    y_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """To the left."""
    z_m: float = Field(default=0.0, ge=-2.0, le=2.0)
    """Up."""
    roll_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About x: the left side rises."""
    pitch_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About y: the front sinks."""
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """About z: counter-clockwise seen from above."""


class LensConfig(Config):
    """Size of the image, camera matrix and distortion, as sensor_msgs/CameraInfo has them."""

    width: int = Field(default=640, ge=1, le=8192)
    """Columns of an image."""
    height: int = Field(default=480, ge=1, le=8192)
    """Rows of an image."""
    horizontal_fov_deg: float = Field(default=69.0, gt=1.0, lt=350.0)
    """Angle between the outer edges of the left and the right column, without distortion; below
    180 but for ``equidistant``."""
    focal_px: Pair | None = None
    """Focal lengths along x and y, in pixels; without them that of ``horizontal_fov_deg``."""
    centre_px: Pair | None = None
    """Principal point, in pixels; without it the middle. (0, 0) is the middle of the first
    pixel."""
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    """Brown-Conrady with five or eight coefficients, or Kannala-Brandt for fisheyes."""
    distortion: Annotated[tuple[float, ...], Field(strict=False, max_length=8)] = ()
    """Coefficients in the order of CameraInfo's ``d``; those left out are zero."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.distortion_model != "equidistant" and self.horizontal_fov_deg >= 180.0:
            raise ValueError("only an 'equidistant' lens has a horizontal_fov_deg beyond 180")
        if _folds(self):
            raise ValueError(f"the distortion {list(self.distortion)} folds inside the image")
        return self

    def model(self) -> CameraModel:
        """The camera that these settings describe. Raises BadNumbers as CameraModel does."""
        given = np.array(self.distortion, dtype=np.float64)
        plain = pinhole(
            *(self.width, self.height, self.horizontal_fov_deg, self.distortion_model, given)
        )
        K = plain.K.copy()
        if self.focal_px is not None:
            K[[0, 1], [0, 1]] = self.focal_px
        if self.centre_px is not None:
            K[:2, 2] = self.centre_px
        return CameraModel(self.width, self.height, K, self.distortion_model, given)


@lru_cache(maxsize=256)
def _folds(lens: LensConfig) -> bool:
    """Asked once of each lens: a recipe with four imagers is validated 42 times while it is loaded,
    and 9 of 10 s went into the same answers."""
    return lens.model().folds()


class ExposureConfig(Config):
    """How long light is collected, and by how much the signal is amplified."""

    exposure_s: float = Field(default=0.008, ge=1e-6, le=1.0)
    """Exposure of the first image, and of all where ``auto`` is off."""
    gain: float = Field(default=1.0, ge=1.0, le=256.0)
    """Amplification of the first image, and of all where ``auto`` is off."""
    auto: bool = True
    """Whether exposure and gain follow the light: each image is measured and changes the next."""
    target: float = Field(default=0.2, gt=0.0, lt=1.0)
    """Mean signal that is aimed at, as a share of the largest."""
    lag_s: float = Field(default=0.3, ge=0.0, le=60.0)
    """Time in which all but 37 % of a difference in light is made good; 0 for at once."""
    exposure_min_s: float = Field(default=1e-4, ge=1e-6, le=1.0)
    """Shortest automatic exposure."""
    exposure_max_s: float = Field(default=0.02, ge=1e-6, le=1.0)
    """Longest automatic exposure; darker scenes are amplified."""
    gain_max: float = Field(default=16.0, ge=1.0, le=256.0)
    """Largest automatic amplification."""
    blur_rays: int = Field(default=1, ge=1, le=63)
    """Instants of the exposure at which each pixel looks; an odd number, 1 for no motion blur. The
    time to render grows with it."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.blur_rays % 2 == 0:
            raise ValueError(f"blur_rays {self.blur_rays} must be odd: one is at the middle")
        if self.exposure_min_s > self.exposure_max_s:
            raise ValueError(
                f"exposure_min_s {self.exposure_min_s} is beyond exposure_max_s "
                f"{self.exposure_max_s}"
            )
        return self

    @property
    def longest_s(self) -> float:
        """The longest exposure of any image."""
        return max(self.exposure_s, self.exposure_max_s) if self.auto else self.exposure_s


class SensorConfig(Config):
    """The image sensor, after EMVA Standard 1288: electrons in, grey values out."""

    electrons_per_s: float = Field(default=1.0e6, gt=0.0, le=1e12)
    """Electrons a second that light of radiance one frees in a pixel on the axis."""
    full_well_e: float = Field(default=10_000.0, ge=10.0, le=1e7)
    """Electrons that a pixel holds; with gain one they give the largest value."""
    shot_noise: bool = True
    """Whether the number of electrons varies by its root, as light does."""
    read_noise_e: float = Field(default=3.0, ge=0.0, le=1000.0)
    """Standard deviation of reading a pixel, in electrons."""
    adc_bits: int = Field(default=10, ge=8, le=16)
    """Bits of the converter, before the response curve."""
    response: Literal["srgb", "linear"] = "srgb"
    """Curve from the converter's values to 8 bits: that of IEC 61966-2-1, or none."""
    vignetting: float = Field(default=0.2, ge=0.0, lt=1.0)
    """Share of the light that is missing in the corners, growing with the square of the distance
    from the middle."""
    bayer: bool = False
    """Whether a colour image is taken through a mosaic of filters (RGGB) and interpolated."""


class DepthConfig(DepthNoiseConfig):
    """What an imager of kind ``depth`` gives: by default with the errors of active stereo, whose
    right camera is ``baseline_m`` to the right."""

    is_exact: bool = False
    """Whether it is the true depth between ``depth_min_m`` and ``depth_max_m``, rounded to
    millimetres, and no other setting of errors counts."""
    aligned_to: str = ""
    """Name of an imager for whose pixels the depth is given as well, on the topic
    ``NAME/aligned_depth_to_IMAGER``; empty for none."""


class ProjectorConfig(Config):
    """An infrared projector of dots."""

    radiance: float = Field(default=8.0, gt=0.0, le=1e4)
    """Of the middle of a dot on a white surface, head-on at one metre."""
    offset: OffsetConfig = OffsetConfig()
    """Where it sits in the camera, looking along x."""


class ImagerConfig(Config):
    """One imager of a camera, with topics ``/NAME/IMAGER/...``."""

    enabled: bool = True
    """False leaves it out, as one of a preset that is not needed."""
    kind: ImagerKind = "color"
    """color: RGB. grey, infrared: one channel; infrared sees the projector's dots too. depth:
    millimetres along the optical axis."""
    lens: LensConfig = LensConfig()
    """The lens as it truly is."""
    claimed_lens: LensConfig | None = None
    """What CameraInfo says of the lens, where it is not the truth."""
    offset: OffsetConfig = OffsetConfig()
    """Where it truly sits in the camera, looking along x."""
    claimed_offset: OffsetConfig | None = None
    """Where the transform tree has it, where that is not the truth."""
    stereo_left: str = ""
    """Name of the imager to the left that this one is a pair with: the projection matrix of
    CameraInfo then holds the distance, as consumers of stereo want it. Empty for none."""
    readout_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """From the exposure of the first row to that of the last: a rolling shutter; 0 for a global
    one. Stamps are the middle of the exposure of the first row."""
    exposure: ExposureConfig = ExposureConfig()
    """Exposure and gain."""
    sensor: SensorConfig = SensorConfig()
    """Noise and response."""
    depth: DepthConfig = DepthConfig()
    """Of an imager of kind ``depth``."""
    encoding: Literal["jpeg", "png", "rvl", "raw"] = "jpeg"
    """jpeg, png: CompressedImage. raw: Image. Depths: png, rvl (compressedDepth) or raw."""
    jpeg_quality: int = Field(default=90, ge=1, le=100)
    """Quality of JPEG images, as libjpeg counts."""
    truth: Annotated[tuple[Truth, ...], Field(strict=False)] = ()
    """Which images of the truth are recorded with each image, on ``/ground_truth/NAME/IMAGER/...``:
    depth, normals, instances, materials, flow. Poses of rows, exposure and the true CameraInfo
    always are."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        allowed = ("png", "rvl", "raw") if self.kind == "depth" else ("jpeg", "png", "raw")
        if self.encoding not in allowed:
            raise ValueError(
                f"{self.encoding!r} is no encoding of {self.kind} images; "
                f"known are {', '.join(allowed)}"
            )
        if self.kind == "depth" and (self.lens.distortion or self.readout_s > 0.0):
            raise ValueError("images of depth are rectified and of one instant: without distortion")
        return self

    @property
    def is_depth(self) -> bool:
        return self.kind == "depth"
