"""All scans of a window and all surfaces they share solved at once, and the shape of the scans.

Surfaces are lines that may bend, refitted at every pose (variable projection, Golub & Pereyra 1973)
and eliminated as in ``models.line_bundle``. What pulls at the shape of all scans is left when
the poses have been eliminated too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr, stdtrit

from slamsim.core.geometry import compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.models.line_bundle import fit_lines
from slamsim.slam.backend.association import Shared, share_surfaces
from slamsim.slam.laser.calibration import ANGLE_SCALE, PRIOR_SIGMAS, RANGE_OFFSET, SWEEP
from slamsim.slam.laser.scan_bends import bent_residuals, fit_bends
from slamsim.slam.laser.scan_equations import POSE, SHAPES, moved_points, window_system
from slamsim.slam.laser.scan_observations import Observations, observations
from slamsim.slam.laser.scan_sweep import Sweep, beams_of, local_motion, moved_pieces
from slamsim.slam.laser.scan_track import LaserTrack

ROUNDS = ((0.06, 12.0, 3), (0.03, 4.0, 6))
"""Associations: how far apart across a surface its observations may lie, from how many standard
deviations on they are doubted, and how many steps are taken."""

GATE_NOISE = 4.0
"""They may lie apart by so many standard deviations of a range in any case."""

FAINT = 1.0
"""Information on a step of a pose that nothing else holds: metres and radians."""

MEDIAN_CHI2 = 2.0 * np.log(2.0)
"""Of the two distances that a piece has from its line."""

SMALL_STEP = 5e-5
LEAST_REDUNDANCY = 0.2
INLIER_SIGMAS = 4.0
OTHER_SIGMAS = 2.5
OTHER_SHAPE = np.array([5e-4, 2e-4, 2e-3])
"""A number of the shape is unknown if the scans contradict it by so many standard deviations, and
by so many seconds, by such a share of the angle, or by so many metres: poses feel no less. If one
lidar in ten is wrong by the priors of ``calibration``, the number found is then nearer to the truth
on average than the declared one. What the scans tell less surely than these priors counts in
part: with few beams and 5 cm steps an offset of 4 cm also bent the angles, by 2.8 +- 0.7 %."""
SHAPE_PRIOR_SIGMAS = PRIOR_SIGMAS[[SWEEP, ANGLE_SCALE, RANGE_OFFSET]]

MADE_UP_TIMES, LEAST_LEFT = 4.0, 1e-3
"""Information of which a quarter is made up is not believed at all, but for this share."""

STILL_SIGMAS = 0.5
MAX_STEP = np.array([0.25, 0.1, 0.5])
"""Seconds of the sweep, relative angle, metres: the shape moves no further at a time."""


@dataclass(frozen=True, slots=True)
class Shape:
    """sweep_s: from the first beam to the last. angle_scale: true over taken angle between beams.
    range_offset_m: by how much ranges are too long."""

    sweep_s: float
    angle_scale: float
    range_offset_m: float

    @property
    def numbers(self) -> FloatArray:
        """(3,) all of it."""
        return np.array([self.sweep_s, self.angle_scale, self.range_offset_m])

    def of(self, sweep: Sweep) -> tuple[float, float, float]:
        """As ``moved_pieces`` takes it."""
        return self.sweep_s, (self.angle_scale - 1.0) * sweep.span_rad, self.range_offset_m

    def moved(self, step: FloatArray) -> Shape:
        """Another shape, a step (3,) away, or as far as it goes at a time."""
        numbers = self.numbers + np.clip(step, -MAX_STEP, MAX_STEP)
        return Shape(*numbers.tolist())


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """A window solved for a given shape.

    poses: (n, 3). inner: (3n - 3, 3n - 3) information of small steps of each laser but the first in
    its own frame; made_up: that which the noise of lines adds to it. inlier_share: (n,).
    information, pull: (3, 3) and (3,) of a step of the shape with the poses following; by_shape:
    (3n - 3, 3) how they follow it. unit: variance of residuals over what was expected.
    """

    poses: FloatArray
    inner: FloatArray
    made_up: FloatArray
    inlier_share: FloatArray
    information: FloatArray
    pull: FloatArray
    by_shape: FloatArray
    unit: float

    def covariance(self) -> FloatArray:
        """(3n, 3n) of small steps of each laser in its own frame, the first being exact."""
        size = POSE * len(self.poses)
        covariance = np.zeros((size, size))
        covariance[POSE:, POSE:] = _believable(self.inner, self.made_up)
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class ShapePull:
    """What all windows (w) say of the shape: information (w, 3, 3) and pull (w, 3)."""

    information: FloatArray
    pull: FloatArray

    @staticmethod
    def of(fits: list[WindowFit]) -> ShapePull:
        """From the fits of all windows."""
        information = np.array([fit.information for fit in fits]).reshape(-1, SHAPES, SHAPES)
        return ShapePull(information, np.array([fit.pull for fit in fits]).reshape(-1, SHAPES))

    def step(self, free: BoolArray | None = None) -> FloatArray:
        """(3,) what all windows together want; free: (3,) which numbers may move, None for all."""
        which = np.arange(SHAPES) if free is None else np.flatnonzero(free)
        total = self.information.sum(axis=0)[np.ix_(which, which)]
        step = np.zeros(SHAPES)
        step[which] = np.linalg.pinv(total, hermitian=True) @ self.pull.sum(axis=0)[which]
        return step

    def sigmas(self) -> FloatArray:
        """(3,) standard deviations by the scatter of the windows (sandwich)."""
        total, count = self.information.sum(axis=0), len(self.pull)
        if count < 3:
            return np.full(SHAPES, np.inf)
        bread = np.linalg.pinv(total, hermitian=True)
        left = self.pull - self.information @ self.step()
        meat = left.T @ left * (count / (count - 1.0))
        plain, robust = np.diag(bread), np.diag(bread @ meat @ bread)
        return np.asarray(np.sqrt(np.maximum(np.maximum(plain, robust), 1e-18)))

    def doubts(self, shape: Shape, declared: Shape, unmodelled: FloatArray) -> FloatArray:
        """(3,) how far the numbers are from the declared, as multiples of what scans may say of
        right ones; unmodelled: (3,) by what they come out wrong beyond noise."""
        sigmas = np.hypot(self.sigmas(), unmodelled)
        allowed = np.maximum(as_sure_as(OTHER_SIGMAS, len(self.pull)) * sigmas, OTHER_SHAPE)
        off = np.abs(shape.numbers + self.step() - declared.numbers)
        believed = SHAPE_PRIOR_SIGMAS**2 / (SHAPE_PRIOR_SIGMAS**2 + sigmas**2)
        return np.asarray(believed * off / allowed)

    def still(self, step: FloatArray) -> bool:
        """Whether another step (3,) of the shape is not worth its while."""
        return bool((np.abs(step) <= STILL_SIGMAS * self.sigmas()).all())


def as_sure_as(sigmas: float, windows: int) -> float:
    """So many sigmas, themselves estimated from the scatter of few windows, are as rare as the
    given number of known ones (Student's distribution)."""
    return float(stdtrit(max(windows - 1, 1), ndtr(sigmas)))


def fit_window(track: LaserTrack, shape: Shape, poses: FloatArray | None = None) -> WindowFit:
    """The most likely poses of a window's scans if they are of this shape.

    poses: (n, 3) those of a fit for a shape much like it, to begin from.
    """
    seen = observations(track)
    rounds = ROUNDS if poses is None else ROUNDS[-1:]
    poses = track.poses if poses is None else poses
    for gate_m, doubted, steps in rounds:
        shared = _shared(track, poses, shape, max(gate_m, GATE_NOISE * track.noise_m))
        used = seen.only(shared.pieces)
        for _ in range(steps):
            step, fit = _solve(used, shared, poses, shape, track.elapsed_s, doubted)
            poses = compose(poses, step)
            if np.abs(step).max() < SMALL_STEP:
                break
    return replace(fit, poses=poses)


def fit_windows(
    tracks: list[LaserTrack], shape: Shape, begun: list[WindowFit] | None = None
) -> list[WindowFit]:
    """All windows with one shape, from where scan after scan was laid, or from earlier fits."""
    starts = [None] * len(tracks) if begun is None else [fit.poses for fit in begun]
    return [fit_window(t, shape, poses) for t, poses in zip(tracks, starts, strict=True)]


def _shared(track: LaserTrack, poses: FloatArray, shape: Shape, gate_m: float) -> Shared:
    """Which pieces are of one surface, as seen from the middle of each sweep."""
    motion = local_motion(poses, track.elapsed_s)
    moved = [
        moved_pieces(piece, beams_of(piece, sweep), own, shape.of(sweep))
        for piece, sweep, own in zip(track.pieces, track.sweeps, motion, strict=True)
    ]
    sure = 1e-8 * np.eye(3)
    chain = [GraphEdge(k, k + 1, np.zeros(3), sure, "match") for k in range(len(poses) - 1)]
    return share_surfaces([one.astype(np.float32) for one in moved], poses, gate_m, chain)


def _solve(
    seen: Observations,
    shared: Shared,
    poses: FloatArray,
    shape: Shape,
    elapsed_s: FloatArray,
    doubted: float,
) -> tuple[FloatArray, WindowFit]:
    """A step of Gauss and Newton (n, 3), the first pose held, and what the fit is worth."""
    beams, motion = (seen.shares, seen.angles, seen.views), local_motion(poses, elapsed_s)
    numbers = shape.sweep_s, shape.angle_scale, shape.range_offset_m
    points, change = moved_points(seen.points, beams, poses, motion, numbers)
    weights = 0.5 / seen.variance
    off, of_surfaces = bent_residuals(points, weights, shared.starts)
    chi2 = np.square(off).sum(axis=1) * weights
    unit = _unit_variance(chi2, of_surfaces - 2.0 + POSE * len(poses))
    weights = weights / unit / np.square(1.0 + chi2 / unit / doubted**2)
    lines = fit_lines(points, weights, shared.starts)
    bends = fit_bends(points, weights, shared.starts, lines)
    system, right = window_system(
        (points, change, weights, seen.views),
        *(shared.surfaces, shared.starts, lines, bends, len(poses)),
    )
    inside = chi2 / unit < INLIER_SIGMAS**2
    inliers = np.bincount(seen.views, inside, len(poses)) / np.maximum(
        np.bincount(seen.views, minlength=len(poses)), 1
    )
    made_up = _made_up(points, change, weights, (seen.views, shared.surfaces, lines), len(poses))
    return _reduced(system, right, made_up, poses, (unit, inliers))


def _unit_variance(chi2: FloatArray, unknowns: float) -> float:
    """By how much the misfits exceed their variances; 1 where no scan shares a surface."""
    if len(chi2) == 0:
        return 1.0
    redundancy = max(1.0 - unknowns / (2.0 * len(chi2)), LEAST_REDUNDANCY)
    return float(max(np.median(chi2) / MEDIAN_CHI2 / redundancy, 1e-3))


def _made_up(
    points: FloatArray,
    change: FloatArray,
    weights: FloatArray,
    of: tuple[IntArray, IntArray, FloatArray],
    count: int,
) -> FloatArray:
    """(3 count, 3 count) what the noise of the lines' directions adds to the information.

    Lines that are not quite parallel hold a scan along a corridor, where nothing does.
    """
    views, surfaces, lines = of
    normal, middle = lines[:, 2:], lines[:, :2]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)[surfaces]
    along = ((points - middle[surfaces][:, None]) * tangent[:, None]).sum(axis=2)
    turn = np.bincount(surfaces, weights * np.square(along).sum(axis=1), len(lines))
    share = weights / np.maximum(turn, 1e-9)[surfaces]
    rows = (change[:, :, :POSE] * tangent[:, None, None]).sum(axis=3)
    blocks = np.zeros((count, POSE, POSE))
    np.add.at(blocks, views, np.einsum("k,kei,kej->kij", share, rows, rows))
    made_up = np.zeros((POSE * count, POSE * count))
    for k in range(count):
        made_up[POSE * k : POSE * k + POSE, POSE * k : POSE * k + POSE] = blocks[k]
    return made_up


