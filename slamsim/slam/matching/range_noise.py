"""How far ranges are off: by the scatter about surfaces, and by the steps that they are read in."""

from __future__ import annotations

import numpy as np

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
    """The step of which readings (n,) are multiples, but for a constant; 0 if none is evident, None
    if so few readings would not show one."""
    written = np.unique(np.round(readings_m / SAME_M))
    if written.size < LEAST_VALUES:
        return None
    values = written[np.diff(written, prepend=-np.inf) > 1.5]
    if values.size < LEAST_VALUES:
        return 0.0
    apart = np.diff(values)
    step = float(np.quantile(apart, USUAL_STEP))
    if readings_m.size < LEAST_EACH * values.size:
        return 0.0 if step * SAME_M <= COARSE_STEP_M else None
    off = np.abs(apart / step - np.round(apart / step))
    return step * SAME_M if float(np.mean(off < OFF_SHARE)) >= MULTIPLES else 0.0
