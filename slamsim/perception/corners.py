"""Corners of a key frame whose depth is known, and where they are in later images.

Corners (Shi & Tomasi 1994) are followed by Lucas and Kanade's pyramids, there and back.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.perception.twist import at_first_row

CORNERS = 600
CORNER_SPACING_PX = 8.0
CORNER_QUALITY = 0.005
WINDOW_PX = 15
LEVELS = 3
"""Of the pyramid: motions of some 60 pixels from image to image are followed."""
BACK_WITHIN_PX = 0.5
FLAT_WITHIN = 0.03
"""A point counts only where depths around it differ by less than this share: at edges, depth and
corner belong to different surfaces."""

NOISE_GREY = 10.0
"""Of a pixel: noise, and what JPEG leaves."""
GOOD_PX = 0.1
"""Standard deviation of where a corner is found again, over which that of weak ones grows by noise
over gradients (Foerstner & Guelch 1987). They are drawn to the blocks of JPEG, which stay where
they are: taken for good ones, they make a path 0.8 % too short."""
BEYOND_NOISE = 2.0 * 0.19 * WINDOW_PX**2
"""Twice the squared gradients that noise alone has in a window: Sobel's weights leave 0.19 of its
variance."""
EIGENVALUE_TO_GREY = 4.0 * WINDOW_PX * 255.0 / 8.0
"""OpenCV divides sums of Sobel's gradients, each eight times a grey level a pixel, by this."""

Grey = NDArray[np.uint8]
Pixels = NDArray[np.float32]


class Keyframe:
    """An image with the points in it whose depth is known.

    T_odom_camera: (4, 4). own: (6, 6) covariance of this pose as ``FittedMotion``'s, relative to
    the points that it was placed by. pixels: (n, 2), points_m: (n, 3) in its camera; followed:
    which of them are still seen, and last_px where.
    """

    def __init__(self, number: int, T_odom_camera: FloatArray, own: FloatArray, grey: Grey) -> None:
        self.number, self.T_odom_camera, self.own, self.grey = number, T_odom_camera, own, grey
        self.pixels: Pixels = np.zeros((0, 2), dtype=np.float32)
        self.points_m = np.zeros((0, 3))
        self.vague = np.zeros(0)
        self.last_px = self.pixels
        self.followed: IntArray = np.zeros(0, dtype=np.int64)

    def mark(
        self, model: CameraModel, depth_m: Float32Array, taken_px: Pixels, swept: FloatArray
    ) -> None:
        """Find corners to be followed, apart from those (m, 2) that already are.

        swept: (6,) how points move in the camera while the image is read out.
        """
        free = np.full(self.grey.shape, 255, dtype=np.uint8)
        for x, y in np.rint(taken_px).astype(np.int64).tolist():
            cv2.circle(free, (x, y), int(CORNER_SPACING_PX), 0, -1)
        most = CORNERS - len(taken_px)
        if most <= 0:
            return
        found = cv2.goodFeaturesToTrack(
            self.grey, most, CORNER_QUALITY, CORNER_SPACING_PX, mask=free, blockSize=5
        )
        if found is None:
            return
        pixels = np.asarray(found, dtype=np.float32).reshape(-1, 2)
        depths_m = depths_at(depth_m, pixels)
        rays_xy = rays_xy_at(model, pixels)
        squares = gradients_at(self.grey, pixels)
        known = np.isfinite(depths_m) & np.isfinite(rays_xy).all(axis=1)
        known &= squares > BEYOND_NOISE * noise_of(self.grey) ** 2
        rays = np.column_stack([rays_xy, np.ones(len(pixels))])
        self.pixels, late = pixels[known], late_of(model, pixels[known])
        self.points_m = at_first_row((rays * depths_m[:, None])[known], late, swept)
        self.vague = np.hypot(1.0, np.sqrt(2.0 / squares[known]) * NOISE_GREY / GOOD_PX)
        self.last_px, self.followed = self.pixels, np.arange(len(self.pixels))

    def follow(self, before: Grey, grey: Grey, model: CameraModel, T_now_odom: FloatArray) -> None:
        """Go on with the followed points that are found in grey, there and back; before: the image
        before it. T_now_odom: (4, 4) about where the camera is now."""
        if not len(self.followed):
            return
        T_now_keyframe = T_now_odom @ self.T_odom_camera
        there = self.points_m[self.followed] @ T_now_keyframe[:3, :3].T + T_now_keyframe[:3, 3]
        pixels, seen = model.project(there)
        seen &= model.contains(np.where(seen[:, None], pixels, -1.0))
        expected = np.where(seen[:, None], pixels, self.last_px).astype(np.float32)
        origin = self.pixels[self.followed]
        near, found = _track(before, grey, self.last_px, expected, LEVELS)
        now, again = _track(self.grey, grey, origin, near, 1)
        back, home = _track(grey, self.grey, now, origin, 1)
        close = np.linalg.norm(back - origin, axis=1) < BACK_WITHIN_PX
        self.last_px = now
        self.keep(np.flatnonzero(found & again & home & close))

    def keep(self, rows: IntArray) -> None:
        """Only these (k,) of the followed points go on."""
        self.followed, self.last_px = self.followed[rows], self.last_px[rows]


