"""Pairs of scans: laid over each other as well as they can be, and what that tells of them.

Nothing is known of where the two were taken. All turns and shifts are tried at once by Fourier
transforms of the scans as pictures, the best is refined by closest points (Besl & McKay 1992),
and the features say how well, and how surely, the two are then one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from slamsim.core.geometry import inverse, transform_points
from slamsim.core.types import FloatArray, IntArray

REACH_M = 12.0
"""What is farther away is left out: few lidars agree on it."""
MOST_BEAMS = 180
NEAR_M = 0.2
"""Points so near are of one wall."""
FEATURES = (
    "least share of points that fit",
    "mean share of points that fit",
    "least share that fits of what both can see",
    "most share that the other sees through",
    "mean share that the other sees through",
    "distance of points that fit",
    "share of the next best place",
    "difference of distances between points",
    "difference of ranges",
    "least variety of directions",
)
SCORE, RANGES = 1, 8
"""Features that are used alone, too: what a matcher calls its score, and no matching at all."""

_CELL_M, _CELLS, _TURNS = 0.25, 128, 72
_SPACING_M = 0.1
_CANDIDATES, _ROUNDS = 8, 6
_RIVAL_M, _RIVAL_RAD = 1.5, np.radians(20.0)
_BEHIND_M = 0.4
_PAIR_EDGES_M = np.linspace(0.0, 2.0 * REACH_M, 25)
_RANGE_EDGES_M = np.linspace(0.0, REACH_M, 13)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A scan as it is compared: at most MOST_BEAMS beams, nothing beyond REACH_M.

    bearings_rad, ranges_m: (b,) of all beams, ``inf`` without a return. points_m: (n, 2) in the
    frame of the laser, evenly along the walls. picture: Fourier transform of the blurred points.
    """

    bearings_rad: FloatArray
    ranges_m: FloatArray
    points_m: FloatArray
    tree: cKDTree
    picture: NDArray[np.complex64]


class Fit(NamedTuple):
    """How the points of one scan agree with another.

    fits: share that lies on the other's. both: of those that the other could see, the share that
    does. through: of the same, the share where it sees farther. distance_m: mean of those that fit.
    """

    fits: float
    both: float
    through: float
    distance_m: float


def view_of(ranges_m: FloatArray, bearings_rad: FloatArray) -> View | None:
    """Nothing for a scan that sees hardly anything."""
    every = -(-ranges_m.size // MOST_BEAMS)
    thinned_m, bearings_rad = ranges_m[::every], bearings_rad[::every]
    seen = np.isfinite(thinned_m) & (thinned_m > 0.0) & (thinned_m < REACH_M)
    if np.count_nonzero(seen) < 20:
        return None
    thinned_m = np.where(seen, thinned_m, np.inf)
    directions = np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])
    points_m = _evenly(thinned_m[seen, None] * directions[seen])
    blurred = gaussian_filter(_pictures(points_m[None])[0], NEAR_M / _CELL_M)
    picture = scipy.fft.rfft2(blurred / blurred.max())
    return View(bearings_rad, thinned_m, points_m, cKDTree(points_m), picture)


def pair_features(a: View, b: View) -> FloatArray:
    """(len(FEATURES),) of a pair; the same for (b, a) but for rounding of the grids."""
    T_b_a, rival = aligned(a, b)
    fits, both, through, distance_m = np.array(
        [_fit(a, b, T_b_a), _fit(b, a, inverse(T_b_a))], dtype=np.float64
    ).T
    return np.array(
        [
            fits.min(),
            fits.mean(),
            both.min(),
            through.max(),
            through.mean(),
            distance_m.mean(),
            rival,
            _difference(_pair_distances(a), _pair_distances(b)),
            _difference(_range_counts(a), _range_counts(b)),
            min(_variety(a), _variety(b)),
        ]
    )


def aligned(a: View, b: View) -> tuple[FloatArray, float]:
    """``T_b_a``, and the score of the next best place as a share of the best, below 1.

    Of the best places by points that fit, the one where the two see the fewest walls through.
    """
    found = sorted(
        ((_agreement(a, b, T_b_a), tuple(T_b_a)) for T_b_a in _candidates(a, b)), reverse=True
    )
    best = np.array(found[0][1])
    others = (score for score, pose in found if _apart(best, np.array(pose)))
    return best, max(next(others, 0.0), 0.0) / max(found[0][0], 1e-3)


