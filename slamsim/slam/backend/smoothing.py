"""All scans' poses at once, from their matches and the odometry between them.

One scan's match is blurred by the noise of its own beams; the odometry of a few steps is not, and
drifts instead. The best of both is the maximum of their joint likelihood: a chain of poses, so that
its normal equations are block-tridiagonal and solved forwards and back in linear time (Rauch, Tung
& Striebel 1965, in information form). How far to believe each side is learnt from the log
itself: variance components by restricted maximum likelihood (Foerstner 1979), one for the matches
and one for each direction of the odometry, and Student's t for single bad matches and slips
(Lange, Little & Taylor 1989).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.numbers import FINITE, require_covariances, require_finite
from slamsim.slam.backend.chain import newton_round

FREEDOM = 4.0
"""Degrees of freedom of Student's t: the smaller, the less a large residual counts."""

WIDE_FREEDOM = 1e4
NARROWING = 8.0
"""A bad match looks like two slips, there and back: at first everything counts as it is."""

INIT_STEPS = 10
INIT_LEAST = 0.01
"""First scales compare steps over one scan with steps over INIT_STEPS: the drift of the odometry
grows with their number, the noise of a match does not. Where nothing is seen to grow, this share of
the difference over one scan is taken for drift."""
INIT_SHARE = 0.75
INIT_SIGMAS = 1.1503
"""A robust variance: the INIT_SHARE quantile of the size of a normal number is INIT_SIGMAS sigmas.
A quarter of the steps may be wrong."""
MAX_ROUNDS = 40
CONVERGED_LOG = 0.02
CONVERGED_STEP = 1e-5
"""Rounds end when no scale changes by more than 2 % and no pose by more than 10 um or 10 urad, far
below any error of a scan."""
FLOOR_M = 1e-5
FLOOR_RAD = 1e-5
"""Least standard deviation of a step of the odometry, whatever is learnt of its noise: a standing
robot would otherwise give a singular covariance, and one that hardly any scan holds against it a
covariance of rounding."""
ARM_M = 0.1
CREEP_M_S = 0.01
"""What counts as path beside the way of the base: a turn, as that of a point so far from the axle
(about half the distance of the wheels), and time, in which a standing robot may still be pushed."""
WALK_M_PER_SQRT_M = 0.002
WALK_RAD_PER_SQRT_M = 0.001
WALK_RAD_PER_SQRT_S = 0.0006
"""Shape of the covariance of a step, as random walks over path and time: 2 mm and 1 mrad after a
metre, 0.6 mrad after a second of a turning robot. Only their ratios matter: the size in each
direction is learnt from each log."""
SCALE_BOUNDS = (1e-6, 1e4)
"""Of the learnt variances over the claimed ones, far beyond any that was seen, so that a log
without noise stays finite."""
RANK_SHARE = 1e-9
"""Of the largest eigenvalue: below it a direction is not seen by a match at all, but for
rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """What the front end measured.

    track: (n) ``T_map_base`` about which the matches are linear. information: (n, 3, 3) of each
    match and pull: (n, 3): the scan alone wants the step ``d`` with ``information @ d = pull``.
    Both are zero where nothing was matched. steps: (n - 1, 3) ``T_before_after`` of the
    odometry; noise: (n - 1, 3, 3) their covariance, up to a factor for each direction.
    """

    track: PlanarTrajectory
    information: FloatArray
    pull: FloatArray
    steps: FloatArray
    noise: FloatArray

    def __post_init__(self) -> None:
        count = len(self.track)
        require_finite("the information of a chain", self.information, (count, 3, 3), FINITE)
        require_finite("the pull of a chain", self.pull, (count, 3), FINITE)
        require_finite("the steps of a chain", self.steps, (count - 1, 3))
        require_covariances("the noise of a chain", self.noise, (count - 1, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """track: ``T_map_base`` of all scans. covariances: (n, 3, 3) of a small step of the base in its
    own frame, relative to the local map. match_scale: variance of the matches over what they
    claimed; motion_scale: (3,) that of the odometry along, across and in heading. drift: (n - 1, 3,
    3) covariance of each step of the odometry, of the base at its end: large where it slipped."""

    track: PlanarTrajectory
    covariances: FloatArray
    drift: FloatArray
    match_scale: float
    motion_scale: FloatArray

    def __post_init__(self) -> None:
        shape = (len(self.track), 3, 3)
        require_covariances("the covariances of smoothed scans", self.covariances, shape)
        require_finite("the drift of smoothed scans", self.drift, (shape[0] - 1, 3, 3), FINITE)


def smooth(chain: Chain) -> Smoothed:
    """The most likely track given all matches and the odometry between them."""
    offsets, ranks = _offsets(chain.information, chain.pull)
    claimed, matched = _scaled(chain.noise, np.ones(3)), compose(chain.track.poses, offsets)
    scales = np.append(1.0, _first_scales(matched, chain.steps, claimed))
    measured = (chain.track.poses, chain.information, offsets, ranks)
    poses, covariances = chain.track.poses.copy(), np.zeros((len(chain.track), 3, 3))
    for number in range(MAX_ROUNDS):
        freedom = max(FREEDOM, WIDE_FREEDOM / NARROWING**number)
        believed = np.asarray(np.linalg.inv(_scaled(chain.noise, scales[1:])), dtype=np.float64)
        odometry = (chain.steps, believed)
        moves, learnt = newton_round(poses, measured, odometry, (scales[0], freedom), covariances)
        poses = compose(poses, moves)
        if freedom > FREEDOM:
            continue  # what is still to be weighed down would be learnt as noise
        # Half the way: squares and freedom follow the weights, and would swing about them.
        factor = np.clip(np.sqrt(learnt), 0.5, 2.0)
        renewed = np.clip(scales * factor, *SCALE_BOUNDS)
        change = np.abs(np.log(renewed / scales)).max()
        scales = renewed
        if change < CONVERGED_LOG and np.abs(moves).max() < CONVERGED_STEP:
            break
    track = PlanarTrajectory(chain.track.stamps_ns, poses)
    drift = _drift(poses, chain.steps, _scaled(chain.noise, scales[1:]))
    return Smoothed(track, covariances, drift, float(scales[0]), scales[1:])


def odometry_steps(odometry: PlanarTrajectory) -> tuple[FloatArray, FloatArray]:
    """(n - 1, 3) steps between the poses of ``T_odom_base``, and the shape of their covariance.

    Errors of wheels and gyroscopes add up over path, turn and time as random walks do; no turn at
    all is one that is known to be none.
    """
    steps = between(odometry.poses[:-1], odometry.poses[1:])
    seconds = np.diff(odometry.stamps_ns) * 1e-9
    work_m = np.hypot(steps[:, 0], steps[:, 1]) + ARM_M * np.abs(steps[:, 2]) + CREEP_M_S * seconds
    noise = np.zeros((len(steps), 3, 3))
    noise[:, 0, 0] = noise[:, 1, 1] = work_m * WALK_M_PER_SQRT_M**2
    turning_s = np.where(steps[:, 2] != 0.0, seconds, 0.0)
    noise[:, 2, 2] = work_m * WALK_RAD_PER_SQRT_M**2 + turning_s * WALK_RAD_PER_SQRT_S**2
    return steps, noise


def _scaled(noise: FloatArray, scales: FloatArray) -> FloatArray:
    """(n - 1, 3, 3) covariance of the steps by the size of their noise in each direction."""
    root, floor = np.sqrt(scales), np.diag(np.square([FLOOR_M, FLOOR_M, FLOOR_RAD]))
    return np.asarray(noise * np.outer(root, root) + floor)


def _drift(poses: FloatArray, steps: FloatArray, noise: FloatArray) -> FloatArray:
    """(n - 1, 3, 3) covariance of the steps by the weights of Student's t."""
    off = between(steps, between(poses[:-1], poses[1:]))
    squared = (off * np.linalg.solve(noise, off[:, :, None])[:, :, 0]).sum(axis=1)
    return np.asarray(noise * ((FREEDOM + squared) / (FREEDOM + 3.0))[:, None, None])


