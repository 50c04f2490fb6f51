"""The corner of a room with random patterns, seen by a depth camera: exact by plane and ray."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import Float32Array, FloatArray

PLANES = ((0, 1.6), (1, 1.1), (2, 2.4), (0, -1.6), (1, -1.1))
"""Axis and place (m) of walls, floor and ceiling in the frame of the first camera."""
TEXEL_M = 0.004
TEXELS = 1024
MODEL = pinhole(320, 240, 69.0)
K = ",".join(str(float(value)) for value in MODEL.K[[0, 1, 0, 1], [0, 1, 2, 2]])
"""As ``--intrinsics`` takes it."""
FRAMES = 8


def patterns(seed: int, contrast: float = 1.0) -> list[Float32Array]:
    """One for each plane: rectangles upon smooth noise, blurred to the texel."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in PLANES:
        image = np.full((TEXELS, TEXELS), 128.0, dtype=np.float32)
        for _ in range(900):
            x, y, w, h = rng.integers(0, [TEXELS, TEXELS, 70, 70])
            image[y : y + h + 4, x : x + w + 4] = rng.uniform(20, 235)
        smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32)
        found.append(128.0 + contrast * (smooth - 128.0))
    return found


def see(
    model: CameraModel,
    T_world_camera: FloatArray,
    textures: list[Float32Array],
    rng: np.random.Generator,
    noise: float = 2.0,
    depth_noise_per_m: float = 0.0015,
) -> tuple[NDArray[np.uint8], Float32Array]:
    """grey (h, w) and depth_m (h, w) along z, both noisy."""
    rays = model.rays()
    along = rays @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    best, bright = np.full(len(rays), np.inf), np.full(len(rays), 128.0)
    for (axis, place), texture in zip(PLANES, textures, strict=True):
        with np.errstate(divide="ignore"):
            far = (place - origin[axis]) / along[:, axis]
        nearer = (far > 0.05) & (far < best)
        hits = origin + np.where(nearer, far, 0.0)[:, None] * along
        at = np.delete(hits, axis, axis=1) / TEXEL_M + 0.5 * TEXELS
        x, y = at.astype(np.float32).reshape(model.height, model.width, 2).transpose(2, 0, 1)
        shown = cv2.remap(
            texture, x.copy(), y.copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
        )
        best = np.where(nearer, far, best)
        bright = np.where(nearer, np.asarray(shown).ravel(), bright)
    size = (model.height, model.width)
    depth_m = (best * rays[:, 2]).reshape(size)
    depth_m = depth_m + rng.normal(0.0, 1.0, size) * depth_noise_per_m * depth_m**2
    grey = bright.reshape(size) + rng.normal(0.0, noise, size)
    return (
        np.clip(np.rint(grey), 0, 255).astype(np.uint8),
        (np.rint(depth_m * 1e3) * 1e-3).astype(np.float32),
    )


def write_images(folder: Path, model: CameraModel = MODEL, frames: int = FRAMES) -> FloatArray:
    """Colour and depth while the camera moves ahead and to the side, as Open3D lays them out;
    (n, 3) its places in the frame of the first image."""
    rng, textures = np.random.default_rng(3), patterns(3)
    places_m: FloatArray = np.arange(frames)[:, None] * np.array([0.004, 0.0, 0.012])
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for number, place_m in enumerate(places_m):
        grey, depth_m = see(model, se3_from_parts(np.eye(3), place_m), textures, rng)
        colour, depth_mm = np.repeat(grey[..., None], 3, axis=2), np.rint(1e3 * depth_m)
        name = f"{number:05d}.png"
        (folder / "color" / name).write_bytes(encode_png(colour))
        (folder / "depth" / name).write_bytes(encode_png(depth_mm.astype(np.uint16)))
    return places_m
