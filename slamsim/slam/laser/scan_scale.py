"""Whether another angle between beams, or another sweep, makes far better sense of scans, before
all is refined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import IntArray
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

SCALES = np.geomspace(0.3, 4.0, 20)
"""From one to the next 15 %: from 10 % off one step led to within 1 % of the right angle on some 40
recordings (slamsim's simulator, five lidars; angles of half to twice the right ones, every second
and third beam)."""

A_TURN_RAD = 1.1 * 2.0 * np.pi
"""A fan that is wider than this folds up, and then fits anything: only the declared one may be."""

FAR_SHARPER = 2.0
"""By how much more sharply scans must tell another shape. On those 40 recordings the right angle
was told 2.6 to 20,000 times as sharply as the wrong one that was declared; 18 healthy ones, fans of
40 to 360 degrees, led nowhere where it was told more sharply. How well surfaces fit tells nothing:
with wrong angles hardly any is seen again, and those few may fit."""

STEPS = 3
FIRST_WINDOWS = 4

OTHER_ORDER = 0.25
"""Step that scans want, as a share of the declared sweep, from which on other orders of the beams
are tried: of a backward sweep, which is off by 2, it was 0.38 to 1 on six drives."""

SWEEP, ANGLE_SCALE = 0, 1
"""Places among the numbers of a ``Shape``."""


Look = Callable[[list[IntArray], float], list[WindowFit]]
"""Windows, tracked and bundled with the sweep as declared and so many times the declared angles."""


@dataclass(frozen=True, slots=True)
class _Try:
    """misfit: variance of residuals. sharpness: mean logarithm of the information on one number of
    the shape. step: where the windows would rather have it, and its sigma."""

    misfit: float
    sharpness: float
    step: float
    sigma: float


def rough_angle_scale(
    tracks: list[LaserTrack], fits: list[WindowFit], span_rad: float, look: Look
) -> float:
    """True over declared angle between beams; 1 where the scans do not plainly contradict it.

    fits: of all windows as the scans are declared. span_rad: of the declared fan.

    Scans are followed anew with each angle: with half of the right one they turn half as far, and
    no fit that begins there finds which walls are the same.
    """
    liveliest = _liveliest(tracks)
    if not liveliest:
        return 1.0
    some = [tracks[k].scans for k in liveliest]
    here = _of([fits[k] for k in liveliest], ANGLE_SCALE)
    told = abs(here.step) + SURE_SIGMAS * here.sigma < SMALL_SCALE
    if told and here.misfit < LARGE_MISFIT and span_rad < A_TURN_RAD:
        return 1.0
    few = some[:FIRST_WINDOWS]

    def tried(scale: float, windows: list[IntArray] = few) -> _Try:
        return _of(look(windows, scale), ANGLE_SCALE, len(windows), scale)

    starts = [start for start in SCALES.tolist() if start * span_rad < A_TURN_RAD]
    scale = max(starts, key=lambda start: tried(start).sharpness, default=1.0)
    for _ in range(STEPS):
        scale *= 1.0 + float(np.clip(tried(scale).step, -0.1, 0.1))
    if scale * span_rad >= A_TURN_RAD:
        return 1.0
    there = tried(scale, some)
    return scale if _sharper(there, here) else 1.0


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


def _of(fits: list[WindowFit], number: int, looked_at: int = 0, scale: float = 1.0) -> _Try:
    """looked_at: how many windows there are; those in which nothing fits tell nothing. scale: of
    the angles. A wider fan is asked how sharply it tells the declared angle, which is less."""
    if not fits:
        return _Try(np.inf, 0.0, 0.0, np.inf)
    pull = ShapePull.of(fits)
    told = np.log(np.maximum(pull.information[:, number, number] / max(scale, 1.0) ** 2, 1.0))
    return _Try(
        misfit=float(np.median([fit.unit for fit in fits])),
        sharpness=float(told.sum()) / max(looked_at, len(fits)),
        step=float(pull.step()[number]),
        sigma=float(pull.sigmas()[number]),
    )