def _believable(information: FloatArray, made_up: FloatArray) -> FloatArray:
    """The covariance (d, d) that is left when made-up information is taken away. Eigenvectors, for
    which BLAS keeps all processors busy, are needed only where hardly anything is left."""
    try:
        np.linalg.cholesky((1.0 - LEAST_LEFT) * information - MADE_UP_TIMES * made_up)
    except np.linalg.LinAlgError:
        return _spectrally_believable(information, made_up)
    return np.asarray(np.linalg.inv(information - MADE_UP_TIMES * made_up))


def _spectrally_believable(information: FloatArray, made_up: FloatArray) -> FloatArray:
    """The same, with ``LEAST_LEFT`` in directions of which nearly all is made up."""
    root = np.linalg.inv(np.linalg.cholesky(information))
    shares, axes = np.linalg.eigh(root @ made_up @ root.T)
    left = np.maximum(1.0 - MADE_UP_TIMES * shares, LEAST_LEFT)
    whitened = axes.T @ root
    return np.asarray(whitened.T @ (whitened / left[:, None]))


def _reduced(
    system: FloatArray,
    right: FloatArray,
    made_up: FloatArray,
    poses: FloatArray,
    quality: tuple[float, FloatArray],
) -> tuple[FloatArray, WindowFit]:
    """Poses from the whole system, and what is left for the shape."""
    size = len(made_up)
    free, ours = slice(POSE, size), slice(size, None)
    inner = system[free, free] + np.eye(size - POSE) * FAINT
    both = cho_solve(cho_factor(inner), np.column_stack([right[free], system[free, ours]]))
    step = np.concatenate([np.zeros(POSE), both[:, 0]]).reshape(-1, POSE)
    fit = WindowFit(
        poses=poses,
        inner=inner,
        made_up=made_up[free, free],
        information=system[ours, ours] - system[ours, free] @ both[:, 1:],
        pull=right[ours] - system[ours, free] @ both[:, 0],
        by_shape=-both[:, 1:],
        unit=quality[0],
        inlier_share=quality[1],
    )
    return step, fit
