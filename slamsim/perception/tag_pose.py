"""The pose of a square tag from its four corners, how sure it is, and whether it is the only one.

Both solutions of the plane pose are found in closed form (Collins & Bartoli 2014: Infinitesimal
Plane-based Pose Estimation, ``cv2.SOLVEPNP_IPPE_SQUARE``), and each is moved to where the corners
fit best by their covariance. A small tag far away looks alike tilted either way: then both fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.perception.tag_edges import Corners

STEPS = 6
"""Of Gauss and Newton; begun at a closed solution, the third is below a micrometre."""
FREEDOM = 2.0
"""Eight coordinates of corners less six of a pose."""
MOST_CHI2 = 27.6
"""A square that fits worse was none: two degrees of freedom, one right tag in a million."""
AMBIGUOUS_CHI2 = 2.0 * np.log(1000.0)
"""Solutions whose odds are nearer than a thousand to one are both told."""


@dataclass(frozen=True, slots=True, eq=False)
class TagPose:
    """T_camera_tag: (4, 4), the tag's x right, y up and z out of it, towards the camera.

    covariance: (6, 6) of a small step of the tag: metres along the camera's axes, then radians
    about them (R_true = exp(step) R). Where ambiguous, it spans both solutions. chi2: misfit of the
    corners, of two degrees of freedom. other: (4, 4) the second solution where ambiguous.
    """

    T_camera_tag: FloatArray
    covariance: FloatArray
    chi2: float
    other: FloatArray | None = None

    @property
    def is_ambiguous(self) -> bool:
        return self.other is not None

    def in_own_frame(self) -> tuple[FloatArray, FloatArray]:
        """T_camera_tag, and the covariance of a small step of the tag in its own frame."""
        R = np.kron(np.eye(2), self.T_camera_tag[:3, :3])
        return self.T_camera_tag, np.asarray(R.T @ self.covariance @ R)


def square_corners(size_m: float) -> FloatArray:
    """(4, 3) in the tag's frame: top left, then clockwise as one looks at the tag."""
    half = 0.5 * size_m
    return np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])


def tag_pose(corners: Corners, size_m: float) -> TagPose | None:
    """The likelier of the two poses that show a square of this size so; None if none does."""
    information = np.asarray(np.linalg.inv(corners.covariance), dtype=np.float64)
    found = [
        solution
        for start in _closed_solutions(corners.rays_xy, size_m)
        if (solution := _fitted(start, corners.rays_xy, information, size_m)) is not None
    ]
    if not found:
        return None
    found.sort(key=lambda solution: solution.chi2)
    best = found[0]
    if best.chi2 > MOST_CHI2:
        return None
    # Corners that fit even the better one badly tell less than they claim (Birge 1932).
    scale = max(1.0, best.chi2 / FREEDOM)
    rivals = [s for s in found[1:] if s.chi2 - best.chi2 < AMBIGUOUS_CHI2 * scale]
    rivals = [s for s in rivals if _apart(s, best)]
    return _spanning(best, rivals[0], scale) if rivals else best


def step_between(T_camera_tag: FloatArray, T_true: FloatArray) -> FloatArray:
    """(6,) the step that takes one pose to the other, as ``TagPose.covariance`` counts it."""
    turn, _ = cv2.Rodrigues(T_true[:3, :3] @ T_camera_tag[:3, :3].T)
    return np.concatenate([T_true[:3, 3] - T_camera_tag[:3, 3], turn[:, 0]])


def moved(T_camera_tag: FloatArray, step: FloatArray) -> FloatArray:
    """(4, 4) after a small step (6,)."""
    turn = np.asarray(cv2.Rodrigues(step[3:])[0], dtype=np.float64)
    return se3_from_parts(turn @ T_camera_tag[:3, :3], T_camera_tag[:3, 3] + step[:3])


def _closed_solutions(rays_xy: FloatArray, size_m: float) -> list[FloatArray]:
    found, turns, shifts, _ = cv2.solvePnPGeneric(
        square_corners(size_m), rays_xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    return [
        se3_from_parts(np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64), np.ravel(shift))
        for turn, shift in zip(turns[:found], shifts[:found], strict=True)
        if np.isfinite(turn).all() and np.isfinite(shift).all()
    ]


def _fitted(
    T_camera_tag: FloatArray, rays_xy: FloatArray, information: FloatArray, size_m: float
) -> TagPose | None:
    """The pose that fits best near this one; None if that is behind the camera or nowhere."""
    corners_m = square_corners(size_m)
    for _ in range(STEPS):
        off, by_step = _misfit(T_camera_tag, corners_m, rays_xy)
        normal = by_step.T @ information @ by_step
        try:
            step = np.asarray(np.linalg.solve(normal, -by_step.T @ information @ off), np.float64)
        except np.linalg.LinAlgError:
            return None
        size = float(np.linalg.norm(step[3:]))
        T_camera_tag = moved(T_camera_tag, step * min(1.0, 0.5 / max(size, 1e-12)))
    in_camera = corners_m @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]
    if not np.isfinite(T_camera_tag).all() or (in_camera[:, 2] <= 0.0).any():
        return None
    off, by_step = _misfit(T_camera_tag, corners_m, rays_xy)
    covariance = np.linalg.pinv(by_step.T @ information @ by_step, hermitian=True)
    return TagPose(T_camera_tag, np.asarray(covariance, np.float64), float(off @ information @ off))


def _misfit(
    T_camera_tag: FloatArray, corners_m: FloatArray, rays_xy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(8,) corners as they should be seen less those seen, and (8, 6) how a step changes them."""
    turned = corners_m @ T_camera_tag[:3, :3].T
    x, y, z = (turned + T_camera_tag[:3, 3]).T
    off = np.column_stack([x / z, y / z]) - rays_xy
    zero = np.zeros(4)
    by_point = np.stack([[1.0 / z, zero, -x / z**2], [zero, 1.0 / z, -y / z**2]])  # (2, 3, 4)
    by_point = np.moveaxis(by_point, 2, 0)
    by_turn = np.array([[[0, w, -v], [-w, 0, u], [v, -u, 0]] for u, v, w in turned])
    by_step = np.concatenate([by_point, by_point @ by_turn], axis=2)
    return off.ravel(), by_step.reshape(8, 6)


def _apart(one: TagPose, other: TagPose) -> bool:
    """Whether two solutions are two: the same one may be found from both starts."""
    step = step_between(one.T_camera_tag, other.T_camera_tag)
    return bool(np.abs(step).max() > 1e-4)


def _spanning(best: TagPose, rival: TagPose, scale: float) -> TagPose:
    """The likelier solution with the second moment of both about it, by their odds."""
    share = 1.0 / (1.0 + float(np.exp(0.5 * (rival.chi2 - best.chi2) / scale)))
    step = step_between(best.T_camera_tag, rival.T_camera_tag)
    covariance = (1.0 - share) * best.covariance
    covariance = covariance + share * (rival.covariance + np.outer(step, step))
    return TagPose(best.T_camera_tag, covariance, best.chi2, rival.T_camera_tag)
