"""Errors of an estimated trajectory against the true one: ATE and RPE.

Absolute trajectory error (ATE; Sturm et al. 2012, "A Benchmark for the Evaluation of RGB-D SLAM
Systems"): the estimate is laid onto the truth by the rigid motion of the plane that minimises the
squared distances (Horn 1987, Umeyama 1991, without scale), then compared pose by pose.
Relative pose error (RPE) in the manner of KITTI (Geiger et al. 2012): how much is gained or lost
over stretches of a given length of the true path, per metre of it. Only the truth is
interpolated, to the instants of the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, compose, wrap_angle
from slamsim.core.types import BoolArray, FloatArray, IntArray, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import FINITE, BadNumbers, require_finite

SEGMENT_LENGTHS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Lengths of true path over which the relative error is taken; those that a run is too short for
are left out, and a run shorter than the first has no relative error."""

MAX_TRUTH_GAP_S = 1.0
"""The truth is not interpolated between samples further apart than this."""

_MIN_SPREAD_M = 0.05
"""RMS of positions so close together that they say less of a heading than the headings do."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """Of the absolute values of an error, in the error's unit."""

    rmse: float
    mean: float
    median: float
    max: float


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryErrors:
    """An estimate compared with the truth, at those of its instants that the truth covers.

    estimate: ``T_truth_base`` of the aligned estimate; truth: the true one at the same (n,)
    stamps. T_truth_estimate: (3,) the alignment, which takes the estimate's map frame to the
    truth's. translation_m: (n,) distance. rotation_rad: (n,) signed difference of the headings,
    estimate minus truth. uncovered: poses of the estimate that the truth does not cover.
    """

    estimate: PlanarTrajectory
    truth: PlanarTrajectory
    T_truth_estimate: FloatArray
    translation_m: FloatArray
    rotation_rad: FloatArray
    uncovered: int


@dataclass(frozen=True, slots=True)
class RelativeErrors:
    """Means over all segments of all lengths; segments: how many there were."""

    translation_percent: float
    rotation_deg_per_m: float
    segments: int


def statistics(errors: FloatArray) -> Statistics:
    """errors: (n,) with n > 0; signs do not matter. Raises BadNumbers."""
    require_finite("errors", errors, (None,), FINITE**0.5)
    if not errors.size:
        raise BadNumbers("there is no error to tell the size of")
    size = np.abs(errors)
    return Statistics(
        rmse=float(np.sqrt(np.mean(size**2))),
        mean=float(np.mean(size)),
        median=float(np.median(size)),
        max=float(np.max(size)),
    )


