"""Corners of a square tag from lines through its four edges.

The edge is where the brightness rises across it, found at about every pixel along the edge and
far from the corners; lines through these points meet in the corners. OpenCV's own refinements
look at the corner alone, which blur rounds off: in images of tags 20 to 40 px wide, blurred by
0.7 px with noise of 2 of 255, they are off by 0.38 px (CORNER_REFINE_SUBPIX, 0.3 px of it inwards),
0.62 (CONTOUR) and 0.46 px (APRILTAG), and these lines by 0.05 px
(``tests/perception/test_tags.py`` has the sweep).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, Float32Array, FloatArray

ROUNDS = 3
"""Each looks across the edge that the last one found; the third moves corners by less than a
hundredth of a pixel."""
NEAR_ROUNDS = 2
"""After these, by the area below the edge instead of by steps, which JPEG's noise moves outwards:
corners by 0.04 px."""
STEP_PX = 0.25
"""Between two looks at the brightness across an edge."""
REACH_PX = (1.5, 3.5)
"""How far across an edge is looked: 0.8 of a cell of the tag, within these bounds."""
REACH_CELLS = 0.8
LEAST_HALF_PX, HALF_WIDTHS, LEVEL_SAMPLES = 1.0, 2.0, 3
RISEN = (0.16, 0.5, 0.84)
"""Shares of the rise between whose places lie a standard deviation of a normal blur each."""
"""The rise lies within so many of its standard deviations to both sides; beyond, and in so many
samples at least, brightness is that of black and of white."""
END_SHARE, END_PX = 0.15, 1.5
"""What is left out at both ends of an edge, of its length and at least."""
LEAST_POINTS = 4
LEAST_AHEAD = 0.05
"""Of the length of a ray, along the optical axis: of one farther aside x / z tells nothing."""
LEAST_SIDE_PX = 10.0
"""A tag of eight cells has cells of 1.25 pixels then; of smaller ones OpenCV finds few."""
BLURRED_CELLS, BLURRED_SHARE = 0.18, 0.22
"""An edge whose rise is wider (standard deviation) than so many cells of the tag is shifted by what
lies behind the border; the shift has this share of the excess as its standard deviation (sweep of
2,400 edges: 0.6, 1.9, 3.2 and 4.0 % of a cell at widths of 0.225, 0.275, 0.325 and 0.375)."""
CELLS_ALONG = 6.0
"""The shift by what lies behind differs from cell to cell, of which so many lie along an edge."""
HUBER_SIGMAS = 2.0
WEIGHING_ROUNDS = 4
FLOOR_PX = 0.01
"""Noise of a point of an edge however clean the image is: sampling of pixels, shading of the edge.
Below it, the lines' residuals do not fall in images without noise."""
SHIFT_FLOOR_PX = 0.006
"""Least standard deviation by which a whole edge is shifted: so much was measured where a lens
bends the edge; no lens is known better."""
PIECE_SHIFT_PX, PIECE_PX = 0.03, 8.0
"""By how much each piece of an edge of that length is shifted, which does not average out over its
points. It is not of JPEG's doing: about 43 positions of tags in five rendered worlds have squared
errors, in their covariances, of 2.5 in PNG images and 3.0 in JPEG, where 3 are true, and of 9.7 and
9.4 without it. By 210 tags in 20 rendered worlds, other ones than those of ``bench cameras``
(``tag_nees``)."""
CORRELATED_POINTS = 1.35
"""Points of an edge a pixel apart are not independent: they share pixels and blur. With a variance
so many times that of independent points, corners have the errors that they claim."""


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of one tag without lens distortion.

    rays_xy: (4, 2) of each corner, x / z and y / z in the optical frame, beginning top left,
    clockwise as one looks at the tag. covariance: (8, 8) of these. pixels: (4, 2) in the image as
    it is, distorted. asymmetry: see ``_asymmetry``, the mean of the edges; nan where none tells.
    """

    rays_xy: FloatArray
    covariance: FloatArray
    pixels: FloatArray
    asymmetry: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class _Edge:
    """points_px: (n, 2) where brightness rises across it. shift_px: standard deviation by which
    all of them may be shifted alike. asymmetry: of the rise, nan where it cannot be told."""

    points_px: FloatArray
    shift_px: float
    asymmetry: float


def refine_corners(
    grey: Float32Array, rough_px: FloatArray, cells: int, model: CameraModel
) -> Corners | None:
    """The corners of a tag that was found at rough_px (4, 2) in grey (h, w).

    cells: of the tag from side to side, its border included. None for a tag that is too small, or
    whose edges cannot be made out.
    """
    pixels = rough_px.astype(np.float64)
    found = None
    for number in range(ROUNDS + NEAR_ROUNDS):
        if _shortest_side(pixels) < LEAST_SIDE_PX:
            return None
        found = _crossings(grey, pixels, cells, model, is_near=number >= ROUNDS)
        if found is None:
            return None
        pixels = found.pixels
    return found


def _shortest_side(pixels: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1).min())


def _crossings(
    grey: Float32Array, pixels: FloatArray, cells: int, model: CameraModel, *, is_near: bool
) -> Corners | None:
    """Lines through the edges, straight once the lens is taken out, and where they cross."""
    ahead = model.rays_at(pixels)
    if not (np.isfinite(ahead).all() and (ahead[:, 2] > LEAST_AHEAD).all()):
        return None
    lines, covariances, asymmetries = [], [], []
    for k in range(4):
        square, ends = np.roll(pixels, -k, axis=0), np.roll(ahead, -k, axis=0)[:2]
        ends_xy = ends[:, :2] / ends[:, 2:]
        edge = _edge(grey, square, ends_xy, cells, model, is_near=is_near)
        if edge is None:
            return None
        rays = model.rays_at(edge.points_px)
        seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > LEAST_AHEAD)
        if np.count_nonzero(seen) < LEAST_POINTS:
            return None
        points = rays[seen, :2] / rays[seen, 2:]
        pixel = _pixel(square, ends_xy, model)
        line, covariance = _fit_line(points, edge.shift_px * pixel, FLOOR_PX * pixel)
        lines.append(line)
        covariances.append(covariance)
        asymmetries.append(edge.asymmetry)
    told = [each for each in asymmetries if np.isfinite(each)]
    corners = _corners(lines, covariances, model)
    return replace(corners, asymmetry=float(np.mean(told))) if corners and told else corners


def _pixel(square: FloatArray, ends_xy: FloatArray, model: CameraModel) -> float:
    """By how much rays (x / z, y / z) change in a pixel across the first edge of square (4, 2): far
    from the middle of a wide image by several times as much as in it."""
    along, along_xy = square[1] - square[0], ends_xy[1] - ends_xy[0]
    middle, half = 0.5 * (square[0] + square[1]), 0.5 * along[::-1] * [1.0, -1.0]
    half /= np.linalg.norm(along)
    rays = model.rays_at(np.array([middle - half, middle + half]))
    x, y = rays[1, :2] / rays[1, 2] - rays[0, :2] / rays[0, 2]
    return float(abs(x * along_xy[1] - y * along_xy[0]) / np.linalg.norm(along_xy))


def _edge(
    grey: Float32Array,
    square: FloatArray,
    ends_xy: FloatArray,
    cells: int,
    model: CameraModel,
    *,
    is_near: bool,
) -> _Edge | None:
    """The edge from the first to the second corner of square (4, 2); None if there is none.

    ends_xy: (2, 2) rays of these two, as those of ``Corners``. is_near: whether the edge is known
    to a fraction of a pixel.
    """
    length = float(np.linalg.norm(square[1] - square[0]))
    across_px = (square[1] - square[0])[::-1] * [1.0, -1.0] / length
    cell_px = abs(float((0.5 * (square[2] + square[3]) - square[0]) @ across_px)) / cells
    margin = max(END_PX, END_SHARE * length)
    at = np.linspace(margin, length - margin, max(LEAST_POINTS, int(length - 2.0 * margin)))
    reach = float(np.clip(REACH_CELLS * cell_px, *REACH_PX))
    across = np.arange(-reach, reach + 1e-6, STEP_PX)
    base, outwards = _as_bent(ends_xy, at / length, model)
    profile = _profile(grey, base[:, None] + across[:, None] * outwards[:, None])
    found = _by_area(profile, at, across) if is_near else _by_steps(profile, across)
    if found is None:
        return None
    those, off, rise = found
    width_px = _width_px(rise, across)
    by_pieces_px = PIECE_SHIFT_PX * np.sqrt(min(1.0, PIECE_PX / length))
    blurred_px = BLURRED_SHARE * max(0.0, width_px - BLURRED_CELLS * cell_px) + SHIFT_FLOOR_PX
    shift_px = float(np.hypot(blurred_px, by_pieces_px))
    points_px = base[those] + off[:, None] * outwards[those]
    return _Edge(points_px, shift_px, _asymmetry(profile.mean(axis=0), across))


def _as_bent(
    ends_xy: FloatArray, shares: FloatArray, model: CameraModel
) -> tuple[FloatArray, FloatArray]:
    """(n, 2) px of a straight edge at these shares of its length, as the lens shows it, and (n, 2)
    the unit normals there: from a straight line in the image it may be away by some pixels."""
    rays = ends_xy[0] + shares[:, None] * (ends_xy[1] - ends_xy[0])
    base = model.pixels(np.column_stack([rays, np.ones(len(rays))]))
    along = np.gradient(base, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return base, np.column_stack([along[:, 1], -along[:, 0]])  # corners go clockwise in the image


def _profile(grey: Float32Array, looked_px: FloatArray) -> FloatArray:
    """(n, k) brightness at looked_px (n, k, 2)."""
    x, y = looked_px[..., 0].astype(np.float32), looked_px[..., 1].astype(np.float32)
    profile = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return profile.astype(np.float64)


def _by_steps(
    profile: FloatArray, across: FloatArray
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Which points have an edge, where it is (n,), and the mean rise (k - 1,) that adds up to 1:
    the middle of all steps upwards. Noise has more of them in the white, which moves it there."""
    rise = np.maximum(np.diff(profile, axis=1), 0.0)
    sums = rise.sum(axis=1)
    those = sums > 0.0
    if np.count_nonzero(those) < LEAST_POINTS:
        return None
    rise = rise[those] / sums[those, None]
    return those, rise @ _between(across), rise.mean(axis=0)


