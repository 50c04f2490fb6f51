"""Small motions of a camera as six numbers: metres along its axes, then radians about them."""

from __future__ import annotations

import cv2
import numpy as np

from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import FloatArray


def exponential(motion: FloatArray) -> FloatArray:
    """(4, 4) of (6,): a turn, and a shift after it."""
    return se3_from_parts(np.asarray(cv2.Rodrigues(motion[3:])[0], np.float64), motion[:3])


def logarithm(T: FloatArray) -> FloatArray:
    """(6,) of (4, 4)."""
    return np.concatenate([T[:3, 3], np.asarray(cv2.Rodrigues(T[:3, :3])[0], np.float64)[:, 0]])


def cross_matrix(axis: FloatArray) -> FloatArray:
    """(3, 3) that takes b to axis x b."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turned_into(T_now_keyframe: FloatArray, own: FloatArray) -> FloatArray:
    """(6, 6) what a covariance of the key frame's pose, about its own camera, adds to a motion."""
    R = np.kron(np.eye(2), T_now_keyframe[:3, :3])
    return np.asarray(R @ own @ R.T)


def about_camera(T_now_keyframe: FloatArray, covariance: FloatArray) -> FloatArray:
    """(6, 6) covariance of the camera's pose now, of small steps about itself, from that of a
    ``FittedMotion``."""
    J = np.eye(6)
    J[:3, 3:] = cross_matrix(T_now_keyframe[:3, 3])
    return np.asarray(J @ covariance @ J.T)


def swept_points(points_m: FloatArray, late: FloatArray, swept: FloatArray) -> FloatArray:
    """(n, 3) points of the camera at its first row where they are when (n,) late of it is read.

    swept: (6,) how points move in the camera from the first row to the last.
    """
    return np.asarray(points_m + late[:, None] * (swept[:3] + np.cross(swept[3:], points_m)))


def at_first_row(points_m: FloatArray, late: FloatArray, swept: FloatArray) -> FloatArray:
    """(n, 3) where points are at the first row whose direction was seen when (n,) late of the image
    was read, and whose depth z is that of the first row: depth cameras have global shutters."""
    flow = swept[:3] + np.cross(swept[3:], points_m)
    seen = points_m * (1.0 + late[:, None] * flow[:, 2:] / points_m[:, 2:])
    return np.asarray(seen - late[:, None] * flow)