def align_se2(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """``T_truth_estimate`` (3,), which minimises the squared distances of the positions.

    estimate, truth: (n, 3) poses at equal instants. If the estimate hardly moves, its positions
    do not define a turn, and the mean difference of the headings is taken instead. Raises
    BadNumbers.
    """
    require_finite("the poses to align", estimate, (None, 3))
    require_finite("the poses to align with", truth, estimate.shape)
    if not len(estimate):
        raise BadNumbers("there is no pose to align")
    from_mean, to_mean = estimate[:, :2].mean(axis=0), truth[:, :2].mean(axis=0)
    source, target = estimate[:, :2] - from_mean, truth[:, :2] - to_mean
    if np.sqrt(np.mean(np.sum(source**2, axis=1))) < _MIN_SPREAD_M:
        turn = truth[:, 2] - estimate[:, 2]
        yaw = np.arctan2(np.sin(turn).sum(), np.cos(turn).sum())
    else:
        cross = np.sum(source[:, 0] * target[:, 1] - source[:, 1] * target[:, 0])
        yaw = np.arctan2(cross, np.sum(source * target))
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.array([*(to_mean - rotation @ from_mean), yaw])


def compare(
    estimate: PlanarTrajectory, truth: PlanarTrajectory, what: str = "the estimate"
) -> TrajectoryErrors:
    """The errors of an estimate after alignment; what: its name in an error message.

    Raises SlamsimError if fewer than two poses can be compared.
    """
    covered = covered_by(truth.stamps_ns, estimate.stamps_ns)
    if np.count_nonzero(covered) < 2:
        raise SlamsimError(
            f"{what} and the truth have fewer than two instants in common: {what} covers "
            f"{span_in_words(estimate.stamps_ns)}, the truth {span_in_words(truth.stamps_ns)}"
        )
    stamps_ns = estimate.stamps_ns[covered]
    true_poses = truth.at(stamps_ns)
    T_truth_estimate = align_se2(estimate.poses[covered], true_poses)
    aligned = compose(T_truth_estimate, estimate.poses[covered])
    return TrajectoryErrors(
        estimate=PlanarTrajectory(stamps_ns, aligned),
        truth=PlanarTrajectory(stamps_ns, true_poses),
        T_truth_estimate=T_truth_estimate,
        translation_m=np.linalg.norm(aligned[:, :2] - true_poses[:, :2], axis=1),
        rotation_rad=wrap_angle(aligned[:, 2] - true_poses[:, 2]),
        uncovered=int(np.count_nonzero(~covered)),
    )


def relative_errors(
    errors: TrajectoryErrors, lengths_m: tuple[float, ...] = SEGMENT_LENGTHS_M
) -> RelativeErrors | None:
    """Mean relative error over every segment that starts at any pose; None if there is none.

    A segment of length L ends at the first pose at which the true path is at least L longer. Its
    error is divided by the true path it really covers. Raises BadNumbers for lengths that are none.
    """
    require_finite("lengths of segments", np.array(lengths_m, dtype=np.float64), (None,))
    if not lengths_m or min(lengths_m) <= 0.0:
        raise BadNumbers(f"segments need lengths above zero, not {lengths_m}")
    path_m = _path_m(errors.truth.poses)
    starts, ends = segments(path_m, lengths_m)
    if starts.size == 0:
        return None
    error = pair_errors(errors.estimate.poses, errors.truth.poses, starts, ends)
    covered_m = path_m[ends] - path_m[starts]
    translation = np.linalg.norm(error[:, :2], axis=1) / covered_m
    rotation = np.abs(error[:, 2]) / covered_m
    return RelativeErrors(
        translation_percent=float(100.0 * translation.mean()),
        rotation_deg_per_m=float(np.rad2deg(rotation.mean())),
        segments=int(starts.size),
    )


def segments(path_m: FloatArray, lengths_m: tuple[float, ...]) -> tuple[IntArray, IntArray]:
    """First and last index of every segment; path_m: (n,) length driven until each pose."""
    starts, ends = [], []
    for length_m in lengths_m:
        end = np.searchsorted(path_m, path_m + length_m, side="left").astype(np.int64)
        start = np.flatnonzero(end < path_m.size)
        starts.append(start)
        ends.append(end[start])
    return np.concatenate(starts).astype(np.int64), np.concatenate(ends).astype(np.int64)


def pair_errors(
    estimate: FloatArray, truth: FloatArray, starts: IntArray, ends: IntArray
) -> FloatArray:
    """(m, 3) ``inverse(true motion) * (estimated motion)`` from each start to each end."""
    true_motion = between(truth[starts], truth[ends])
    return between(true_motion, between(estimate[starts], estimate[ends]))


def _path_m(poses: FloatArray) -> FloatArray:
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def covered_by(truth_ns: IntArray, query_ns: IntArray) -> BoolArray:
    """(m,) which instants (m,) lie at a true sample (n,) or between two that are close enough."""
    if truth_ns.size == 0:
        return np.zeros(query_ns.shape, dtype=np.bool_)
    after = np.searchsorted(truth_ns, query_ns, side="left")
    inside = (query_ns >= truth_ns[0]) & (after < truth_ns.size)
    after = np.minimum(after, truth_ns.size - 1)
    gap_ns = truth_ns[after] - truth_ns[np.maximum(after - 1, 0)]
    exact = truth_ns[after] == query_ns
    return np.asarray(inside & (exact | (gap_ns <= MAX_TRUTH_GAP_S * 1e9)), dtype=np.bool_)


def span_in_words(stamps_ns: IntArray) -> str:
    """From the first of sorted instants to the last, for a message. stamps_ns: (n,)."""
    if stamps_ns.size == 0:
        return "nothing"
    return f"{stamps_ns[0] * 1e-9:.3f} s to {stamps_ns[-1] * 1e-9:.3f} s"
