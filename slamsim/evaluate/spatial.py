"""Errors of a path in space against the true one, for cameras, which do not move in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.core.types import FloatArray, Trajectory
from slamsim.evaluate.trajectory import covered_by, span_in_words
from slamsim.guard.errors import SlamsimError

LEAST_POSES = 3


@dataclass(frozen=True, slots=True)
class SpatialErrors:
    """ate_rmse_m, ate_max_m: of positions after the rigid alignment with the least squares.
    end_error_m: where the path ends, if it begins at the true first pose; drift_percent: the same
    as a share of the true path, path_m. compared: poses that the truth covers."""

    ate_rmse_m: float
    ate_max_m: float
    end_error_m: float
    drift_percent: float
    path_m: float
    compared: int


def compare_in_space(estimate: Trajectory, truth: Trajectory) -> SpatialErrors:
    """Both of the same frame, each in any fixed one.

    Raises SlamsimError where they share too little time, or the truth does not move.
    """
    inside = covered_by(truth.stamps_ns, estimate.stamps_ns)
    if np.count_nonzero(inside) < LEAST_POSES:
        raise SlamsimError(
            f"the truth ({span_in_words(truth.stamps_ns)}) covers too little of the path "
            f"({span_in_words(estimate.stamps_ns)})"
        )
    stamps_ns = estimate.stamps_ns[inside]
    found_m, found = estimate.positions_m[inside], Rotation.from_quat(estimate.quats_xyzw[inside])
    there = truth.at(stamps_ns)
    true_m, true = there.positions_m, Rotation.from_quat(there.quats_xyzw)
    path_m = float(np.linalg.norm(np.diff(true_m, axis=0), axis=1).sum())
    if path_m <= 0.0:
        raise SlamsimError("the true path does not move while images were taken")
    errors_m = np.linalg.norm(_aligned(found_m, true_m) - true_m, axis=1)
    moved_m = found[0].inv().apply(found_m[-1] - found_m[0])
    truly_moved_m = true[0].inv().apply(true_m[-1] - true_m[0])
    end_error_m = float(np.linalg.norm(moved_m - truly_moved_m))
    return SpatialErrors(
        ate_rmse_m=float(np.sqrt(np.mean(errors_m**2))),
        ate_max_m=float(errors_m.max()),
        end_error_m=end_error_m,
        drift_percent=100.0 * end_error_m / path_m,
        path_m=path_m,
        compared=len(stamps_ns),
    )


def _aligned(points_m: FloatArray, onto_m: FloatArray) -> FloatArray:
    """(n, 3) points turned and moved onto others."""
    middle_m, onto_middle_m = points_m.mean(axis=0), onto_m.mean(axis=0)
    # Points on a line leave the turn about it open, which changes no distance.
    turn = _turn(points_m - middle_m, onto_m - onto_middle_m)
    return np.asarray((points_m - middle_m) @ turn.T + onto_middle_m)


def _turn(points_m: FloatArray, onto_m: FloatArray) -> FloatArray:
    """(3, 3) the rotation with the least squares (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(onto_m.T @ points_m)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray(u @ mirror @ vt)
