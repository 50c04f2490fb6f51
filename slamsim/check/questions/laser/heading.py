"""The heading of a robot whose scans do not turn, by the path of its laser.

Where rays are fixed to the world, the laser's own motion is known in axes that do not turn. A robot
on wheels goes where it heads; so the heading by another stream is corrected until the base, which
carries the laser on a lever, no longer moves sideways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import require_finite

STARTS = 24
ROBUST_SIGMAS = 3.0
LEAST_M = 1e-3
PLAINLY_LESS = 0.8
"""Only the lever tells ahead from astern; where it does not, robots mostly drive ahead."""

MIN_STEPS = 12


@dataclass(frozen=True, slots=True)
class HeadingFit:
    """Heading in the rays' axes: that of the stream, less drift_rad_s a second since its first
    message, plus offset_rad."""

    drift_rad_s: float
    offset_rad: float


def heading_by_path(
    steps: LaserSteps, motion: IntegratedMotion, column: int, lever_m: FloatArray
) -> HeadingFit | None:
    """The correction that makes the base move ahead only; None of too few steps.

    column: of the motion, its turn. lever_m: (2,) from the base to the laser. Stamps are taken
    as they are: scans that do not turn do not tell their offset.
    """
    require_finite("the lever of a laser", lever_m, (2,))
    begin, end = (
        np.asarray((stamps - motion.origin_ns) * 1e-9, dtype=np.float64)
        for stamps in (steps.first_ns, steps.second_ns)
    )
    covered = motion.covers(begin, end)
    if int(covered.sum()) < MIN_STEPS:
        return None
    begin, end = begin[covered], end[covered]
    turned = np.stack([motion.at(one)[:, column] for one in (begin, end)])
    at_s, moved = np.stack([begin, end]), steps.T_first_second[covered, :2]
    sigma_m = np.maximum(np.sqrt(2.0 / _least(steps.information[covered, :2, :2])), LEAST_M)

    def base_motion(unknown: FloatArray) -> FloatArray:
        heading = turned - unknown[0] * at_s + unknown[1]
        swung = _rotated(heading[1], lever_m) - _rotated(heading[0], lever_m)
        return _rotated(-0.5 * (heading[0] + heading[1]), moved - swung)

    def sideways(unknown: FloatArray) -> FloatArray:
        return np.asarray(base_motion(unknown)[:, 1] / sigma_m)

    starts = np.linspace([0.0, -np.pi], [0.0, np.pi], STARTS, endpoint=False)
    begun = min(starts, key=lambda start: float(np.minimum(np.abs(sideways(start)), 9.0).sum()))
    fits = [
        least_squares(sideways, begun + np.array([0.0, turn]), loss="cauchy", f_scale=ROBUST_SIGMAS)
        for turn in (0.0, np.pi)
    ]
    fits.sort(key=lambda fit: float(fit.cost))
    if fits[0].cost > PLAINLY_LESS * fits[1].cost:
        fits.sort(key=lambda fit: -float(base_motion(fit.x)[:, 0].sum()))
    drift, offset = fits[0].x.tolist()
    return HeadingFit(drift, float((offset + np.pi) % (2.0 * np.pi) - np.pi))


def _rotated(angle_rad: FloatArray, points_m: FloatArray) -> FloatArray:
    """(n, 2) points (n, 2) or one (2,), each turned by its angle (n,)."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points_m[..., 0], points_m[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _least(information: FloatArray) -> FloatArray:
    """(n,) smaller eigenvalue of symmetric matrices (n, 2, 2), never zero."""
    return np.asarray(np.maximum(np.linalg.eigvalsh(information)[:, 0], 1e-6))
