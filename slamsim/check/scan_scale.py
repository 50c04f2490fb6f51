"""Whether another angle between beams makes far better sense of scans, before all is refined."""

from __future__ import annotations

import numpy as np

from slamsim.check.scan_bundle import Shape, ShapePull, fit_window
from slamsim.check.scan_track import Track
from slamsim.types import FloatArray

MOST_WINDOWS = 8
SMALL_SCALE = 0.02
SURE_SIGMAS = 5.0
LARGE_MISFIT = 4.0
"""Variance of residuals, of what noise makes, from which on other angles are tried."""

SCALES = np.array([0.36, 0.45, 0.53, 0.62, 0.7, 0.78, 0.87, 1.15, 1.3, 1.5, 1.75, 2.05, 2.4])
FAR_BETTER = 0.6
"""Share of the misfit that another angle must leave at most."""

STEPS = 3


def rough_angle_scale(tracks: list[Track], sweep_s: float) -> float:
    """True over taken angle between beams; 1 where the scans do not plainly contradict it."""
    some = _liveliest(tracks)
    if not some:
        return 1.0
    misfit, step, sigma = _tried(some, sweep_s, 1.0)
    plain = abs(step) > SMALL_SCALE and abs(step) > SURE_SIGMAS * sigma
    if not plain and misfit < LARGE_MISFIT:
        return 1.0
    starts = [1.0, *SCALES.tolist()]
    begun = min(starts, key=lambda scale: _tried(some[:4], sweep_s, scale)[0])
    scale = begun
    for _ in range(STEPS):
        scale += float(np.clip(_tried(some, sweep_s, scale)[1], -0.1, 0.1))
    left = _tried(some, sweep_s, scale)[0]
    return scale if left < FAR_BETTER * misfit else 1.0


def _liveliest(tracks: list[Track]) -> list[Track]:
    """The windows with most motion."""

    def motion(track: Track) -> float:
        moved: FloatArray = np.abs(np.diff(track.poses, axis=0))
        return float(moved.sum())

    return sorted(tracks, key=motion, reverse=True)[:MOST_WINDOWS]


def _tried(tracks: list[Track], sweep_s: float, scale: float) -> tuple[float, float, float]:
    """Misfit at a scale, and where the windows would rather have it, with its sigma."""
    fits = [fit_window(track, Shape(sweep_s, scale, 0.0)) for track in tracks]
    pull = ShapePull.of(fits)
    misfit = float(np.median([fit.unit for fit in fits]))
    return misfit, float(pull.step()[1]), float(pull.sigmas()[1])
