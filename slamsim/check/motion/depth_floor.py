"""The floor that a depth camera sees: how the camera is tilted, and how high it is above it.

A robot stays on its floor, so that the floor is the same plane in the frame of the camera in all
images. Nothing but the claimed way up takes part: no scans, no odometry, no texture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.motion.depth_slices import (
    FEWEST_IMAGES,
    FEWEST_POINTS,
    chosen_looks,
    grid_rays,
)
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, FloatArray, IntArray

_MOST_POINTS = 20_000
"""Of all images together, evenly chosen."""
_NEAREST_M, _FARTHEST_M = 0.02, 100.0
"""Between these depth cameras see; what stands for no depth is beyond."""
_UPRIGHT = np.cos(np.radians(45.0))
"""How far from the claimed way up the floor is looked for."""
_TRIES = 300
"""Triples of points: where a fifth of the points are the floor's, one in 125 shows it."""
_WITHIN_M, _WITHIN_SHARE = 0.01, 0.015
"""How far points may be from a plane that is tried, and more by a share of their depth."""
_FLOOR_M, _NOISE = 0.003, 0.005
"""Standard deviation of a floor that is not flat, and of depths per square metre (stereo)."""
_LEAST_SHARE = 0.05
"""Of the points on surfaces as level as the floor: fewer are a table's."""
_ROUNDS, _TUKEY = 10, 4.0
"""Of the refinement, and beyond how many sigmas a point counts for nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorFit:
    """tilt_rad: (2,) by how much the camera is turned otherwise than claimed: about the axis to its
    right (it looks further up), and about where it looks, seen from above (its left side is
    higher). height_m: of the camera above the floor. up: (3,) away from the floor, in the camera.
    sigmas: (3,) of tilt and height. images: in which the floor is seen."""

    tilt_rad: FloatArray
    height_m: float
    up: FloatArray
    sigmas: FloatArray
    images: int


def fit_floor(depth: CameraSurvey, R_base_camera: FloatArray) -> FloorFit | None:
    """None where too few images show a floor.

    R_base_camera: (3, 3) as claimed. Raises BadNumbers for a CameraInfo that no camera can have.
    """
    assert depth.claim is not None
    up = R_base_camera[2]
    points, image = _level_points(depth, up)
    if len(points) < FEWEST_POINTS:
        return None
    plane = _commonest(points, up)
    if plane is None:
        return None
    right, ahead = _axes(up)
    slopes, covariance, used = _refined(points, image, plane, np.stack([right, ahead, up]))
    seen = np.unique(image[used]).size
    if seen < FEWEST_IMAGES or used.sum() < max(FEWEST_POINTS, _LEAST_SHARE * len(points)):
        return None
    # height = -(a right + b ahead + up) . point, so the floor's normal is up + a right + b ahead.
    by_right, by_ahead, offset_m = slopes
    steep = np.sqrt(1.0 + by_right**2 + by_ahead**2)
    tilt = np.array([np.arctan(by_ahead), -np.arctan(by_right)])
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))[[1, 0, 2]]
    seen_up = (by_right * right + by_ahead * ahead + up) / steep
    height_m = float(offset_m / steep)
    return FloorFit(tilt, height_m, seen_up, sigmas, seen)


def _axes(up: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Level axes in the camera: to the right of where it looks, and ahead; of a camera that looks
    up or down, ahead is the upper edge of its images."""
    ahead = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < _UPRIGHT else np.array([0.0, -1.0, 0.0])
    ahead = ahead - (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    return np.cross(ahead, up), ahead


def _level_points(depth: CameraSurvey, up: FloatArray) -> tuple[FloatArray, IntArray]:
    """(n, 3) points in the camera where surfaces are about level, below the camera, and (n,) the
    image of each."""
    assert depth.claim is not None
    rays = grid_rays(depth, depth.claim.model())
    found, images = [], []
    for number, look in enumerate(chosen_looks(depth).tolist()):
        grid_m = depth.grids_m[look]
        seen = (grid_m > _NEAREST_M) & (grid_m < _FARTHEST_M)
        points = rays * np.where(seen, grid_m, np.nan)[..., None]
        down, across = points[2:, 1:-1] - points[:-2, 1:-1], points[1:-1, 2:] - points[1:-1, :-2]
        normals = np.cross(across, down)
        with np.errstate(invalid="ignore", divide="ignore"):
            level = np.abs(normals @ up) > _UPRIGHT * np.linalg.norm(normals, axis=-1)
            level &= points[1:-1, 1:-1] @ up < 0.0
        found.append(points[1:-1, 1:-1][level])
        images.append(np.full(int(level.sum()), number))
    if not found:
        return np.zeros((0, 3)), np.zeros(0, np.int64)
    every = max(sum(map(len, found)) // _MOST_POINTS, 1)
    return np.concatenate(found)[::every], np.concatenate(images)[::every]


def _commonest(points: FloatArray, up: FloatArray) -> FloatArray | None:
    """(4,) the plane, as a unit normal and its distance below the camera, on which most of the
    points (n, 3) lie: random triples, always the same (RANSAC; Fischler & Bolles 1981)."""
    rng = np.random.default_rng(len(points))
    a, b, c = points[rng.integers(0, len(points), (3, _TRIES))]
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    normals = normals[sizes > 0.0] / sizes[sizes > 0.0, None]
    normals *= np.sign(normals @ up)[:, None]
    upright = normals @ up > _UPRIGHT
    offsets = -np.einsum("ij,ij->i", normals, a[sizes > 0.0])
    best, most = None, 0
    within = _WITHIN_M + _WITHIN_SHARE * points[:, 2]
    for normal, offset in zip(normals[upright], offsets[upright], strict=True):
        count = int(np.count_nonzero(np.abs(points @ normal + offset) < within))
        if count > most:
            best, most = np.append(normal, offset), count
    return best


def _refined(
    points: FloatArray, image: IntArray, plane: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(3,) slopes along two level axes and distance below the camera, their covariance (3, 3), and
    which points count. axes: (3, 3) right, ahead, up."""
    right, ahead, up = axes @ points.T
    A = np.column_stack([right, ahead, np.ones(len(points))])
    normal = axes @ plane[:3]
    values = np.array([normal[0], normal[1], plane[3]]) / normal[2]
    # Along a ray that grazes the floor an error of depth is one of height by as much as it slopes.
    grazing = np.abs(up) / np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    scatter = np.hypot(_FLOOR_M, _NOISE * np.square(points[:, 2]) * grazing)
    for _ in range(_ROUNDS):
        off = (A @ values + up) / scatter
        near = np.abs(off[np.abs(off) < 10.0])
        noise = max(SIGMAS_PER_MEDIAN * float(np.median(near)), 0.3) if near.size else 1.0
        weights = np.square(np.maximum(1.0 - np.square(off / (_TUKEY * noise)), 0.0)) / scatter**2
        H = (A * weights[:, None]).T @ A
        values = values - np.linalg.pinv(H) @ (A * weights[:, None]).T @ (A @ values + up)
    off = A @ values + up
    # What is wrong within an image is alike (the robot rocks, depths are bent): images count.
    pulls = np.zeros((int(image.max()) + 1, 3))
    np.add.at(pulls, image, A * (weights * off)[:, None])
    inverse = np.linalg.pinv(H)
    return values, inverse @ (pulls.T @ pulls) @ inverse, weights > 0.0
