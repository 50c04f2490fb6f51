"""Images of square tags at known poses, drawn by OpenCV's warp and generator: an oracle."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.perception.tag_families import FAMILIES, TagKind
from slamsim.perception.tag_pose import square_corners

CELL_PX = 24
FINER = 4
"""Rays per pixel and axis."""


def tag_texture(kind: TagKind, number: int) -> tuple[NDArray[np.uint8], float]:
    """A tag with one cell of white around it, and the side of all of it in metres."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[kind.family]))
    cells = int(dictionary.markerSize) + 2
    drawn = cv2.aruco.generateImageMarker(dictionary, number, cells * CELL_PX)
    framed = np.pad(np.asarray(drawn, dtype=np.uint8), CELL_PX, constant_values=255)
    return framed, kind.size_m * (cells + 2) / cells


def draw_tags(
    model: CameraModel,
    tags: list[tuple[TagKind, int, FloatArray]],
    rng: np.random.Generator,
    blur_px: float = 0.7,
    noise: float = 2.0,
) -> NDArray[np.uint8]:
    """A grey image of (kind, number, T_camera_tag) on grey ground; through the model's lens."""
    rays = _rays(model)
    image = np.full(rays.shape[:2], 120.0, dtype=np.float32)
    for kind, number, T_camera_tag in tags:
        _draw(image, rays, kind, number, T_camera_tag)
    small = cv2.resize(image, (model.width, model.height), interpolation=cv2.INTER_AREA)
    if blur_px > 0.0:
        small = cv2.GaussianBlur(small, (0, 0), blur_px)
    noisy = np.asarray(small) + rng.normal(0.0, noise, small.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


@cache
def _rays(model: CameraModel) -> FloatArray:
    """(h, w, 2) x / z and y / z of each finer pixel."""
    x, y = np.meshgrid(*(np.arange(n * FINER) for n in (model.width, model.height)))
    rays = model.rays_at((np.column_stack([x.ravel(), y.ravel()]) + 0.5) / FINER - 0.5)
    return np.asarray((rays[:, :2] / rays[:, 2:]).reshape(*x.shape, 2))


def _draw(
    image: NDArray[np.float32],
    rays: FloatArray,
    kind: TagKind,
    number: int,
    T_camera_tag: FloatArray,
) -> None:
    texture, side_m = tag_texture(kind, number)
    reach = side_m / T_camera_tag[2, 3]
    near = np.abs(rays - T_camera_tag[:2, 3] / T_camera_tag[2, 3]).max(axis=2) < reach
    plane = np.linalg.inv(np.column_stack([T_camera_tag[:3, [0, 1]], T_camera_tag[:3, 3]]))
    on_plane = np.column_stack([rays[near], np.ones(np.count_nonzero(near))]) @ plane.T
    at = on_plane[:, :2] / on_plane[:, 2:] / side_m
    inside = (np.abs(at) < 0.5).all(axis=1)
    places = np.flatnonzero(near)[inside]
    texel = np.array([1.0, -1.0]) * at[inside] + 0.5
    bright = _sampled(texture, texel * texture.shape[0] - 0.5)
    image.ravel()[places] = 30.0 + 170.0 / 255.0 * bright


def _sampled(texture: NDArray[np.uint8], at_px: FloatArray) -> FloatArray:
    """(n,) brightness between the texels by two lines, exact, which cv2.remap is not."""
    most = texture.shape[0] - 1
    low = np.clip(np.floor(at_px).astype(np.int64), 0, most - 1)
    (u, v), (x, y) = np.clip(at_px - low, 0.0, 1.0).T, low.T
    t = texture.astype(np.float64)
    above = (1 - u) * t[y, x] + u * t[y, x + 1]
    below = (1 - u) * t[y + 1, x] + u * t[y + 1, x + 1]
    return np.asarray((1 - v) * above + v * below)


def random_tag_pose(
    model: CameraModel,
    rng: np.random.Generator,
    z_m: tuple[float, float],
    tilt_rad: float = 1.1,
    size_m: float = 0.2,
) -> FloatArray:
    """(4, 4) T_camera_tag, whole in view, tilted by up to so much, turned about itself anyhow."""
    while True:
        pixel = rng.uniform(0.0, [model.width, model.height])
        ray = model.rays_at(pixel[None])[0]
        axis = np.append(rng.normal(size=2), 0.0)
        tilt = axis / np.linalg.norm(axis) * rng.uniform(0.0, tilt_rad)
        turn = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        R = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(turn)[0] @ np.diag([1.0, -1.0, -1.0])
        T_camera_tag = se3_from_parts(R, ray / ray[2] * rng.uniform(*z_m))
        outer = 1.3 * square_corners(size_m) @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]
        pixels, seen = model.project(outer)
        if seen.all() and model.contains(pixels).all():
            return T_camera_tag
