"""Which part of SLAM costs how much: the same errors after each part has had its say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.evaluate.trajectory import compare, covered_by, pair_errors, statistics
from slamsim.types import IntArray, PlanarTrajectory

_MIN_POSES = 3


@dataclass(frozen=True, slots=True)
class PartErrors:
    """step_rmse_m, step_rmse_mrad: of the motion from each key frame to the next. ate_rmse_m,
    ate_rot_rmse_mrad: after one alignment of the whole."""

    step_rmse_m: float
    step_rmse_mrad: float
    ate_rmse_m: float
    ate_rot_rmse_mrad: float


def error_budget(
    parts: dict[str, PlanarTrajectory | None], keyframes_ns: IntArray, truth: PlanarTrajectory
) -> dict[str, PartErrors]:
    """Errors of each part, at those key frames that it and the truth cover.

    parts: what each part made of the path, ``T_map_base``, in the order of the work. keyframes_ns:
    (k,). A part that is unknown, or has too few such key frames, is left out.
    """
    return {
        name: errors
        for name, part in parts.items()
        if part is not None and (errors := _errors(part, keyframes_ns, truth)) is not None
    }


def _errors(
    part: PlanarTrajectory, keyframes_ns: IntArray, truth: PlanarTrajectory
) -> PartErrors | None:
    both = covered_by(truth.stamps_ns, keyframes_ns) & covered_by(part.stamps_ns, keyframes_ns)
    stamps_ns = keyframes_ns[both]
    if stamps_ns.size < _MIN_POSES:
        return None
    errors = compare(PlanarTrajectory(stamps_ns, part.at(stamps_ns)), truth)
    first = np.arange(stamps_ns.size - 1)
    step = pair_errors(errors.estimate.poses, errors.truth.poses, first, first + 1)
    return PartErrors(
        step_rmse_m=statistics(np.hypot(step[:, 0], step[:, 1])).rmse,
        step_rmse_mrad=1e3 * statistics(step[:, 2]).rmse,
        ate_rmse_m=statistics(errors.translation_m).rmse,
        ate_rot_rmse_mrad=1e3 * statistics(errors.rotation_rad).rmse,
    )
