"""Whether another angle between beams, or another sweep, makes far better sense of scans, before
all is refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.slam.laser.scan_bundle import (
    MAX_STEP,
    Shape,
    ShapePull,
    WindowFit,
    fit_windows,
)
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

OTHER_ORDER = 0.25
"""Step that scans want, as a share of the declared sweep, from which on other orders of the beams
are tried: of a backward sweep, which is off by 2, it was 0.38 to 1 on six drives."""

SWEEP, ANGLE_SCALE = 0, 1
"""Places among the numbers of a ``Shape``."""


@dataclass(frozen=True, slots=True)
class _Try:
    """misfit: variance of residuals. sharpness: mean logarithm of the information on one number of
    the shape. step: where the windows would rather have it, and its sigma."""

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
    some, here = [tracks[k] for k in liveliest], _of([fits[k] for k in liveliest], ANGLE_SCALE)
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
    return scale if better and _sharper(there, here) else 1.0


def rough_sweep_s(tracks: list[LaserTrack], fits: list[WindowFit], declared_s: float) -> float:
    """From the first beam to the last, roughly, where no sweep or a backward one makes far better
    sense of the scans; else as declared.

    So far off a single step tells neither the sweep nor how sure it is: 0.2 s that ran backward
    looked like 0.02 +- 0.03 s, no surer than a lidar is believed to be right.
    """
    if not tracks:
        return declared_s
    here = _of(fits, SWEEP)
    if not abs(here.step) > OTHER_ORDER * abs(declared_s) > 0.0:
        return declared_s

    def refitted(sweep_s: float) -> _Try:
        return _of(fit_windows(tracks, Shape(sweep_s, 1.0, 0.0), fits), SWEEP)

    sweep_s, there = max(
        ((start_s, refitted(start_s)) for start_s in (0.0, -declared_s)),
        key=lambda tried: tried[1].sharpness,
    )
    for _ in range(STEPS):
        sweep_s += float(np.clip(there.step, -MAX_STEP[SWEEP], MAX_STEP[SWEEP]))
        there = refitted(sweep_s)
    return sweep_s if there.misfit < here.misfit and _sharper(there, here) else declared_s


def _sharper(there: _Try, here: _Try) -> bool:
    return there.sharpness > here.sharpness + float(np.log(FAR_SHARPER))


def _liveliest(tracks: list[LaserTrack]) -> list[int]:
    """The windows with most motion."""
    motion = [-float(np.abs(np.diff(track.poses, axis=0)).sum()) for track in tracks]
    order: list[int] = np.argsort(motion, kind="stable").tolist()
    return order[:MOST_WINDOWS]


def _tried(tracks: list[LaserTrack], sweep_s: float, scale: float) -> _Try:
    return _of(fit_windows(tracks, Shape(sweep_s, scale, 0.0)), ANGLE_SCALE)


def _of(fits: list[WindowFit], number: int) -> _Try:
    pull = ShapePull.of(fits)
    return _Try(
        misfit=float(np.median([fit.unit for fit in fits])),
        sharpness=float(np.log(np.maximum(pull.information[:, number, number], 1.0)).mean()),
        step=float(pull.step()[number]),
        sigma=float(pull.sigmas()[number]),
    )
