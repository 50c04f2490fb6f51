"""How pixels change with the point that they show and with the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slamsim.cameras.lens import COEFFICIENTS, CameraModel
from slamsim.core.types import FloatArray

LENS = ("fx_px", "fy_px", "cx_px", "cy_px")
"""Before d0, d1 ... of the distortion."""
_STEP = 1e-6
"""In which ``CameraModel.pixels`` is differentiated; double precision has ten more digits."""


def lens_names(model: CameraModel) -> tuple[str, ...]:
    """Of all numbers of a lens: focal lengths, centre, coefficients of distortion."""
    return (*LENS, *(f"d{k}" for k in range(COEFFICIENTS[model.distortion_model])))


def project_slopes(model: CameraModel, points_m: FloatArray) -> FloatArray:
    """(n, 2, 3) how pixels of (n, 3) points in the optical frame change with these, px/m."""
    found = np.empty((len(points_m), 2, 3))
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = _STEP
        ahead, behind = (model.pixels(points_m + sign * step) for sign in (1.0, -1.0))
        found[:, :, axis] = (ahead - behind) / (2.0 * _STEP)
    return found


def with_lens(model: CameraModel, step: FloatArray) -> CameraModel:
    """The camera after a step of focal lengths, centre and all coefficients of distortion.

    step: (4 + k,) in pixels, then of k coefficients.
    """
    K = model.K + np.array([[step[0], 0.0, step[2]], [0.0, step[1], step[3]], [0.0, 0.0, 0.0]])
    coefficients = step[4:].copy()
    coefficients[: len(model.coefficients)] += model.coefficients
    return replace(model, K=K, coefficients=coefficients)


def lens_slopes(model: CameraModel, in_camera: FloatArray, wanted: Sequence[int]) -> FloatArray:
    """(n, 2, l) how pixels of points (n, 3) change with focal lengths, centre and distortion.

    wanted: which of these; the others' slopes are zero.
    """
    size = len(LENS) + COEFFICIENTS[model.distortion_model]
    found = np.zeros((len(in_camera), 2, size))
    for k in wanted:
        step = np.zeros(size)
        step[k] = _STEP
        ahead, behind = (with_lens(model, sign * step).pixels(in_camera) for sign in (1.0, -1.0))
        found[:, :, k] = (ahead - behind) / (2.0 * _STEP)
    return np.where(np.isfinite(found), found, 0.0)


def rigid_slopes(points: FloatArray) -> FloatArray:
    """(n, 3, 6) how points (n, 3) move with a displacement and a turn about the origin."""
    found = np.zeros((len(points), 3, 6))
    found[:, [0, 1, 2], [0, 1, 2]] = 1.0
    x, y, z = points.T
    found[:, 0, 4], found[:, 0, 5] = z, -y
    found[:, 1, 3], found[:, 1, 5] = -z, x
    found[:, 2, 3], found[:, 2, 4] = y, -x
    return found
