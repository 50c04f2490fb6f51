"""Changes of images, as faults and repairs make them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


class PixelChange(ABC):
    """A change of all images of a topic."""

    @abstractmethod
    def of_pixels(self, pixels: NDArray[Any], number: int) -> NDArray[Any]:
        """(h, w) or (h, w, c) pixels in the place of these, of the same dtype; number: which image
        of its topic it is."""

    def of_values(self, values: NDArray[Any]) -> NDArray[Any]:
        """What the change makes of (..., h, w) depths in metres, or of (..., 3) mean colours."""
        return values


@dataclass(frozen=True, slots=True)
class ScaleDepths(PixelChange):
    """All depths times a factor; integers are rounded, and what does not fit becomes none."""

    factor: float

    def of_pixels(self, pixels: NDArray[Any], number: int) -> NDArray[Any]:
        scaled = pixels * self.factor
        if pixels.dtype.kind == "f":
            return np.asarray(scaled, pixels.dtype)
        rounded = np.rint(scaled)
        there = rounded <= np.iinfo(pixels.dtype).max
        return np.asarray(np.where(there, rounded, 0), pixels.dtype)

    def of_values(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(values * self.factor, values.dtype)


@dataclass(frozen=True, slots=True)
class SwapRedBlue(PixelChange):
    """Red and blue exchanged; grey images have neither."""

    def of_pixels(self, pixels: NDArray[Any], number: int) -> NDArray[Any]:
        if pixels.ndim == 2 or pixels.shape[2] < 3:
            return pixels
        return np.ascontiguousarray(pixels[:, :, [2, 1, 0, *range(3, pixels.shape[2])]])

    def of_values(self, values: NDArray[Any]) -> NDArray[Any]:
        return values[..., ::-1]


@dataclass(frozen=True, slots=True)
class Flicker(PixelChange):
    """Brightness that swings by ``depth`` of itself, a third of a period from image to image: mains
    light of 100 Hz at 30 images a second."""

    depth: float

    def of_pixels(self, pixels: NDArray[Any], number: int) -> NDArray[Any]:
        light = 1.0 + self.depth * np.sin(2.0 * np.pi * number / 3.0)
        most = np.iinfo(pixels.dtype).max
        return np.asarray(np.clip(np.rint(pixels * light), 0, most), pixels.dtype)


@dataclass(frozen=True, slots=True)
class CutShort:
    """Images with these numbers keep this share of their bytes alone, packed or not."""

    numbers: frozenset[int]
    kept: float

    def of_data(self, data: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
        """(n,) bytes of the image with this number; as many come back, or fewer."""
        return data[: int(self.kept * data.size)] if number in self.numbers else data
