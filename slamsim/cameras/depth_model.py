"""What a stereo depth camera such as a RealSense D435 measures of a true depth image.

In the order of the physics: what either camera does not see, or lights too little, has no match;
what is near grows over its edges by the matching window; disparities are noisy, alike within a
window, told in steps, and searched up to a largest one; the module may be bent (Redwood's table).
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.depth_settings import DepthNoiseConfig
from slamsim.cameras.lens import CameraModel
from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.guard.numbers import BadNumbers, require_array

_EDGE_PX = 1.0
"""A step of disparity from which on a window sees two surfaces."""
_MOST_NOISE = 3.0
"""Times the noise of a well lit wall: where there is less light, there is no match."""
_SPREAD = 0.3
"""Of the least signal: how much it differs between neighbouring windows."""
_DAZZLED_COSINE = 0.98
"""From here to the normal, 11 degrees, a mirror throws the projector's light into the camera."""
_TABLE_SHAPE = (80, 400)


@dataclass(frozen=True, slots=True, eq=False)
class DepthModel:
    """A depth camera with these errors. table: (80, 80, 5) of Redwood, None for none."""

    settings: DepthNoiseConfig
    table: Float32Array | None = None

    @classmethod
    def of(cls, settings: DepthNoiseConfig) -> DepthModel:
        """With the table that the settings name; raises NotFound, or InputRefused for none."""
        path = settings.distortion_table
        return cls(settings, None if path is None else load_redwood_table(path))

    def depth_min_m(self, camera: CameraModel) -> float:
        """The least depth: where the search for disparity ends, or as it is set."""
        nearest_m = camera.focal_px[0] * self.settings.baseline_m / self.settings.most_disparity_px
        return max(float(nearest_m), self.settings.depth_min_m)

    def sigma_m(self, depth_m: float, camera: CameraModel) -> float:
        """Standard deviation of the depth of a well lit wall, by the first derivative."""
        scale = camera.focal_px[0] * self.settings.baseline_m
        return float(depth_m**2 * self.settings.disparity_noise_px / scale)

    def measured(
        self,
        depth_m: Float32Array,
        cos_incidence: Float32Array,
        ir_reflectance: Float32Array,
        occluded_right: BoolArray,
        camera: CameraModel,
        frame_rng: np.random.Generator,
        roughness: Float32Array | None = None,
    ) -> NDArray[np.uint16]:
        """(h, w) millimetres as the camera publishes them, 0 for none.

        depth_m: (h, w) true depth along the optical axis of the left camera, what is not finite
        and positive is nothing. cos_incidence: (h, w) 1 head-on. ir_reflectance: (h, w) 0 to 1.
        occluded_right: (h, w) what the right camera does not see. roughness: (h, w) 0 mirror to 1
        matt. frame_rng: of this frame alone. Pixels whose place in the right image is beyond
        its left edge have no depth, as in the camera. Raises BadNumbers for images of another size.
        """
        size = camera.height, camera.width
        for name, image in (("depth", depth_m), ("cosine", cos_incidence)):
            require_array(f"the {name} of pixels", image, size)
        if ir_reflectance.shape != size or occluded_right.shape != size:
            raise BadNumbers(f"reflectance and occlusion are of {size} pixels, as the camera is")
        of_noise, of_signal = frame_rng.spawn(2)
        signal = self._signal(cos_incidence, ir_reflectance, roughness)
        is_lit = signal >= self._needed_signal(size, of_signal)
        scale = float(camera.focal_px[0]) * self.settings.baseline_m
        true, has_place = _disparities(depth_m, scale)
        grown = self._grown(true, is_lit & ~occluded_right & has_place, occluded_right & has_place)
        gain = np.sqrt(np.maximum(self.settings.signal_full / np.maximum(signal, 1e-6), 1.0))
        noise = correlated_noise(size, self.settings.window_px, of_noise)
        noise *= np.float32(self.settings.disparity_noise_px) * np.minimum(gain, _MOST_NOISE)
        return self._told(grown, noise, scale, self.depth_min_m(camera))

    def _signal(
        self,
        cos_incidence: Float32Array,
        ir_reflectance: Float32Array,
        roughness: Float32Array | None,
    ) -> Float32Array:
        """How much of the projector's light comes back, 1 from a white wall seen head-on."""
        signal = cos_incidence * ir_reflectance
        if roughness is None or self.settings.shiny_below_roughness == 0.0:
            return signal
        diffuse = np.minimum(roughness / self.settings.shiny_below_roughness, 1.0)
        is_dazzling = (diffuse < 1.0) & (cos_incidence > _DAZZLED_COSINE)
        return np.where(is_dazzling, 0.0, signal * diffuse).astype(np.float32)

    def _needed_signal(
        self, size: tuple[int, int], of_signal: np.random.Generator
    ) -> Float32Array | float:
        least = self.settings.signal_least
        if least == 0.0:
            return 0.0
        between = _SPREAD * correlated_noise(size, self.settings.window_px, of_signal)
        return np.asarray(least * np.maximum(1.0 + between, _SPREAD), np.float32)

    def _grown(self, true: Float32Array, matched: BoolArray, hidden: BoolArray) -> Float32Array:
        """The disparities that are found, 0 for none: what is near grows over its edges, where
        there is a match behind it or what only one camera sees."""
        found = np.where(matched, true, np.float32(0.0))
        reach = self.settings.fattening_px
        if reach == 0:
            return found
        square = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
        nearest = np.asarray(cv2.dilate(found, square), np.float32)
        is_edge = (nearest > true + _EDGE_PX) & (matched | hidden)
        return np.where(is_edge, nearest, found)

    def _told(
        self, disparities: Float32Array, noise: Float32Array, scale: float, nearest_m: float
    ) -> NDArray[np.uint16]:
        settings = self.settings
        table = np.ones((1, 1, 1), np.float32) if self.table is None else self.table
        return _depths_mm(
            disparities,
            noise,
            scale,
            settings.disparity_step_px,
            1e3 * nearest_m,
            1e3 * settings.depth_max_m,
            table,
        )


