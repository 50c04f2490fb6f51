"""The motion of a depth camera from points that it sees again.

Gauss and Newton's steps on where the points are seen, in pixels, and how far away they are, with
the weights of Cauchy's estimator. How noisy both are is learnt from what is left in the end. How
sure the motion is follows from what is left in each part of the image: neighbouring points share
errors of depth and of the model, which no sum over single points would show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.perception.tag_pose import moved
from slamsim.perception.twist import swept_points

STEPS = 6
CAUCHY_SIGMAS = 2.0
LEAST_PIXEL_SIGMA = 0.1
"""Tracks of points are no surer, whatever is left: 0.1 px is what the tracker's search ends at."""
FIRST_PIXEL_SIGMA = 0.3
DEPTH_NOISE_PER_M = 0.0015
"""Standard deviation of a depth over its square, 1/m, to begin with; a D435's is 0.002 to 0.004
(its data sheet: less than 2 % of the distance at 2 m), a structured-light camera's 0.0015
(Khoshelham & Elberink 2012)."""
LEAST_DEPTH_SIGMA_M = 0.001
"""Depth images hold millimetres."""
BLOCKS = 4
"""So many columns and rows of blocks are cut of the image, whose errors count as independent."""
SHARED_ERROR = 1.5
"""Least variance over that of independent points: what exact scenes show."""
MODEL_PX = 0.2
"""What intrinsics, and colour beside depth, leave in all of an image alike; the residuals do not
show it. From key frame to key frame the living room is off by 0.5 mrad and 1 mm, which is that."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """points_m: (n, 3) in the key frame's camera. rays_xy: (n, 2) x / z and y / z of where each is
    seen now. depths_m: (n,) along z, now; nan where it is unknown. late: (n,) which part of the
    readout of the image was over when each was seen. vague: (n,) by how much less sure than a good
    corner each is."""

    points_m: FloatArray
    rays_xy: FloatArray
    depths_m: FloatArray
    late: FloatArray
    vague: FloatArray

    def __len__(self) -> int:
        return len(self.points_m)

    def those(self, chosen: BoolArray) -> SeenPoints:
        """The points of which (n,) chosen is true."""
        return SeenPoints(
            self.points_m[chosen],
            self.rays_xy[chosen],
            self.depths_m[chosen],
            self.late[chosen],
            self.vague[chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class FittedMotion:
    """T_now_keyframe: (4, 4), takes points of the key frame's camera into that of now.

    covariance: (6, 6) of a small step of it, metres along the axes of now's camera, then radians
    about them. pixel_sigma: what was left, in pixels.
    """

    T_now_keyframe: FloatArray
    covariance: FloatArray
    pixel_sigma: float


def fit_motion(
    T_now_keyframe: FloatArray, seen: SeenPoints, focal_px: float, swept: FloatArray
) -> FittedMotion:
    """The most likely motion near a first guess (4, 4); LinAlgError where nothing holds it.

    swept: (6,) how points move in the camera while it is read out, metres, then radians.
    """
    T, pixel_sigma, depth_factor = T_now_keyframe, FIRST_PIXEL_SIGMA, 1.0
    pulls, normal = np.zeros((len(seen), 6)), np.eye(6)
    for _ in range(STEPS):
        off, by_step, off_m, depth_by_step = misfit(T, seen, swept)
        depth_sigma = depth_factor * _depth_sigma_m(seen.depths_m)
        sigmas = pixel_sigma * seen.vague
        pixels = np.linalg.norm(off, axis=1) * focal_px / sigmas
        known = np.isfinite(off_m)
        depths = np.where(known, off_m, 0.0) / np.where(known, depth_sigma, 1.0)
        of_pixels = weight_of(pixels) * (focal_px / sigmas) ** 2
        of_depths = np.where(known, weight_of(depths) / np.where(known, depth_sigma, 1.0) ** 2, 0.0)
        normal = np.einsum("nij,nik,n->jk", by_step, by_step, of_pixels)
        normal += (depth_by_step * of_depths[:, None]).T @ depth_by_step
        pulls = np.einsum("nij,ni,n->nj", by_step, off, of_pixels)
        pulls += depth_by_step * (of_depths * np.where(known, off_m, 0.0))[:, None]
        T = moved(T, -np.asarray(np.linalg.solve(normal, pulls.sum(axis=0)), dtype=np.float64))
        left_px = float(np.median(np.abs(off) / seen.vague[:, None])) * focal_px * SIGMAS_PER_MEDIAN
        pixel_sigma = max(left_px, LEAST_PIXEL_SIGMA)
        if known.any():
            left = SIGMAS_PER_MEDIAN * float(np.median(np.abs(depths[known]))) * depth_factor
            depth_factor = max(left, 0.3)
    covariance = _covariance(normal, pulls, blocks_of(seen.rays_xy))
    turn = MODEL_PX / focal_px
    shift_m = turn * float(np.median(seen.points_m[:, 2]))
    covariance += np.diag(np.repeat([shift_m, turn], 3) ** 2)
    return FittedMotion(T, covariance, pixel_sigma)


def _covariance(normal: FloatArray, pulls: FloatArray, blocks: IntArray) -> FloatArray:
    """(6, 6) by what is left in each block (Liang & Zeger 1986), never below independent points'.

    The sum of both: blocks are few, and in some directions theirs is too small by chance.
    """
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    summed = np.zeros((int(blocks.max()) + 1, 6))
    np.add.at(summed, blocks, pulls)
    count = len(np.unique(blocks))
    spread = summed.T @ summed * (count / max(count - 1.0, 1.0))
    return np.asarray(SHARED_ERROR * inverse + inverse @ spread @ inverse)


def blocks_of(rays_xy: FloatArray) -> IntArray:
    """(n,) number of the block in which each point is seen."""
    low, high = rays_xy.min(axis=0), rays_xy.max(axis=0)
    at = (rays_xy - low) / np.maximum(high - low, 1e-9) * BLOCKS
    column, row = np.minimum(at.astype(np.int64), BLOCKS - 1).T
    return np.asarray(BLOCKS * row + column)


def weight_of(sigmas: FloatArray) -> FloatArray:
    """(n,) of Cauchy's estimator."""
    return np.asarray(1.0 / (1.0 + (sigmas / CAUCHY_SIGMAS) ** 2))