def _candidates(a: View, b: View) -> list[FloatArray]:
    """Refined poses, from the best of the best turns on."""
    yaws = np.arange(_TURNS) * (2.0 * np.pi / _TURNS)
    turned = np.array([transform_points(np.array([0.0, 0.0, yaw]), a.points_m) for yaw in yaws])
    pictures = scipy.fft.rfft2(_pictures(turned))
    scores = scipy.fft.irfft2(np.conj(pictures) * b.picture, s=(_CELLS, _CELLS))
    flat = scores.reshape(_TURNS, -1)
    places, tops = flat.argmax(axis=1), flat.max(axis=1)
    found = list[FloatArray]()
    for turn in np.argsort(-tops, kind="stable"):
        row, column = np.unravel_index(places[turn], (_CELLS, _CELLS))
        shift_m = (np.array([column, row]) + _CELLS // 2) % _CELLS - _CELLS // 2
        guess = np.array([*(shift_m * _CELL_M), yaws[turn]])
        if all(_apart(guess, other) for other in found):
            found.append(guess)
        if len(found) == _CANDIDATES:
            break
    return [_refined(a, b, guess) for guess in found]


def _agreement(a: View, b: View, T_b_a: FloatArray) -> float:
    """Points that fit, less those that are seen through."""
    of_a, of_b = _fit(a, b, T_b_a), _fit(b, a, inverse(T_b_a))
    return min(of_a.fits, of_b.fits) - max(of_a.through, of_b.through)


def _apart(one: FloatArray, other: FloatArray) -> bool:
    turn = abs(np.angle(np.exp(1j * (one[2] - other[2]))))
    return bool(turn > _RIVAL_RAD or np.hypot(*(one - other)[:2]) > _RIVAL_M)


def overlap(a: View, b: View, T_b_a: FloatArray, near_m: float = NEAR_M) -> tuple[float, float]:
    """Share of a's points that b has, and of b's points that a has, at a pose that is known."""
    there = _nearest(b, transform_points(T_b_a, a.points_m))[0] < near_m
    back = _nearest(a, transform_points(inverse(T_b_a), b.points_m))[0] < near_m
    return float(there.mean()), float(back.mean())


def _evenly(points_m: FloatArray) -> FloatArray:
    """One point of each small cell: a near wall does not outweigh a far one."""
    cells = np.floor(points_m / _SPACING_M)
    return points_m[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _pictures(points_m: FloatArray) -> NDArray[np.float32]:
    """(k, cells, cells) of (k, n, 2) points: 1 where any point is, rows along y."""
    cells = np.floor(points_m / _CELL_M).astype(np.int64) % _CELLS
    pictures = np.zeros((len(points_m), _CELLS, _CELLS), dtype=np.float32)
    pictures[np.arange(len(points_m))[:, None], cells[..., 1], cells[..., 0]] = 1.0
    return pictures


def _refined(a: View, b: View, T_b_a: FloatArray) -> FloatArray:
    """A few rounds of closest points, the farther ones left out."""
    for reach_m in np.linspace(0.6, NEAR_M, _ROUNDS):
        moved_m = transform_points(T_b_a, a.points_m)
        distances_m, nearest = _nearest(b, moved_m)
        near = distances_m < reach_m
        if np.count_nonzero(near) < 5:
            return T_b_a
        source, target = a.points_m[near], b.points_m[nearest[near]]
        middles = source.mean(axis=0), target.mean(axis=0)
        x, y = ((source - middles[0]).T @ (target - middles[1])).reshape(2, 2)
        yaw = np.arctan2(x[1] - y[0], x[0] + y[1])
        turned = transform_points(np.array([0.0, 0.0, yaw]), middles[0][None])[0]
        T_b_a = np.array([*(middles[1] - turned), yaw])
    return T_b_a


def _fit(a: View, b: View, T_b_a: FloatArray) -> Fit:
    """Of a's points as b sees them."""
    moved_m = transform_points(T_b_a, a.points_m)
    distances_m = _nearest(b, moved_m)[0]
    fits = distances_m < NEAR_M
    bearings, ranges_m = np.arctan2(moved_m[:, 1], moved_m[:, 0]), np.hypot(*moved_m.T)
    step = float(np.median(np.diff(b.bearings_rad)))
    beams = np.rint((bearings - b.bearings_rad[0]) / step).astype(np.int64)
    viewed = (beams >= 0) & (beams < b.ranges_m.size) & (ranges_m < REACH_M)
    seen_m = b.ranges_m[np.clip(beams, 0, b.ranges_m.size - 1)]
    seen = viewed & np.isfinite(seen_m) & (ranges_m < seen_m + _BEHIND_M)
    through = seen & ~fits & (seen_m > ranges_m + _BEHIND_M)
    count = max(int(np.count_nonzero(seen)), 1)
    return Fit(
        fits=float(fits.mean()),
        both=float(np.count_nonzero(fits & seen)) / count,
        through=float(np.count_nonzero(through)) / count,
        distance_m=float(distances_m[fits].mean()) if fits.any() else NEAR_M,
    )


def _nearest(view: View, points_m: FloatArray) -> tuple[FloatArray, IntArray]:
    distances_m, places = view.tree.query(points_m)
    return np.asarray(distances_m), np.asarray(places)


def _pair_distances(view: View) -> FloatArray:
    """Histogram of the distances between its points: no turn or shift changes it."""
    some = view.points_m[::2]
    distances_m = np.hypot(*(some[:, None] - some[None]).reshape(-1, 2).T)
    return np.asarray(np.histogram(distances_m, _PAIR_EDGES_M)[0] / distances_m.size)


def _range_counts(view: View) -> FloatArray:
    return np.asarray(np.histogram(view.ranges_m, _RANGE_EDGES_M)[0] / view.ranges_m.size)


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.abs(one - other).sum())


def _variety(view: View) -> float:
    """0 where all walls run one way, 1 where they stand crosswise in equal parts."""
    steps_m = np.diff(view.points_m, axis=0)
    lengths_m = np.hypot(*steps_m.T)
    along = steps_m[(lengths_m > 0.0) & (lengths_m < 0.5)]
    if len(along) < 2:
        return 0.0
    small, large = np.linalg.eigvalsh(along.T @ along)
    return float(2.0 * small / (small + large))