def _first_scales(matched: FloatArray, steps: FloatArray, noise: FloatArray) -> FloatArray:
    """(3,) variance of the odometry over what it claims, from how its difference to the matches
    grows: that of a few steps has the noise of more odometry, and of as few matches, as one's.
    """
    count = len(matched)
    if count < 3 * INIT_STEPS:
        return np.ones(3)
    ahead = steps[: count - INIT_STEPS]
    short = _size(between(ahead, between(matched[:-INIT_STEPS], matched[1 : 1 - INIT_STEPS])))
    for later in range(1, INIT_STEPS):
        ahead = compose(ahead, steps[later : count - INIT_STEPS + later])
    long = _size(between(ahead, between(matched[:-INIT_STEPS], matched[INIT_STEPS:])))
    grown = np.maximum(long - short, INIT_LEAST * short) / (INIT_STEPS - 1)
    claimed = np.median(np.diagonal(noise, axis1=1, axis2=2), axis=0)
    return np.clip(grown / claimed, *SCALE_BOUNDS)


def _size(off: FloatArray) -> FloatArray:
    """(3,) variance of normal numbers whose INIT_SHARE quantile is as large.

    Begun with too little noise of the odometry, the search would end where it explains whole
    stretches of good matches away.
    """
    return np.asarray(np.square(np.quantile(np.abs(off), INIT_SHARE, axis=0) / INIT_SIGMAS))


def _offsets(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) the step that each scan alone wants, and (n,) in how many directions it wants any."""
    values, axes = np.linalg.eigh(information)
    held = values > RANK_SHARE * values[:, -1:]
    inverse = np.where(held, 1.0 / np.where(held, values, 1.0), 0.0)
    along = np.einsum("nik,ni->nk", axes, pull) * inverse
    return np.einsum("nik,nk->ni", axes, along), held.sum(axis=1).astype(np.float64)
