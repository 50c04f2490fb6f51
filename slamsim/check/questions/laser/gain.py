"""Rotation gain of the scans: their rotation over that of gyroscope or wheels; 1 is healthy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.motion.alignment import Shift
from slamsim.check.motion.clustered import clustered_covariance
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.motion.robust import scatter
from slamsim.core.types import FloatArray, IntArray

ROUNDS = 6
HUBER = 1.345
LEAST_NOISE_RAD = 5e-4
MOST_LAG_S = 0.1
"""The lag found by correlation is refined by no more than this."""

MIN_STEPS = 12
WILD_RAD_S = 2.0
"""Faster turns count as this fast: they are made by single wild stamps."""


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """Turn of the scans over that of another stream, fitted with a lag and a drift.

    value, sigma: of the gain. correlation: of both turns. ratio: of their mean turn rates, without
    regard to sign and when. turned_rad: how far the other stream turned in all. scans_rad_s,
    other_rad_s: (n,) turn rates, the latter at the fitted lag.
    """

    topic: str
    value: float
    sigma: float
    correlation: float
    ratio: float
    turned_rad: float
    scans_rad_s: FloatArray
    other_rad_s: FloatArray


def turn_gain(
    steps: LaserSteps, motion: IntegratedMotion, column: int, shift: Shift | None
) -> Gain | None:
    """Robust regression (Huber 1981), its interval by windows (sandwich); None of too few steps.

    column: of the motion, its turn. shift: how much later the stamps of the motion are, roughly.
    """
    since_ns = (shift.shift_ns if shift is not None else 0) - motion.origin_ns
    begin = np.asarray((steps.first_ns + since_ns) * 1e-9, dtype=np.float64)
    end = np.asarray((steps.second_ns + since_ns) * 1e-9, dtype=np.float64)
    covered = motion.covers(begin, end)
    if int(covered.sum()) < MIN_STEPS:
        return None
    begin, end = begin[covered], end[covered]
    turned, window = steps.T_first_second[covered, 2], steps.window[covered]
    lasted = end - begin
    lag, half = 0.0, 0.005
    for _ in range(2):
        other = _turn(motion, column, begin + lag, end + lag)
        later = _turn(motion, column, begin + (lag + half), end + (lag + half))
        sooner = _turn(motion, column, begin + (lag - half), end + (lag - half))
        columns = np.column_stack([other, (later - sooner) / (2.0 * half), lasted])
        fitted, covariance = _regression(columns, turned, window)
        if abs(fitted[0]) > 1e-3:
            lag = float(np.clip(lag + fitted[1] / fitted[0], -MOST_LAG_S, MOST_LAG_S))
    ours, theirs = (
        float(np.minimum(np.abs(one / lasted), WILD_RAD_S).mean()) for one in (turned, other)
    )
    return Gain(
        topic=motion.topic,
        value=float(fitted[0]),
        sigma=float(np.sqrt(covariance[0, 0])),
        correlation=_correlation(turned, other),
        ratio=ours / max(theirs, 1e-12),
        turned_rad=float(np.abs(other).sum()),
        scans_rad_s=turned / lasted,
        other_rad_s=other / lasted,
    )


def _turn(
    motion: IntegratedMotion, column: int, begin_s: FloatArray, end_s: FloatArray
) -> FloatArray:
    return np.asarray((motion.at(end_s) - motion.at(begin_s))[:, column])


def _correlation(one: FloatArray, other: FloatArray) -> float:
    scale = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    return float((one * other).sum() / scale) if scale > 0.0 else 0.0


def _regression(
    columns: FloatArray, wanted: FloatArray, group: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (k,) and their covariance, residuals of one group hanging together."""
    scale = np.maximum(np.sqrt(np.mean(np.square(columns), axis=0)), 1e-9)
    rows = columns / scale
    weights = np.ones(len(wanted))
    ridge = 1e-9 * len(wanted) * np.eye(rows.shape[1])
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(rows.T @ (rows * weights[:, None]) + ridge)
        fitted = inverse @ (rows.T @ (weights * wanted))
        left = wanted - rows @ fitted
        noise = scatter(left, LEAST_NOISE_RAD)
        weights = 1.0 / np.maximum(np.abs(left) / (HUBER * noise), 1.0)
    groups, block = np.unique(group, return_inverse=True)
    scores = rows * (weights * left)[:, None]
    plain = noise**2 * inverse
    covariance = clustered_covariance(inverse, scores, block) if groups.size > 2 else plain
    larger = np.maximum(np.diag(covariance), np.diag(plain))
    return fitted / scale, np.diag(larger / scale**2)
