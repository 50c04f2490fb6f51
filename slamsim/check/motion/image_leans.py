"""How long a shutter takes from the first row to the last, by how upright lines lean in turns.

While the robot turns, each row of a rolling shutter sees the world turned a little farther than
the row above it: all that an image shows is sheared by turn rate times readout. Of one image that
cannot be told from a scene that leans; over many images scenes lean neither way, and what goes with
the turn rate is the shutter. No motion between images is looked at, so that neither the rate of
images matters nor how far away things are. Lines are those of Grompone von Gioi et al. (LSD, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.motion.robust import biweights, scatter, scatter_where_it_tells, weighed_median
from slamsim.core.geometry import wrap_angle
from slamsim.core.quantiles import student_t
from slamsim.core.types import BoolArray, FloatArray, IntArray

_SHORTEST_PX, _FEWEST_LINES = 12.0, 3
"""Of a line in a thumbnail: at 2 degrees it moves by half a pixel from end to end."""
_UPRIGHT, _WINDOW = 0.6, 0.16
"""Azimuth over elevation from end to end: lines that lean by less than 31 degrees are looked at,
and of these those within 9 degrees of the common lean count. A shutter of 30 ms leans things by 2
degrees at 1 rad/s."""
_DOWN = 0.5
"""Least share of a line that runs from row to row: to a camera on its side what is upright is of
one instant."""
_BESIDE_PX, _GAP_PX, _TURN_RAD = 1.2, 3.0, 0.05
"""Up to which one line goes on as another: where edges of an image are not smooth, a lean of some
pixels is a stair of upright pieces, each of which alone leans not at all. On computed images of
160 x 120 pixels shutters of 10 and 20 ms so measured as 7.8 and 17.4 ms, joined as 8.8 and 18.7;
with smooth edges as 9.8 and 19.9, joined or not."""
_STILL_LEVELS, _STILL_REACH_PX, _STILL_SHARE = 4.0, 2, 0.5
"""Pixels that change by less over all images, a few times the noise of dark ones in 8 bits, show
what moves with the camera: what surrounds the image circle of a fisheye lens, or the robot. Their
border is as upright as anything, and never turns: with it leans of a fisheye's images scattered by
18 degrees instead of 8, and a shutter of 0 ms measured as 154 with a sigma of 63."""
_BLOCK_S, _FEWEST_BLOCKS = 2.0, 6
"""Images of one view have the lean of that view in common: views count, not images. Straight on, a
view lasts so long at most."""
_LEAST_SCATTER_RAD = 1e-6
_VARIED = 3.0
"""Times the scatter of all images is that of those in turns at most, each of which sees another
view: along corridors it is 3.5 times. Beyond that most of a turn sees things that lean, such as a
slanted pattern, by which 0 ms would be 190 and 370."""
_ROUNDS = 15
_STRAIGHT_RAD_S = 0.1
"""Turns that are slower lean things by a shutter of 30 ms by 0.2 degrees."""
_LEAST_SIGMA_S = 1e-4
"""A tenth of a pixel of lean at 1 rad/s in images of 1000 rows: no estimate is surer."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenLeans:
    """stamps_ns: (n,) of images. leans_rad: (n,) by how much farther to the right in the base an
    image sees an upright line in its last row than in its first."""

    stamps_ns: IntArray
    leans_rad: FloatArray


def seen_leans(camera: CameraSurvey, model: CameraModel, R_base_camera: FloatArray) -> SeenLeans:
    """Of all images of which thumbnails are held; R_base_camera (3, 3): as claimed.

    Images without upright lines, and those that are the one before again, are left out.
    """
    still = _moves_along(camera.thumbnails)
    leans = np.array([_lean(image, still, model, R_base_camera) for image in camera.thumbnails])
    if not leans.size:
        return SeenLeans(np.zeros(0, np.int64), np.zeros(0))
    told = np.isfinite(leans) & camera.is_new
    return SeenLeans(camera.stamps_ns[camera.sampled][told], leans[told])


def _moves_along(images: NDArray[np.uint8]) -> BoolArray:
    """(h, w) pixels at which images (n, h, w) show what moves with the camera, or border on it."""
    if not len(images):
        return np.zeros(images.shape[1:], np.bool_)
    still = (images.std(axis=0) < _STILL_LEVELS).astype(np.uint8)
    width = 2 * _STILL_REACH_PX + 1
    return cv2.dilate(still, np.ones((width, width), np.uint8)).astype(np.bool_)


