"""Draws a world from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import FloatArray
from slamsim.world.model import World

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

# Blue, green, red, as OpenCV has it.
_WALL: Colour = (52, 44, 40)
_LOW: Colour = (120, 168, 214)
_FREE: Colour = (255, 255, 255)
_OUT_OF_REACH: Colour = (226, 224, 222)
_SLIPPERY: Colour = (235, 190, 120)
_GRIPPY: Colour = (150, 200, 160)
_START: Colour = (40, 40, 210)
_VISIT: Colour = (205, 190, 170)
_INK: Colour = (60, 60, 60)

_LONGEST_PX = 1200
_MARGIN_PX = 48
_LIDAR_HEIGHT_M = 0.3
"""About that of the bundled robots: what stands there is drawn as a wall."""


def preview_png(world: World) -> bytes:
    """The world as a PNG, y up, with title and scale; see ``top_view``."""
    x_min, y_min, x_max, y_max = world.bounds_m
    resolution = max(x_max - x_min, y_max - y_min) / _LONGEST_PX
    return encoded_png(_framed(top_view(world, _LONGEST_PX), world, resolution))


def top_view(
    world: World, longest_px: int, ways: Sequence[Way] = (), longest_m: float | None = None
) -> Image:
    """(rows, columns, 3) blue, green, red; y up; the longer side so many pixels, or ``longest_m``
    would be, for worlds on one scale.

    Dark: solid at 0.3 m, where a lidar looks. Sand: between 0.01 m and 0.5 m only above or below
    that height. White: free; grey: free but out of reach. Blue and green: floor patches with less
    and more friction than the floor. Dots: places to visit. Red: the start and its heading. ways:
    lines over it, each drawn over those before.
    """
    x_min, y_min, x_max, y_max = world.bounds_m
    resolution = (longest_m or max(x_max - x_min, y_max - y_min)) / longest_px
    grid = world.grid(resolution, _LIDAR_HEIGHT_M)
    body = world.obstacle_grid(resolution).occupancy
    image = np.full((*grid.occupancy.shape, 3), _FREE, dtype=np.uint8)
    view = _View(image, grid.origin_m, resolution)
    for patch in world.floor_patches:
        colour = _SLIPPERY if patch.friction < world.floor_friction else _GRIPPY
        corners = np.array([[patch.x_min_m, patch.y_min_m], [patch.x_max_m, patch.y_max_m]])
        view.rectangle(corners, colour)
    image[np.isnan(grid.occupancy)] = _OUT_OF_REACH
    image[body == 1.0] = _LOW
    image[grid.occupancy == 1.0] = _WALL
    for place in world.visit_points_m:
        view.disc(place, 0.06, _VISIT)
    for way in ways:
        view.line(way)
    view.arrow(world.start_pose, 0.5 * world.clearance_m, _START)
    return image[::-1]


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A line (n, 2) in the map frame; colour: blue, green, red."""

    points_m: FloatArray
    colour: Colour
    width_px: int = 1


class _View:
    """Drawing on an image whose first row is the lowest y, in metres of the map frame."""

    def __init__(self, image: Image, origin_m: tuple[float, float], resolution_m: float) -> None:
        self._image, self._origin, self._resolution = image, np.array(origin_m), resolution_m

    def _pixel(self, point_m: FloatArray) -> tuple[int, int]:
        x, y = np.round((point_m - self._origin) / self._resolution - 0.5).astype(int).tolist()
        return x, y

    def _length(self, length_m: float) -> int:
        return max(round(length_m / self._resolution), 2)

    def rectangle(self, corners_m: FloatArray, colour: Colour) -> None:
        cv2.rectangle(self._image, self._pixel(corners_m[0]), self._pixel(corners_m[1]), colour, -1)

    def disc(self, middle_m: FloatArray, radius_m: float, colour: Colour) -> None:
        middle, radius = self._pixel(middle_m), self._length(radius_m)
        cv2.circle(self._image, middle, radius, colour, -1, cv2.LINE_AA)

    def line(self, way: Way) -> None:
        pixels = np.array([self._pixel(point) for point in way.points_m], dtype=np.int32)
        cv2.polylines(self._image, [pixels[:, None]], False, way.colour, way.width_px, cv2.LINE_AA)

    def arrow(self, pose: FloatArray, length_m: float, colour: Colour) -> None:
        """A disc at the pose and a line from it ahead, together as long as two lengths."""
        ahead = pose[:2] + 2.0 * length_m * np.array([np.cos(pose[2]), np.sin(pose[2])])
        self.disc(pose[:2], 0.5 * length_m, colour)
        thickness = self._length(0.25 * length_m)
        cv2.arrowedLine(
            self._image, self._pixel(pose[:2]), self._pixel(ahead), colour, thickness, cv2.LINE_AA
        )


def _framed(image: NDArray[Any], world: World, resolution_m: float) -> Image:
    """The picture with a margin, a title above it and a scale bar below."""
    rows, columns = image.shape[:2]
    framed = np.full((rows + 2 * _MARGIN_PX, columns + 2 * _MARGIN_PX, 3), _FREE, dtype=np.uint8)
    framed[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX] = image
    x_min, y_min, x_max, y_max = world.bounds_m
    title = f"{world.name}   {x_max - x_min:.1f} x {y_max - y_min:.1f} m   seed {world.seed}"
    write_text(framed, title, (_MARGIN_PX, _MARGIN_PX - 16))
    bar_m = _round_length(0.25 * image.shape[1] * resolution_m)
    y, end = framed.shape[0] - _MARGIN_PX // 2, _MARGIN_PX + round(bar_m / resolution_m)
    cv2.line(framed, (_MARGIN_PX, y), (end, y), _INK, 2)
    for x in (_MARGIN_PX, end):
        cv2.line(framed, (x, y - 5), (x, y + 5), _INK, 2)
    write_text(framed, f"{bar_m:g} m", (end + 12, y + 6))
    return framed


def write_text(image: NDArray[Any], text: str, place: tuple[int, int], scale: float = 0.6) -> None:
    """Dark letters whose base line begins so many columns right and rows down. image: (h, w, 3)."""
    printable = text.encode("ascii", "replace").decode()
    cv2.putText(image, printable, place, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)


def _round_length(length_m: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length_m))


def encoded_png(image: Image) -> bytes:
    """The picture as PNG. Raises RuntimeError if OpenCV cannot encode it."""
    done, data = cv2.imencode(".png", image)
    if not done:
        raise RuntimeError("OpenCV could not encode the preview as PNG")
    return data.tobytes()