def _between(across: FloatArray) -> FloatArray:
    """(k - 1,) the middles of the steps."""
    return np.asarray(0.5 * (across[1:] + across[:-1]))


def _asymmetry(profile: FloatArray, across: FloatArray) -> float:
    """Of the rise (k,) of an edge: by how much its upper half is longer than its lower one, as a
    share of both; nan for none that rises once.

    A lens and a pixel blur an edge to both sides alike. Where brightness is coded otherwise than
    light is, one half of the rise is longer than the other.
    """
    ends = profile[:LEVEL_SAMPLES].mean(), profile[-LEVEL_SAMPLES:].mean()
    if ends[1] <= ends[0]:
        return np.nan
    risen = (profile - ends[0]) / (ends[1] - ends[0])
    places = []
    for level in RISEN:
        passed = np.flatnonzero((risen[:-1] < level) & (risen[1:] >= level))
        if passed.size != 1:
            return np.nan
        k = passed[0]
        places.append(across[k] + STEP_PX * (level - risen[k]) / (risen[k + 1] - risen[k]))
    low, middle, high = places
    return float((high + low - 2.0 * middle) / (high - low))


def _width_px(rise: FloatArray, across: FloatArray) -> float:
    """Standard deviation of where a mean rise (k - 1,) stands."""
    middles = _between(across)
    return float(np.sqrt(rise @ (middles - rise @ middles) ** 2))