def correlated_noise(
    size: tuple[int, int], window_px: int, rng: np.random.Generator
) -> Float32Array:
    """(h, w) normal numbers of mean 0 and variance 1, those within a square window correlated: the
    mean of the window about each, of white noise that reaches beyond the image."""
    height, width = size
    padded = (height + window_px - 1, width + window_px - 1)
    white = rng.standard_normal(padded, dtype=np.float32)
    if window_px == 1:
        return white
    mean = cv2.boxFilter(white, -1, (window_px, window_px), normalize=False)
    begin = window_px // 2
    inside = mean[begin : begin + height, begin : begin + width]
    return np.asarray(inside * np.float32(1.0 / window_px), np.float32)


def load_redwood_table(path: Path) -> Float32Array:
    """(80, 80, 5) by row, column and depth (1, 3, 5, 7, 9 m): what true depth is divided by.

    Raises NotFound, or InputRefused for anything but 80 x 400 finite numbers.
    """
    data = read_input(path, "image_file_bytes")
    try:
        found = np.load(BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputRefused(path, f"is no .npy file of numbers ({error})") from None
    is_table = isinstance(found, np.ndarray) and found.shape == _TABLE_SHAPE
    if not is_table or found.dtype.kind != "f" or not np.isfinite(found).all():
        shape = getattr(found, "shape", "?")
        raise InputRefused(path, f"a table of 80 x 400 finite numbers is needed, not {shape}")
    return np.ascontiguousarray(found.reshape(80, 80, 5), np.float32)


def _disparities(depth_m: Float32Array, scale: float) -> tuple[Float32Array, BoolArray]:
    """(h, w) pixels, 0 for nothing, and which have a place in the right image."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = np.float32(scale) / depth_m
    found = np.where(np.isfinite(found) & (found > 0.0), found, np.float32(0.0))
    columns = np.arange(depth_m.shape[1], dtype=np.float32)
    return found, (found > 0.0) & (found <= columns[None, :])


@kernel
def _factor(table: NDArray[np.float32], row: float, column: float, depth_m: float) -> float:
    """Redwood's factor at a place of the image (0 to 1 from above and from the left)."""
    y, x = int(row * table.shape[0]), int(column * table.shape[1])
    last = table.shape[2] - 1
    upper = int((depth_m + 1.0) / 2.0)
    lower = upper - 1
    share = (depth_m - (2.0 * lower + 1.0)) / 2.0
    low, high = min(max(lower, 0), last), min(upper, last)
    return (1.0 - share) * float(table[y, x, low]) + share * float(table[y, x, high])


@kernel
def _depths_mm(
    disparities: NDArray[np.float32],
    noise: NDArray[np.float32],
    scale: float,
    step: float,
    nearest_mm: float,
    farthest_mm: float,
    table: NDArray[np.float32],
) -> NDArray[np.uint16]:
    """(h, w) millimetres of noisy disparities, 0 for none; a table of one number bends nothing."""
    height, width = disparities.shape
    depths = np.zeros((height, width), dtype=np.uint16)
    is_bent = table.size > 1
    for row in range(height):
        for column in range(width):
            found = float(disparities[row, column])
            if found <= 0.0:
                continue
            found += noise[row, column]
            if step > 0.0:
                found = np.rint(found / step) * step
            if found <= 0.0:
                continue
            depth_mm = 1e3 * scale / found
            if is_bent:
                place = (row + 0.5) / height, (column + 0.5) / width
                factor = _factor(table, place[0], place[1], 1e-3 * depth_mm)
                depth_mm = depth_mm / factor if factor > 1e-5 else 0.0
            depth_mm = np.rint(depth_mm)
            if depth_mm >= max(nearest_mm, 1.0) and depth_mm <= min(farthest_mm, 65535.0):
                depths[row, column] = int(depth_mm)
    return depths