def late_of(model: CameraModel, pixels: Pixels) -> FloatArray:
    """(n,) which part of an image is read out before the rows of (n, 2) pixels."""
    return np.asarray(pixels[:, 1] / max(model.height - 1.0, 1.0), dtype=np.float64)


def gradients_at(grey: Grey, pixels: Pixels) -> FloatArray:
    """(n,) squared gradients summed over the window about (n, 2) corners, across their edges."""
    weakest = cv2.cornerMinEigenVal(grey, WINDOW_PX, ksize=3).astype(np.float64)
    column, row = np.rint(pixels).astype(np.int64).T
    return np.asarray(np.maximum(weakest[row, column] * EIGENVALUE_TO_GREY**2, 1e-6))


def noise_of(grey: Grey) -> float:
    """Standard deviation of a pixel's noise, by what is left of most of them after smooth changes
    (Immerkaer 1996, with the median)."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    left = np.abs(cv2.filter2D(grey, cv2.CV_32F, mask))
    return float(SIGMAS_PER_MEDIAN * np.median(left) / 6.0)


def rays_xy_at(model: CameraModel, pixels: Pixels) -> FloatArray:
    """(n, 2) x / z and y / z at (n, 2) pixels; nan where there is none."""
    rays = model.rays_at(pixels.astype(np.float64))
    ahead = rays[:, 2] > 0.05
    return np.where(ahead[:, None], rays[:, :2] / np.where(ahead, rays[:, 2], 1.0)[:, None], np.nan)


def _track(
    before: Grey, after: Grey, pixels: Pixels, guess: Pixels, levels: int
) -> tuple[Pixels, BoolArray]:
    """Lucas and Kanade's search for (n, 2) pixels, near a guess."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        pixels.reshape(-1, 1, 2),
        guess.reshape(-1, 1, 2).copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32).reshape(-1, 2), np.asarray(status.ravel() > 0)


def depths_at(depth_m: Float32Array, pixels: Pixels) -> FloatArray:
    """(n,) depths at (n, 2) pixels; nan at edges of surfaces, of the image and where none is."""
    height, width = depth_m.shape
    column, row = np.rint(pixels).astype(np.int64).T
    inside = (column > 0) & (column < width - 1) & (row > 0) & (row < height - 1)
    column, row = np.clip(column, 1, width - 2), np.clip(row, 1, height - 2)
    offsets = range(-1, 2)
    around = np.stack([depth_m[row + v, column + u] for v in offsets for u in offsets])
    middle = around[4].astype(np.float64)
    with np.errstate(invalid="ignore"):
        flat = (around > 0.0).all(axis=0) & (np.ptp(around, axis=0) < FLAT_WITHIN * middle)
    return np.where(inside & flat, middle, np.nan)