def _by_area(
    profile: FloatArray, at: FloatArray, across: FloatArray
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """The same for an edge that is near: the area below the rise tells where it stands, whatever
    its shape (Tabatabai & Mitchell 1984), which noise moves neither way.

    Brightness on both sides is linear along the edge, at (n,); None where it is no edge.
    """
    steps = _by_steps(profile, across)
    if steps is None:
        return None
    rise = steps[2]
    half = max(LEAST_HALF_PX, HALF_WIDTHS * _width_px(rise, across))
    if half > across[-LEVEL_SAMPLES - 1]:
        return steps
    inner = np.abs(across) <= half
    ends = (profile[:, across < -half].mean(axis=1), profile[:, across > half].mean(axis=1))
    along = np.column_stack([np.ones(len(at)), at - at.mean()])
    within, without = (along @ np.linalg.lstsq(along, end, rcond=None)[0] for end in ends)
    if not (without > within).all():
        return None
    risen = (profile[:, inner] - within[:, None]) / (without - within)[:, None]
    off = across[inner][-1] - np.trapezoid(risen, dx=STEP_PX, axis=1)
    return np.ones(len(at), np.bool_), off, rise


def _fit_line(
    points: FloatArray, shift_sigma: float, floor: float
) -> tuple[FloatArray, FloatArray]:
    """(a, b, c) with a x + b y + c = 0, a and b unit, and the (3, 3) covariance of it.

    By weighted least squares across the line, with Huber's weights. shift_sigma: of all points
    (n, 2) alike. floor: least standard deviation of one of them.
    """
    weights = np.ones(len(points))
    for _ in range(WEIGHING_ROUNDS):
        middle = np.average(points, axis=0, weights=weights)
        apart = points - middle
        _, axes = np.linalg.eigh((apart * weights[:, None]).T @ apart)
        normal, along = axes[:, 0], axes[:, 1]
        off = apart @ normal
        sigma = max(SIGMAS_PER_MEDIAN * float(np.median(np.abs(off))), floor)
        weights = 1.0 / np.maximum(1.0, np.abs(off) / (HUBER_SIGMAS * sigma))
    freedom = max(weights.sum() - 2.0, 1.0)
    variance = float((weights * off**2).sum() / freedom) + floor**2
    variance *= CORRELATED_POINTS
    t = apart @ along
    spread = float((weights * t**2).sum() / weights.sum())
    turn = (variance / float(weights.sum()) + shift_sigma**2 / CELLS_ALONG) / spread
    shift = variance / float(weights.sum()) + shift_sigma**2
    # A turn moves the normal along the line, and the offset by how far the middle lies along it.
    by_turn = np.append(along, -along @ middle)
    by_shift = np.array([0.0, 0.0, 1.0])
    covariance = turn * np.outer(by_turn, by_turn) + shift * np.outer(by_shift, by_shift)
    return np.append(normal, -normal @ middle), covariance


def _corners(
    lines: list[FloatArray], covariances: list[FloatArray], model: CameraModel
) -> Corners | None:
    """Where each line crosses the one before, and how surely."""
    corners, by_lines = np.zeros((4, 2)), np.zeros((8, 12))
    for k in range(4):
        before, after = lines[k - 1], lines[k]
        normals = np.array([before[:2], after[:2]])
        if abs(np.linalg.det(normals)) < 0.05:  # edges that hardly cross: no square seen so
            return None
        corners[k] = np.linalg.solve(normals, -np.array([before[2], after[2]]))
        away = -np.linalg.inv(normals)
        one = np.append(corners[k], 1.0)
        by_lines[2 * k : 2 * k + 2, 3 * ((k - 1) % 4) : 3 * ((k - 1) % 4) + 3] = np.outer(
            away[:, 0], one
        )
        by_lines[2 * k : 2 * k + 2, 3 * k : 3 * k + 3] = np.outer(away[:, 1], one)
    of_lines = np.zeros((12, 12))
    for k, covariance in enumerate(covariances):
        of_lines[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = covariance
    pixels, seen = model.project(np.column_stack([corners, np.ones(4)]))
    if not seen.all() or not np.isfinite(pixels).all():
        return None
    return Corners(corners, by_lines @ of_lines @ by_lines.T, pixels)
