"""From light to grey values, after EMVA Standard 1288 (release 4.0, section 2).

Electrons are freed in proportion to radiance and exposure; their number varies by its root, and
reading adds noise. What a full pixel holds is, at gain one, the converter's largest value.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.cameras.settings import SensorConfig
from slamsim.core.jit import kernel
from slamsim.core.types import Float32Array


class ImageSensor:
    """The sensor behind a lens; the same light, exposure and random numbers give the same bytes."""

    def __init__(self, config: SensorConfig, lens: CameraModel) -> None:
        self._config, self._lens = config, lens
        self._most = (1 << config.adc_bits) - 1
        self._values = response_curve(config)

    def exposed(
        self, radiance: Float32Array, exposure_s: float, gain: float, rng: np.random.Generator
    ) -> tuple[NDArray[np.uint8], float]:
        """(h * w, channels) values of (h * w, channels) light, and their mean before the response
        curve as a share of the largest, which is what automatic exposure measures."""
        config = self._config
        is_mosaic = config.bayer and radiance.shape[1] == 3
        if is_mosaic:
            radiance = self._mosaic(radiance)
        noise = rng.standard_normal(radiance.shape, dtype=np.float32)
        counts = np.empty(radiance.shape, dtype=np.uint16)
        electrons, shot = exposure_s * config.electrons_per_s, 1.0 if config.shot_noise else 0.0
        arrays = radiance, self._shading, noise, counts
        total = _converted(
            *arrays, electrons, shot, config.read_noise_e, config.full_well_e, gain, self._most
        )
        mean = total / (counts.size * self._most)
        if is_mosaic:
            counts = self._interpolated(counts)
        return self._values[counts], mean

    @cached_property
    def _shading(self) -> Float32Array:
        """(h * w,) share of the light that the lens lets through."""
        lens = self._lens
        x, y = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
        across = np.array([lens.width, lens.height]) - 1.0
        squares = (x - 0.5 * across[0]) ** 2 + (y - 0.5 * across[1]) ** 2
        most = max(float(squares.max()), 1.0)
        return np.asarray(1.0 - self._config.vignetting * squares / most, np.float32).ravel()

    @cached_property
    def _channels(self) -> NDArray[np.int64]:
        """(h * w,) which colour each pixel of the mosaic lets through: RGGB."""
        rows, columns = np.indices((self._lens.height, self._lens.width))
        return np.asarray(rows % 2 + columns % 2, dtype=np.int64).ravel()

    def _mosaic(self, radiance: Float32Array) -> Float32Array:
        chosen = radiance[np.arange(len(radiance)), self._channels]
        return np.ascontiguousarray(chosen[:, None])

    def _interpolated(self, counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
        import cv2

        mosaic = counts.reshape(self._lens.height, self._lens.width)
        # OpenCV names a mosaic by its second row: RGGB is its BG.
        return np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB), np.uint16).reshape(-1, 3)


def response_curve(config: SensorConfig) -> NDArray[np.uint8]:
    """(2 ** adc_bits,) the 8-bit value of each value of the converter."""
    share = np.linspace(0.0, 1.0, 1 << config.adc_bits)
    if config.response == "srgb":  # IEC 61966-2-1
        bent = 1.055 * share ** (1.0 / 2.4) - 0.055
        share = np.where(share <= 0.0031308, 12.92 * share, bent)
    return np.rint(255.0 * share).astype(np.uint8)


@kernel
def _converted(
    radiance: Float32Array,
    shading: Float32Array,
    noise: Float32Array,
    counts: NDArray[np.uint16],
    electrons: float,
    shot: float,
    read_noise_e: float,
    full_well_e: float,
    gain: float,
    most: int,
) -> int:
    """Fill the (n, k) values of the converter; returns their sum."""
    per_electron = gain * most / full_well_e
    total = 0
    for pixel in range(radiance.shape[0]):
        for channel in range(radiance.shape[1]):
            signal = radiance[pixel, channel] * shading[pixel] * electrons
            # A normal distribution stands for Poisson's: below ten electrons reading noise rules.
            spread = np.sqrt(shot * signal + read_noise_e * read_noise_e)
            read = min(signal + spread * noise[pixel, channel], full_well_e)
            value = min(max(int(np.rint(read * per_electron)), 0), most)
            counts[pixel, channel] = value
            total += value
    return total
