"""How a camera turns by its images, against a gyroscope or odometry.

Features are tracked from image to image (Lucas & Kanade 1981); those that hardly stand out of the
noise are left out. A turn of the robot moves all of them by the same angle about its vertical,
whatever their distance; what is driven moves those at the sides, to the one side at the left and to
the other at the right: both must be seen to tell the one from the other. Parts of an image farther
down are exposed later where the shutter rolls: how much later is told by what leans in turns
(``image_leans``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.motion.image_leans import SeenLeans, fit_readout, views, wider_by_few
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.robust import (
    biweights,
    scatter,
    scatter_where_it_tells,
    tukey_weights,
    weighed_median,
)
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray

FEWEST_PAIRS = 20
LEAST_TURNED_RAD = 1.0
_MOST_FEATURES, _FEWEST_FEATURES = 80, 6
_QUALITY, _APART_PX = 0.01, 4
"""Of corners (Shi & Tomasi 1994), and how far they are from each other."""
_THERE_AND_BACK_PX = 0.3
_WIDEST_S = 0.25
"""Beyond which too little of an image is in the next one."""
_SEARCHED_S, _SEARCH_STEP_S = 1.0, 0.01
_LATEST_S = 10.0
"""Images that are late by more than is searched, up to this, are not taken for flipped ones: what
cameras and players buffer may be some seconds."""
_PLAINLY = 0.5
"""Of what is left of turns one way: what may be left of them the other way, to be told as such."""
_REACH_PX = 7
"""Half of the window that is tracked."""
_OUT_OF_NOISE = 2.0
"""Least squared slope of brightness, in the direction where it is least, over what noise alone
would give. Noise, and straight edges in noise, pass for corners that stand still: on 12 computed
drives with poor texture, turns were 6 to 74 % too small with all features, and right within 4 % or
untold with these."""
_STEEPEST = np.sin(np.radians(60.0))
"""Of rays over or under the horizon: beyond, a direction about the vertical is twice as unsure, and
what is driven moves it the more."""
_FEWEST_ASIDE = 3
"""Features to the left of where the robot drives, and to the right."""
_LEAST_SCATTER_RAD = 1e-5
_READOUT_S, _READOUT_SIGMA_S = 0.015, 0.015
"""From the first row to the last, before leans are looked at: a global shutter, or most of a period
at 30 images a second."""
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class SeenTurns:
    """Turns of the camera about the base's vertical between pairs of images, by halves of them.

    first_ns, second_ns: (n,) stamps. turned_rad: (n,) to the left. rows: (n,) where the features
    are, from 0 at the first row to 1 at the last. pair: (n,) which pair it is of.
    """

    first_ns: IntArray
    second_ns: IntArray
    turned_rad: FloatArray
    rows: FloatArray
    pair: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class TurnFit:
    """delay_s: stamps less the instants of the first row, by the clock of the other stream.
    gain: turns as seen over turns as the other tells, less one. readout_s: from the first row to
    the last, None where leans do not tell. Each (value, sigma). turns_rad_s: (n,) how fast the
    robot turned at the images whose leans were seen."""

    delay_s: tuple[float, float]
    gain: tuple[float, float]
    readout_s: tuple[float, float] | None
    turns_rad_s: FloatArray
    pairs: int


def seen_turns(camera: CameraSurvey, model: CameraModel, R_base_camera: FloatArray) -> SeenTurns:
    """Of all pairs of successive images of which thumbnails are held; R_base_camera: as claimed.

    R_base_camera is (3, 3).
    """
    found = [
        (*camera.stamps_ns[camera.sampled[[k, k + 1]]].tolist(), *half, k)
        for k in _pairs(camera).tolist()
        for half in _turned(camera.thumbnails[k], camera.thumbnails[k + 1], model, R_base_camera)
    ]
    table = np.array(found, dtype=object).reshape(-1, 5)
    first, second, pair = (table[:, k].astype(np.int64) for k in (0, 1, 4))
    turned, rows = (table[:, k].astype(np.float64) for k in (2, 3))
    return SeenTurns(first, second, turned, rows, pair)


def _pairs(camera: CameraSurvey) -> IntArray:
    """Which looks have the next image as the next look, another one and soon."""
    numbers = camera.sampled
    soon_ns = np.diff(camera.stamps_ns[numbers])
    follows = (np.diff(numbers) == 1) & camera.is_new[1:]
    return np.flatnonzero(follows & (soon_ns > 0) & (soon_ns < 1e9 * _WIDEST_S))


def _turned(
    first: NDArray[np.uint8], second: NDArray[np.uint8], model: CameraModel, R: FloatArray
) -> Iterator[tuple[float, float]]:
    """(turn in rad, mean row) of the upper and of the lower half, as far as they show features."""
    before, after = _tracked(first, second)
    if len(before) < 2 * _FEWEST_FEATURES:
        return
    height, width = first.shape
    scale = np.array([model.width / width, model.height / height])
    angles = [_azimuths((0.5 + px) * scale - 0.5, model, R) for px in (before, after)]
    turned = -wrap_angle(angles[1] - angles[0])
    there = np.isfinite(turned)
    rows = (before[:, 1] + 0.5) / height
    aside = np.sin(angles[0])
    lower = rows > np.median(rows)
    A = np.column_stack([~lower, lower, -aside]).astype(np.float64)[there]
    if len(A) < 2 * _FEWEST_FEATURES:
        return
    halves, used = _robust(A, turned[there])
    sides = aside[there][used]
    if min((sides > 0.0).sum(), (sides < 0.0).sum()) < _FEWEST_ASIDE:
        return
    for half, is_mine in enumerate((~lower[there], lower[there])):
        mine = is_mine & used
        if mine.sum() >= _FEWEST_FEATURES:
            yield float(halves[half]), float(rows[there][mine].mean())


def _tracked(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
    """(n, 2) pixels of features in both, found again on the way back."""
    none = np.zeros((0, 2))
    corners = cv2.goodFeaturesToTrack(first, _MOST_FEATURES, _QUALITY, _APART_PX)
    if corners is None:
        return none, none
    window = {"winSize": (2 * _REACH_PX + 1, 2 * _REACH_PX + 1), "maxLevel": 3}
    there, found, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, **window)  # type: ignore[call-overload]
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, **window)  # type: ignore[call-overload]
    apart = np.abs(back - corners).reshape(-1, 2).max(axis=1)
    good = (found.ravel() == 1) & (again.ravel() == 1) & (apart < _THERE_AND_BACK_PX)
    if not good.any():
        return none, none
    before, after = (px.reshape(-1, 2)[good] for px in (corners, there))
    clear = _out_of_noise(_patches(first, before), _patches(second, after))
    return before[clear].astype(float), after[clear].astype(float)


def _patches(image: NDArray[np.uint8], pixels: Float32Array) -> Float32Array:
    """(n, side, side) of what an image shows around (n, 2) pixels."""
    reach = np.arange(-_REACH_PX, _REACH_PX + 1, dtype=np.float32)
    side = reach.size
    x = pixels[:, 0, None, None] + np.tile(reach, (side, 1))
    y = pixels[:, 1, None, None] + np.tile(reach[:, None], (1, side))
    column, row = (each.reshape(-1, side).astype(np.float32) for each in (x, y))
    whole = image.astype(np.float32)
    found = cv2.remap(whole, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(found.reshape(-1, side, side), np.float32)


def _out_of_noise(before: Float32Array, after: Float32Array) -> BoolArray:
    """(n,) which features stand out of what differs between the two images of them, light aside.

    before, after: (n, side, side).
    """
    apart = before - after
    differ = np.square(apart - apart.mean(axis=(1, 2), keepdims=True)).mean(axis=(1, 2))
    mean = 0.5 * (before + after)
    along_x = 0.5 * (mean[:, 1:-1, 2:] - mean[:, 1:-1, :-2])
    along_y = 0.5 * (mean[:, 2:, 1:-1] - mean[:, :-2, 1:-1])
    xx, yy, xy = (
        (one * other).mean(axis=(1, 2))
        for one, other in ((along_x, along_x), (along_y, along_y), (along_x, along_y))
    )
    least = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    # Two images with noise of variance s^2 differ by 2 s^2. Of their mean, with s^2 / 2, a slope
    # over two pixels has s^2 / 4.
    return np.asarray(least > _OUT_OF_NOISE * differ / 8.0)


def _azimuths(pixels: FloatArray, model: CameraModel, R_base_camera: FloatArray) -> FloatArray:
    """(n,) directions about the base's vertical; nan of what is too steep above or below."""
    x, y, z = (model.rays_at(pixels) @ R_base_camera.T).T
    steep = np.abs(z) > _STEEPEST * np.sqrt(x * x + y * y + z * z)
    return np.where(steep, np.nan, np.arctan2(y, x))


