"""Scores against hand-verified relative poses, as published for the classic 2-D laser logs.

Metric of Kuemmerle et al. 2009, "On Measuring the Accuracy of SLAM Algorithms": for each relation,
``inverse(relation) * (inverse(pose(t1)) * pose(t2))``; mean and standard deviation of the sizes of
its translation and rotation. Relations between nearby instants measure the local consistency
of a map, those between distant ones its global consistency, so both are told apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import BoolArray, FloatArray, IntArray, PlanarTrajectory
from slamsim.evaluate.trajectory import span_in_words
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite, require_stamps

NEAR_BELOW_S = 5.0
FAR_ABOVE_S = 60.0
"""Relations between neighbours tell of the front end, those over more than a minute of closures."""


@dataclass(frozen=True, slots=True)
class RelationStatistics:
    """Mean and standard deviation of the absolute errors of ``count`` relations."""

    count: int
    translation_mean_m: float
    translation_std_m: float
    rotation_mean_deg: float
    rotation_std_deg: float


@dataclass(frozen=True, slots=True)
class RelationScores:
    """near: relations over less than 5 s; far: over more than 60 s; None where there is none.

    skipped: relations with an instant that the trajectory does not cover.
    """

    all: RelationStatistics
    near: RelationStatistics | None
    far: RelationStatistics | None
    skipped: int


def score_relations(
    trajectory: PlanarTrajectory,
    from_ns: IntArray,
    to_ns: IntArray,
    T_from_to: FloatArray,
) -> RelationScores:
    """from_ns, to_ns: (n,) instants; T_from_to: (n, 3) the true motion.

    Raises SlamsimError if the trajectory covers no relation, BadNumbers for what is none.
    """
    for stamps_ns in (from_ns, to_ns):
        require_stamps("relations", stamps_ns, rising=False)
    require_finite("relations", T_from_to, (from_ns.size, 3))
    used = _covered(trajectory, from_ns) & _covered(trajectory, to_ns)
    if not used.any():
        raise SlamsimError(
            f"none of the {used.size} relations lies within the trajectory: "
            f"{span_in_words(trajectory.stamps_ns)} against "
            f"{span_in_words(np.sort(np.concatenate([from_ns, to_ns])))}"
        )
    estimated = between(trajectory.at(from_ns[used]), trajectory.at(to_ns[used]))
    errors = between(T_from_to[used], estimated)
    apart_s = np.abs(to_ns[used] - from_ns[used]) * 1e-9
    near, far = apart_s < NEAR_BELOW_S, apart_s > FAR_ABOVE_S
    return RelationScores(
        all=_statistics(errors),
        near=_statistics(errors[near]) if near.any() else None,
        far=_statistics(errors[far]) if far.any() else None,
        skipped=int(np.count_nonzero(~used)),
    )


def _statistics(errors: FloatArray) -> RelationStatistics:
    translation_m = np.linalg.norm(errors[:, :2], axis=1)
    rotation_deg = np.rad2deg(np.abs(errors[:, 2]))
    return RelationStatistics(
        count=errors.shape[0],
        translation_mean_m=float(translation_m.mean()),
        translation_std_m=float(translation_m.std()),
        rotation_mean_deg=float(rotation_deg.mean()),
        rotation_std_deg=float(rotation_deg.std()),
    )


def _covered(trajectory: PlanarTrajectory, stamps_ns: IntArray) -> BoolArray:
    if len(trajectory) == 0:
        return np.zeros(stamps_ns.shape, dtype=np.bool_)
    first, last = trajectory.stamps_ns[[0, -1]]
    return np.asarray((stamps_ns >= first) & (stamps_ns <= last), dtype=np.bool_)