def _depth_sigma_m(depths_m: FloatArray) -> FloatArray:
    """(n,) of the difference of two depths, each of which has the noise of its square."""
    one = np.hypot(DEPTH_NOISE_PER_M * depths_m**2, LEAST_DEPTH_SIGMA_M)
    return np.asarray(np.sqrt(2.0) * one)


def misfit(
    T_now_keyframe: FloatArray, seen: SeenPoints, swept: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(n, 2) rays as they should be less those seen, (n, 2, 6) how a step changes them; (n,) depths
    as they should be less those seen, (n, 6) how a step changes them."""
    turned = seen.points_m @ T_now_keyframe[:3, :3].T
    there = turned + T_now_keyframe[:3, 3]
    x, y, z = swept_points(there, seen.late, swept).T
    off = np.column_stack([x / z, y / z]) - seen.rays_xy
    (u, v, w), zero = turned.T, np.zeros(len(seen))
    one = np.ones(len(seen))
    x_by_step = np.column_stack([one, zero, zero, zero, w, -v])
    y_by_step = np.column_stack([zero, one, zero, -w, zero, u])
    z_by_step = np.column_stack([zero, zero, one, v, -u, zero])
    rays_by_step = np.stack(
        [
            x_by_step / z[:, None] - z_by_step * (x / z**2)[:, None],
            y_by_step / z[:, None] - z_by_step * (y / z**2)[:, None],
        ],
        axis=1,
    )
    return off, rays_by_step, there[:, 2] - seen.depths_m, z_by_step