def _lean(image: NDArray[np.uint8], still: BoolArray, model: CameraModel, R: FloatArray) -> float:
    """Of one image, (h, w) grey: the mean over its lines, weighed by the squares of their lengths,
    of those near it; nan where there are too few. still: (h, w) where lines do not count."""
    found = cv2.createLineSegmentDetector(0).detect(image)[0]
    if found is None:
        return np.nan
    lines = np.asarray(found, np.float64).reshape(-1, 2, 2)
    x_px, y_px = (lines[:, 1] - lines[:, 0]).T
    lines = lines[np.abs(y_px) > _DOWN * np.hypot(x_px, y_px)]
    lines = lines[_share_along(lines, still) < _STILL_SHARE]
    leans, tall, lengths = _leans_of(lines, _joined(lines), image.shape, model, R)
    upright = (lengths > _SHORTEST_PX) & (np.abs(leans) < _UPRIGHT * tall)
    leans, tall, weight = leans[upright], tall[upright], np.square(lengths[upright])
    if leans.size < _FEWEST_LINES:
        return np.nan
    lean = weighed_median(leans, weight)
    for _ in range(_ROUNDS):
        off = (leans - lean) / (_WINDOW * tall)
        counts = weight * np.square(np.maximum(1.0 - np.square(off), 0.0))
        if not counts.any():
            return np.nan
        lean = float((counts * leans).sum() / counts.sum())
    return lean


def _share_along(lines: FloatArray, marked: BoolArray) -> FloatArray:
    """(n,) share of each of (n, 2, 2) lines that lies on marked pixels, (h, w)."""
    along = np.linspace(0.0, 1.0, 2 * int(_SHORTEST_PX))[:, None, None]
    points = lines[:, 0] + along * (lines[:, 1] - lines[:, 0])
    x, y = np.minimum(points.astype(np.int64), [marked.shape[1] - 1, marked.shape[0] - 1]).T
    return np.asarray(marked[np.maximum(y, 0), np.maximum(x, 0)].mean(axis=1), np.float64)


def _joined(lines: FloatArray) -> IntArray:
    """(n,) to which edge each of (n, 2, 2) lines belongs, from 0: one that goes on where another
    ends, in the same direction and as bright on the same side, is of the same edge."""
    if not len(lines):
        return np.zeros(0, np.int64)
    # The order of the ends tells which side is bright.
    is_down = lines[:, 1, 1] > lines[:, 0, 1]
    top = np.where(is_down[:, None], lines[:, 0], lines[:, 1])
    foot = np.where(is_down[:, None], lines[:, 1], lines[:, 0])
    directions = np.arctan2(*(foot - top).T)
    beside, gap = np.abs(top[None] - foot[:, None]).transpose(2, 0, 1)
    goes_on = (beside < _BESIDE_PX) & (gap < _GAP_PX) & (is_down[:, None] == is_down)
    goes_on &= np.abs(directions[:, None] - directions) < _TURN_RAD
    np.fill_diagonal(goes_on, val=False)
    apart = np.where(goes_on, beside + gap, np.inf)
    follower, leader = np.argmin(apart, axis=1), np.argmin(apart, axis=0)
    edge = np.arange(len(lines))
    for one in np.argsort(top[:, 1]).tolist():
        other = int(follower[one])
        if goes_on[one, other] and leader[other] == one:
            edge[other] = edge[one]
    return np.asarray(np.unique(edge, return_inverse=True)[1], np.int64)


