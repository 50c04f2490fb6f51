"""Whether another angle between beams makes far better sense of scans, before all is refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.slam.laser.scan_bundle import Shape, ShapePull, WindowFit, fit_window
from slamsim.slam.laser.scan_track import LaserTrack

MOST_WINDOWS = 8
SMALL_SCALE = 0.02
SURE_SIGMAS = 5.0
LARGE_MISFIT = 4.0
"""Variance of residuals, of what noise makes, from which on other angles are tried."""

SCALES = np.array([0.36, 0.45, 0.53, 0.62, 0.7, 0.78, 0.87, 1.15, 1.3, 1.5, 1.75, 2.05, 2.4])
FAR_BETTER, FAR_SHARPER = 0.6, 2.0
"""Share of the misfit that another angle must leave at most, and by how much more sharply the
scans must then tell it: a fan that folds up fits anything."""

LEAST_SCALE, LARGEST_SCALE = 0.3, 3.0
"""Sweeps beyond a third or three times what is declared are no error of the driver that a fit could
find from there."""
STEPS = 3
FIRST_WINDOWS = 4


@dataclass(frozen=True, slots=True)
class _Try:
    """misfit: variance of residuals. sharpness: mean logarithm of the information on the scale.
    step: where the windows would rather have it, and its sigma."""

    misfit: float
    sharpness: float
    step: float
    sigma: float


def rough_angle_scale(tracks: list[LaserTrack], fits: list[WindowFit], sweep_s: float) -> float:
    """True over taken angle between beams; 1 where the scans do not plainly contradict it.

    fits: of all windows as the scans are declared.
    """
    liveliest = _liveliest(tracks)
    if not liveliest:
        return 1.0
    some, here = [tracks[k] for k in liveliest], _of([fits[k] for k in liveliest])
    plain = abs(here.step) > max(SMALL_SCALE, SURE_SIGMAS * here.sigma)
    if not plain and here.misfit < LARGE_MISFIT:
        return 1.0
    starts = [1.0, *SCALES.tolist()]
    few = some[:FIRST_WINDOWS]
    scale = max(starts, key=lambda start: _tried(few, sweep_s, start).sharpness)
    for _ in range(STEPS):
        scale += float(np.clip(_tried(some, sweep_s, scale).step, -0.1, 0.1))
    if not LEAST_SCALE < scale < LARGEST_SCALE:
        return 1.0
    there = _tried(some, sweep_s, scale)
    better = there.misfit < FAR_BETTER * here.misfit
    sharper = there.sharpness > here.sharpness + np.log(FAR_SHARPER)
    return scale if better and sharper else 1.0


def _liveliest(tracks: list[LaserTrack]) -> list[int]:
    """The windows with most motion."""
    motion = [-float(np.abs(np.diff(track.poses, axis=0)).sum()) for track in tracks]
    order: list[int] = np.argsort(motion, kind="stable").tolist()
    return order[:MOST_WINDOWS]


def _tried(tracks: list[LaserTrack], sweep_s: float, scale: float) -> _Try:
    return _of([fit_window(track, Shape(sweep_s, scale, 0.0)) for track in tracks])


def _of(fits: list[WindowFit]) -> _Try:
    pull = ShapePull.of(fits)
    return _Try(
        misfit=float(np.median([fit.unit for fit in fits])),
        sharpness=float(np.log(np.maximum(pull.information[:, 1, 1], 1.0)).mean()),
        step=float(pull.step()[1]),
        sigma=float(pull.sigmas()[1]),
    )
