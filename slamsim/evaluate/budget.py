"""Error budget of SLAM: the same errors after each stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import IntArray, PlanarTrajectory
from slamsim.evaluate.trajectory import compare, covered_by, pair_errors, statistics

PARTS = {
    "odometry": "odometry of the log",
    "prediction": "prediction from wheels and gyroscope",
    "front_end": "front end, scan by scan",
    "closures": "loops closed",
    "graph": "key frames refined together",
    "smoothed": "all scans smoothed together",
}
"""What each part is, in the order of the work."""

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
    parts: Mapping[str, PlanarTrajectory], keyframes_ns: IntArray, truth: PlanarTrajectory
) -> dict[str, PartErrors]:
    """Errors of each part, at those key frames that it and the truth cover.

    parts: what each of PARTS made of the path, ``T_map_base``. keyframes_ns: (k,). A part that is
    unknown, or has too few such key frames, is left out.
    """
    known = {name: parts[name] for name in PARTS if name in parts}
    found = {name: _errors(part, keyframes_ns, truth) for name, part in known.items()}
    return {name: errors for name, errors in found.items() if errors is not None}


def at_instants(part: PlanarTrajectory, stamps_ns: IntArray) -> PlanarTrajectory:
    """The part at those of the instants that it covers. stamps_ns: (n,)."""
    stamps_ns = stamps_ns[covered_by(part.stamps_ns, stamps_ns)]
    return PlanarTrajectory(stamps_ns, part.at(stamps_ns))


def _errors(
    part: PlanarTrajectory, keyframes_ns: IntArray, truth: PlanarTrajectory
) -> PartErrors | None:
    there = at_instants(part, keyframes_ns[covered_by(truth.stamps_ns, keyframes_ns)])
    if len(there) < _MIN_POSES:
        return None
    errors = compare(there, truth)
    first = np.arange(len(there) - 1)
    step = pair_errors(errors.estimate.poses, errors.truth.poses, first, first + 1)
    return PartErrors(
        step_rmse_m=statistics(np.hypot(step[:, 0], step[:, 1])).rmse,
        step_rmse_mrad=1e3 * statistics(step[:, 2]).rmse,
        ate_rmse_m=statistics(errors.translation_m).rmse,
        ate_rot_rmse_mrad=1e3 * statistics(errors.rotation_rad).rmse,
    )
