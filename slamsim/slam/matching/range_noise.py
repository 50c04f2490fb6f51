"""How far ranges are off: by the scatter about surfaces, and by the steps that they are read in."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.matching.surfaces import range_noise_m

START_NOISE_M = 0.015
"""Between that of a good (5 mm) and of a coarse lidar (30 mm); after ten scans it is forgotten."""
NOISE_BOUNDS_M = (0.002, 0.05)
"""Walls of rooms are no flatter than 2 mm; beyond 5 cm no surface is found in a scan."""
NOISE_GAIN = 0.1
"""The mean of some ten scans."""

STEP_SIGMA = 12.0**-0.5
"""Standard deviation of what rounding to whole steps changes, in steps."""

FEW_READINGS, MOST_READINGS = 1000, 16_000
"""Steps are looked for in so many readings at first, then each time that there are twice as many:
the last number shows steps of 5 cm over 80 m."""

LEAST_VALUES, LEAST_EACH = 5, 10
"""So many different readings, each so often on average, show that they are steps."""

SAME_M = 1e-4
"""Multiples written as floats are no farther off; no lidar reads in such small steps."""

USUAL_STEP = 0.1
"""Quantile of the distances between neighbouring values: some values do not occur."""

MULTIPLES, OFF_SHARE = 0.99, 0.02
"""Such a share of the distances are whole steps, but for this share of one."""

CROWDED_BIN_M = 1e-3
"""Readings are counted in such bins: a fifth of the noise that hides the smallest step below."""

CROWDED_STEPS_M = (0.01, 0.3)
"""Smaller steps leave less (3 mm) than what any lidar scatters by; rooms have rows of pillars and
shelves at longer ones."""

CROWDED_REACH_M = 100.0
"""Readings beyond say nothing more, and take long where they are in other units than metres."""

EVEN_OVER_M = 0.6
"""Readings of each stretch of two of the longest steps count alike, however often each was seen."""

FINER = 4
"""Frequencies are a quarter of what the readings tell apart: at most 3 % of a peak is missed."""

CROWDED_SHARE = 0.5
"""Length of the mean of the readings' phases within a step: it falls so far (exp(-2 (pi sigma)^2))
where the noise that came after has 0.19 steps, and has made up for what the steps hide."""

CROWDED_PROOF = 20.0
"""One in 1e4 (Rayleigh's test: exp(-n R^2) for n readings) that readings look as if they kept one
of the some 40,000 steps of 1 cm to 0.3 m that differ over 80 m, and keep none."""

COARSE_STEP_M = 0.05
"""A usual cell of a map: rounding moves walls into the next one. Lidars read in steps of 1 mm to
1 cm (SICK LMS 200)."""


class RangeNoise:
    """Standard deviation of a range, learnt scan by scan.

    Where beams lie close together, each step of ranges that are rounded looks like a piece of wall
    square to the beams. Their scatter about such pieces is what the lidar's own noise leaves, far
    less than a step: no surface may be claimed to be known better than by rounding.
    """

    def __init__(self) -> None:
        self.sigma_m = START_NOISE_M
        self._least_m = NOISE_BOUNDS_M[0]
        self._readings: list[FloatArray] = []
        self._count, self._next = 0, FEW_READINGS

    def see(self, cloud: Cloud) -> None:
        """Look for steps in the ranges of one more scan, before it is cut into surfaces."""
        if self._next > MOST_READINGS:
            return
        beams_m = (cloud.points_m - cloud.origins_m)[cloud.hit]
        self._readings.append(np.hypot(beams_m[:, 0], beams_m[:, 1]))
        self._count += len(beams_m)
        if self._count < self._next:
            return
        self._next = 2 * self._count
        step_m = rounding_step_m(np.concatenate(self._readings)) or 0.0
        if step_m > 0.0 or self._next > MOST_READINGS:
            self._next = MOST_READINGS + 1
            self._readings.clear()
        self._least_m = float(np.clip(STEP_SIGMA * step_m, *NOISE_BOUNDS_M))
        self.sigma_m = max(self.sigma_m, self._least_m)

    def learn(self, pieces: FloatArray) -> None:
        """Follow what the (k, PIECE_FIELDS) surfaces of a scan show."""
        seen_m = range_noise_m(pieces)
        if np.isfinite(seen_m):
            mixed_m = self.sigma_m + NOISE_GAIN * (seen_m - self.sigma_m)
            self.sigma_m = float(np.clip(mixed_m, self._least_m, NOISE_BOUNDS_M[1]))


def rounding_step_m(readings_m: FloatArray) -> float | None:
    """The step of which readings (n,) are multiples, but for a constant and for noise that came
    after the rounding; 0 if none is evident, None if so few readings would not show one."""
    written = np.unique(np.round(readings_m / SAME_M))
    if written.size < LEAST_VALUES:
        return None
    step_m = _written_step_m(written, readings_m.size)
    if step_m is None or step_m >= CROWDED_STEPS_M[0]:
        return step_m
    return max(step_m, _crowded_step_m(readings_m))


def _written_step_m(written: FloatArray, readings: int) -> float | None:
    """The step of which all values are multiples, written in multiples of SAME_M."""
    values = written[np.diff(written, prepend=-np.inf) > 1.5]
    if values.size < LEAST_VALUES:
        return 0.0
    apart = np.diff(values)
    step = float(np.quantile(apart, USUAL_STEP))
    if readings < LEAST_EACH * values.size:
        return 0.0 if step * SAME_M <= COARSE_STEP_M else None
    off = np.abs(apart / step - np.round(apart / step))
    return step * SAME_M if float(np.mean(off < OFF_SHARE)) >= MULTIPLES else 0.0


def _crowded_step_m(readings_m: FloatArray) -> float:
    """The step about whose multiples readings (n,) crowd, but for a constant; 0 if about none.

    Simulators that follow a beam in steps and add noise to where it ends write such ranges. The
    readings' periodogram (their phases within each step, averaged) is that of counts in small bins.
    Each stretch weighs as much as any other, and no step gets more than one vote a multiple of it
    that was read: what a robot at rest reads again and again proves nothing.
    """
    bins = ((readings_m - readings_m.min()) / CROWDED_BIN_M).astype(np.int64)
    bins = bins[bins < CROWDED_REACH_M / CROWDED_BIN_M]
    counts = np.bincount(bins).astype(np.float64)
    nearby = uniform_filter1d(counts, round(EVEN_OVER_M / CROWDED_BIN_M), mode="constant")
    weights = counts / np.maximum(nearby, 1e-12)
    padded = FINER * weights.size
    shares = np.abs(np.fft.rfft(weights, padded))
    cycles = np.arange(shares.size) / (padded * CROWDED_BIN_M)
    within = (cycles >= 1.0 / CROWDED_STEPS_M[1]) & (cycles <= 1.0 / CROWDED_STEPS_M[0])
    if not within.any():
        return 0.0
    best = int(np.argmax(np.where(within, shares, 0.0)))
    share, step_m = shares[best] / shares[0], 1.0 / cycles[best]
    votes = min(
        np.unique((bins * CROWDED_BIN_M / step_m).astype(np.int64)).size,
        shares[0] ** 2 / np.sum(weights**2),
    )
    proven = share >= CROWDED_SHARE and votes * share**2 >= CROWDED_PROOF
    return float(step_m) if proven else 0.0