def _robust(A: FloatArray, b: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Least squares with Tukey's biweight from a start by absolute values, and what counts."""
    weight: FloatArray = np.ones(len(b))
    values: FloatArray = np.zeros(A.shape[1])
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        values = np.asarray(np.linalg.lstsq(A * root, b * root[:, 0], rcond=None)[0])
        weight = tukey_weights(b - A @ values, _LEAST_SCATTER_RAD)
    return values, weight > 0.01


def fit_turns(seen: SeenTurns, leans: SeenLeans, other: IntegratedMotion) -> TurnFit | None:
    """None where too few images turn, or the other stream hardly does."""
    column = other.totals.shape[1] - 1
    first_s = 1e-9 * (seen.first_ns - other.origin_ns).astype(np.float64)
    second_s = 1e-9 * (seen.second_ns - other.origin_ns).astype(np.float64)
    covered = other.covers(first_s - _SEARCHED_S, second_s + _SEARCHED_S)
    table = _Table(
        other,
        column,
        *(first_s[covered], second_s[covered], seen.turned_rad[covered]),
        *(seen.rows[covered], seen.pair[covered]),
        *_covered(leans, other),
    )
    if np.unique(table.pair).size < FEWEST_PAIRS:
        return None
    return table.fitted() if table.turns() else None


def _covered(leans: SeenLeans, other: IntegratedMotion) -> tuple[FloatArray, FloatArray]:
    """(n,) times by the other stream, where it has no gap, and leans."""
    times_s = 1e-9 * (leans.stamps_ns - other.origin_ns).astype(np.float64)
    covered = other.covers(times_s - _SEARCHED_S, times_s + _SEARCHED_S)
    return times_s[covered], leans.leans_rad[covered]


def _believed(readout_s: tuple[float, float] | None) -> tuple[float, float]:
    """(value, sigma) with what any shutter has."""
    if readout_s is None:
        return _READOUT_S, _READOUT_SIGMA_S
    weights = np.array([1.0 / readout_s[1] ** 2, 1.0 / _READOUT_SIGMA_S**2])
    value = weights @ [readout_s[0], _READOUT_S] / weights.sum()
    return float(value), float(1.0 / np.sqrt(weights.sum()))


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Seen turns and leans in the time of the other stream."""

    other: IntegratedMotion
    column: int
    first_s: FloatArray
    second_s: FloatArray
    turned_rad: FloatArray
    rows: FloatArray
    pair: IntArray
    leant_s: FloatArray
    leans_rad: FloatArray

    def turns(self) -> bool:
        """Whether there is anything to compare; each pair of images counts by its halves."""
        either_rad = np.abs([self.turned_rad, self._told(0.0)]).sum(axis=1)
        return bool(either_rad.min() >= 2.0 * LEAST_TURNED_RAD)

    def fitted(self) -> TurnFit | None:
        coarse = self._coarse()
        if coarse is None:
            return None
        values = np.array([*coarse, 0.0, _READOUT_S])
        for _ in range(_ROUNDS):
            readout = self._readout(values)
            believed_s, sigma_s = _believed(readout)
            known_s = np.array([_SEARCHED_S, np.inf, np.inf, sigma_s])
            A, apart, weight = self._equations(values)
            by = A * weight[:, None]
            prior = np.square(scatter(apart, _LEAST_SCATTER_RAD) / known_s)
            H, g = by.T @ A + np.diag(prior), by.T @ apart
            g[3] += prior[3] * (believed_s - values[3])
            values = values + np.linalg.lstsq(H, g, rcond=1e-12)[0]
        if abs(values[0]) > _SEARCHED_S or not weight.any():
            return None
        weighed = apart * weight
        by_pair = self._covariance(A, weighed, self.pair, H, known_s)
        sigmas = np.sqrt(np.diag(by_pair))
        at_s = self._middles(0.5 * (self.first_s + self.second_s), values)
        view, turns = views(at_s, self._rate(at_s))
        by_view = self._covariance(A, weighed, view, H, known_s)
        delay_sigma_s = max(float(sigmas[0]), _by_turns(float(by_view[0, 0]), turns))
        return TurnFit(
            (float(values[0]), delay_sigma_s),
            (float(values[1]), float(sigmas[1])),
            readout,
            self._rate(self._middles(self.leant_s, values)),
            int(np.unique(self.pair).size),
        )

    def _readout(self, values: FloatArray) -> tuple[float, float] | None:
        """By leans, with what is known of the delay."""
        at_s = self._middles(self.leant_s, values)
        return fit_readout(self.leans_rad, at_s, self._rate(at_s))

    def _middles(self, stamps_s: FloatArray, values: FloatArray) -> FloatArray:
        """(n,) when the middle rows were exposed."""
        return np.asarray(stamps_s - values[0] + 0.5 * values[3])

    def _equations(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, 4) of delay, gain, bias and readout, (n,) what is unexplained, (n,) weights."""
        delay_s, gain, bias, readout_s = values
        starts = self.first_s - delay_s + readout_s * self.rows
        ends = self.second_s - delay_s + readout_s * self.rows
        told = self._turned(ends) - self._turned(starts)
        change = (1.0 + gain) * (self._rate(ends) - self._rate(starts))
        lasts = self.second_s - self.first_s
        apart = self.turned_rad - (1.0 + gain) * told - bias * lasts
        A = np.column_stack([-change, told, lasts, change * self.rows])
        sigma_rad = scatter_where_it_tells(apart, np.square(told), _LEAST_SCATTER_RAD)
        return A, apart, biweights(apart, sigma_rad)

    def _covariance(
        self,
        A: FloatArray,
        weighed: FloatArray,
        block: IntArray,
        H: FloatArray,
        known_s: FloatArray,
    ) -> FloatArray:
        """(4, 4) by blocks (n,) that err together (sandwich), with how surely each number was known
        before (4,)."""
        _, place = np.unique(block, return_inverse=True)
        summed = np.zeros((int(place.max()) + 1, 4))
        np.add.at(summed, place, A * weighed[:, None])
        inverse = np.linalg.pinv(H, rcond=1e-12)
        found = inverse @ (summed.T @ summed) @ inverse
        prior = inverse * scatter(weighed, _LEAST_SCATTER_RAD) ** 2 / known_s
        return np.asarray(found + prior @ prior.T)

    def _coarse(self) -> tuple[float, float] | None:
        """The delay with which turns are most alike, and the gain, less one: below -1 of images
        that are upside down or mirrored, and so turn the other way. None where they may as well be
        late."""
        delays = np.arange(-_SEARCHED_S, _SEARCHED_S + 1e-6, _SEARCH_STEP_S)
        told = [self._told(delay + 0.5 * _READOUT_S) for delay in delays]
        same, against = (
            np.array([_alike(self.turned_rad, sign * each) for each in told]).T
            for sign in (1.0, -1.0)
        )
        best, other = int(np.argmin(same[0])), int(np.argmin(against[0]))
        gain, turns_rad = float(against[1, other]), told[other]
        if self._is_against(gain, turns_rad, told[best]):
            is_late = self._is_rather_late(gain, turns_rad)
            return None if is_late else (float(delays[other]), -1.0 - gain)
        return float(delays[best]), float(same[1, best]) - 1.0

    def _is_against(
        self,
        gain: float,
        turns_rad: FloatArray,
        same_rad: FloatArray,
        known: BoolArray | slice = slice(None),
    ) -> bool:
        """Whether turns (n,) the other way, times a gain, leave plainly less of those seen where
        they turn than turns (n,) the same way do."""
        seen_rad, counts = self.turned_rad[known], np.abs(turns_rad[known])
        against_rad = np.abs(seen_rad + gain * turns_rad[known])
        left_rad = np.abs(seen_rad - _alike(seen_rad, same_rad[known])[1] * same_rad[known])
        return weighed_median(against_rad, counts) < _PLAINLY * weighed_median(left_rad, counts)

    def _is_rather_late(self, gain: float, turns_rad: FloatArray) -> bool:
        """Whether turns the same way, farther off than is searched, leave not plainly more than
        those (n,) against: a robot that weaves turns the other way half a period later."""
        for delay_s in np.arange(-_LATEST_S, _LATEST_S + 1e-6, _SEARCH_STEP_S).tolist():
            shift_s = delay_s + 0.5 * _READOUT_S
            known = self.other.covers(self.first_s - shift_s, self.second_s - shift_s)
            if 2 * int(known.sum()) < known.size:
                continue
            if not self._is_against(gain, turns_rad, self._told(shift_s), known):
                return True
        return False

    def _told(self, delay_s: float) -> FloatArray:
        return self._turned(self.second_s - delay_s) - self._turned(self.first_s - delay_s)

    def _turned(self, at_s: FloatArray) -> FloatArray:
        return np.asarray(self.other.at(at_s)[:, self.column])

    def _rate(self, at_s: FloatArray) -> FloatArray:
        return (self._turned(at_s + 0.005) - self._turned(at_s - 0.005)) / 0.01


def _alike(seen_rad: FloatArray, told_rad: FloatArray) -> tuple[float, float]:
    """What turns (n,) leave of those seen, times the gain from 0 on that leaves least, and the
    gain. By absolute values, which wild turns hardly move; straight driving leaves as much whatever
    is told."""
    ratios = np.divide(seen_rad, told_rad, out=np.zeros(told_rad.size), where=told_rad != 0.0)
    gain = max(weighed_median(ratios, np.abs(told_rad)), 0.0)
    return float(np.abs(seen_rad - gain * told_rad).sum()), gain


def _by_turns(variance_s2: float, turns: int) -> float:
    """Standard deviation of a delay that so many turns tell: what is near on one side moves as if
    it turned all through one of them."""
    if turns < 2:
        return _SEARCHED_S
    return min(float(np.sqrt(variance_s2)) * wider_by_few(turns), _SEARCHED_S)