def _leans_of(
    lines: FloatArray, edge: IntArray, shape: tuple[int, ...], model: CameraModel, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each edge (k,): by how much it leans and how tall it is, both in rad from the first row of
    the image to the last, and how long it is in pixels.

    By least squares over all points of its lines (n, 2, 2), each evenly spread along its own.
    """
    height, width = shape
    # LSD has the first pixel from 0 to 1, camera models have its middle at 0.
    ends = lines.reshape(-1, 2) * [model.width / width, model.height / height] - 0.5
    x, y, z = (model.rays_at(ends) @ R.T).reshape(-1, 2, 3).transpose(2, 0, 1)
    rows = lines[:, :, 1] / height
    to_right, up = -np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    count = int(edge.max(initial=-1)) + 1
    some = np.zeros(count)
    some[edge] = to_right[:, 0]
    to_right = wrap_angle(to_right - some[edge][:, None])
    long = np.abs(np.diff(rows)[:, 0])

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(edge, long * values, count), np.float64)

    def off(ends: FloatArray) -> FloatArray:
        middles = ends.mean(axis=1)
        mean = total(middles) / total(np.ones(len(lines)))
        return np.asarray(middles - mean[edge])

    def product(one: FloatArray, other: FloatArray) -> FloatArray:
        along = np.diff(one)[:, 0] * np.diff(other)[:, 0] / 12.0
        return total(off(one) * off(other) + along)

    square = product(rows, rows)
    lengths_px = np.hypot(*(lines[:, 1] - lines[:, 0]).T)
    whole_px = np.asarray(np.bincount(edge, lengths_px, count), np.float64)
    return product(rows, to_right) / square, np.abs(product(rows, up) / square), whole_px


def fit_readout(
    leans_rad: FloatArray, times_s: FloatArray, rates_rad_s: FloatArray
) -> tuple[float, float] | None:
    """(seconds from the first row to the last, sigma), by how leans (n,) go with turn rates (n,).

    None where images cover too short a time, or the robot turns in none of them, or a shutter would
    take longer than from one image to the next: what is seen in turns leans by itself. Below 0
    where rows are exposed from the foot of the image on. times_s: (n,) of the images.
    """
    block, turns = views(times_s, rates_rad_s)
    count = int(block.max(initial=-1)) + 1
    A = np.column_stack([np.ones(leans_rad.size), rates_rad_s])
    if count < _FEWEST_BLOCKS or turns < 2 or not np.ptp(rates_rad_s) > 0.0:
        return None
    weight = np.ones(leans_rad.size)
    tells = np.square(rates_rad_s - np.median(rates_rad_s))
    for _ in range(_ROUNDS):
        by = A * weight[:, None]
        inverse = np.linalg.pinv(by.T @ A)
        values = inverse @ (by.T @ leans_rad)
        apart = leans_rad - A @ values
        sigma_rad = scatter_where_it_tells(apart, tells, _LEAST_SCATTER_RAD, _VARIED)
        weight = biweights(apart, sigma_rad)
    if abs(values[1]) > np.median(np.diff(np.sort(times_s))):
        return None
    scores = np.zeros((count, 2))
    np.add.at(scores, block, A * (weight * apart)[:, None])
    # The biweight of the scatter w = (1 - u^2)^2: what a change of the values does to the scores is
    # less, (1 - u^2)(1 - 5 u^2), for those that it takes farther off count less.
    root = np.sqrt(weight)
    inverse = np.linalg.pinv((A * (root * (5.0 * root - 4.0))[:, None]).T @ A)
    covariance = inverse @ (scores.T @ scores) @ inverse
    sigma_s = float(np.sqrt(covariance[1, 1])) * wider_by_few(turns)
    # Of few turns the fit follows what each of them happens to lean: how far views scatter, turns
    # or not, tells that better than what is left of them.
    members = [np.flatnonzero(block == one) for one in range(count)]
    view_rad = scatter(np.array([np.median(apart[of]) for of in members]), _LEAST_SCATTER_RAD)
    view_rates = np.array([rates_rad_s[of].mean() for of in members])
    by_views_s = view_rad / max(float(np.linalg.norm(view_rates - view_rates.mean())), 1e-9)
    return float(values[1]), float(np.hypot(max(sigma_s, by_views_s), _LEAST_SIGMA_S))


def wider_by_few(turns: int) -> float:
    """Times a sigma that two or more turns tell, each of them one view: Student's t."""
    return float(np.sqrt(turns / (turns - 1.0)) * student_t(0.975, turns - 1.0)) / 1.96


def views(times_s: FloatArray, rates_rad_s: FloatArray) -> tuple[IntArray, int]:
    """(n,) to which view each image belongs, from 0, and how many of these are turns.

    A robot that goes round a thing has it on the same side all the while, and what of it leans does
    so one way: a turn is one view, however long it lasts.
    """
    order = np.argsort(times_s)
    at_s, way = times_s[order], np.sign(rates_rad_s[order])
    way[np.abs(rates_rad_s[order]) < _STRAIGHT_RAD_S] = 0.0
    goes_on = (way[1:] == way[:-1]) & (np.diff(at_s) < _BLOCK_S)
    goes_on &= (way[1:] != 0.0) | (np.diff(np.floor(at_s / _BLOCK_S)) == 0.0)
    view = np.concatenate([[0], np.cumsum(~goes_on)])[: len(at_s)]
    turns = np.unique(view[way != 0.0]).size
    return view[np.argsort(order)], turns
