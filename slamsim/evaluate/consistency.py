"""Consistency of an estimate with its covariance (NEES).

Normalised estimation error squared (NEES; Bar-Shalom, Li & Kirubarajan 2001, "Estimation with
Applications to Tracking and Navigation", section 5.4): the squared error in units of the covariance
that was claimed. If the covariance is true, it follows the chi-square distribution with as many
degrees of freedom as a pose has. All key frames of a run share the errors of its first, so one run
says little of its own mean: the band is for the mean over many independent runs, as if each had but
one key frame. A run's mean over its path has the same expectation as the NEES of any one of its
key frames and no larger variance, so that the band is on the safe side for it: true covariances
leave it in less than one of twenty campaigns. Relative to the map as a whole, errors of places far
apart are nearly independent, and one run of a long path says much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, compose
from slamsim.core.quantiles import chi_square
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory
from slamsim.evaluate.trajectory import align_se2, covered_by
from slamsim.guard.numbers import require_covariances, require_number, require_whole, solving

DEGREES_OF_FREEDOM = 3
"""x, y and yaw: what NEES is on average if the covariances are true."""

INSIDE_SHARE = 0.95
"""Of the poses that should lie within their own ellipse of that content."""

LEAST_COVERED_SHARE = 0.95
"""Of key frames, by the truth: with true covariances of odometry along two loops, the mean within
the map is 3.1 where so many are covered, as where all are, but 1.9 where half of them are."""


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """Errors of key frames, relative to the first or to the map, and what was claimed of them.

    stamps_ns: (k,). errors: (k, 3) of x, y (m) and yaw (rad), estimate minus truth, in the
    estimated frame of the base at that key frame. sigmas: (k, 3) claimed standard deviations of
    the same. nees: (k,).
    """

    stamps_ns: IntArray
    errors: FloatArray
    sigmas: FloatArray
    nees: FloatArray

    @property
    def mean(self) -> float:
        """DEGREES_OF_FREEDOM if the covariances are true, more for an estimate too sure."""
        return float(self.nees.mean())

    @property
    def inside_share(self) -> float:
        """Of the poses within their 95 % ellipse."""
        return float(np.mean(self.nees <= chi_square(INSIDE_SHARE, DEGREES_OF_FREEDOM)))


def nees(
    keyframes: PlanarTrajectory, covariances: FloatArray, truth: PlanarTrajectory
) -> Consistency | None:
    """keyframes: ``T_map_base`` (n,). covariances: (n, 3, 3) of a small step of the base in its own
    frame, relative to the first key frame, which has none. truth: ``T_truth_base``.

    Looks at all key frames but the first that the truth covers; None if these are fewer than two,
    or the truth does not cover the first. Raises BadNumbers for what is no covariance, NoSolution
    for one that is sure of a direction.
    """
    require_covariances("the covariances of key frames", covariances, (len(keyframes), 3, 3))
    covered = covered_by(truth.stamps_ns, keyframes.stamps_ns)
    if len(keyframes) < 2 or not covered[0] or np.count_nonzero(covered) < 3:
        return None
    later = np.flatnonzero(covered)[1:]
    true_poses = truth.at(keyframes.stamps_ns[np.append(0, later)])
    true_way = between(true_poses[0], true_poses[1:])
    errors = between(true_way, between(keyframes.poses[0], keyframes.poses[later]))
    return _compared(keyframes.stamps_ns[later], errors, covariances[later])


def nees_in_map(
    keyframes: PlanarTrajectory, covariances: FloatArray, truth: PlanarTrajectory
) -> Consistency | None:
    """The same of covariances relative to the map as a whole, laid onto the truth as for the ATE.

    Looks at all key frames that the truth covers; None if these are fewer than three, which leave
    nothing to compare once they are aligned, or if too many are missing: a part of a map that is
    aligned by itself is off by less than in the map as a whole. covariances: (n, 3, 3) in m and
    rad.
    """
    require_covariances("the covariances within the map", covariances, (len(keyframes), 3, 3))
    covered = covered_by(truth.stamps_ns, keyframes.stamps_ns)
    if np.count_nonzero(covered) < max(3, LEAST_COVERED_SHARE * len(keyframes)):
        return None
    stamps_ns = keyframes.stamps_ns[covered]
    true_poses, poses = truth.at(stamps_ns), keyframes.poses[covered]
    errors = between(true_poses, compose(align_se2(poses, true_poses), poses))
    return _compared(stamps_ns, errors, covariances[covered])


def _compared(stamps_ns: IntArray, errors: FloatArray, claimed: FloatArray) -> Consistency:
    with solving("the consistency of the key frames"):
        np.linalg.cholesky(claimed)
        weighted = np.linalg.solve(claimed, errors[:, :, None])[:, :, 0]
    return Consistency(
        stamps_ns=stamps_ns,
        errors=errors,
        sigmas=np.sqrt(np.diagonal(claimed, axis1=1, axis2=2)),
        nees=(errors * weighted).sum(axis=1),
    )


def nees_band(runs: int, share: float = INSIDE_SHARE) -> tuple[float, float]:
    """Within which the mean NEES of one instant over so many independent runs lies with that
    probability, if the covariances are true. Raises BadNumbers."""
    require_whole("the number of runs", runs, 1)
    require_number("the share within the band", share, 1e-9, 1.0 - 1e-9)
    freedom = DEGREES_OF_FREEDOM * runs
    tails = np.array([0.5 * (1.0 - share), 0.5 * (1.0 + share)])
    low, high = (chi_square(tails, freedom) / runs).tolist()
    return low, high
