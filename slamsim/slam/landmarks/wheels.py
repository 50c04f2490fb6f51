"""What wheels and gyroscope get wrong along a path that tags hold: alike everywhere, and by chance.

Errors that are alike everywhere (sizes of wheels, track, one wheel beside the other) are unknowns
with a prior, as those of a camera are. How large the others are is learnt where no scan tells it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import rotation
from slamsim.core.result import Calibrated, GraphEdge
from slamsim.core.types import BoolArray, FloatArray
from slamsim.slam.calibration.online import PRIOR_SIGMAS
from slamsim.slam.landmarks.joint import SHARED, JointSolver

NUMBERS = (("turn_scale", 1), ("curvature_rad_per_m", 2), ("path_scale", 0))
"""Of ``SlamResult.calibration``, and their places in ``PRIOR_SIGMAS``; the last is a scale, as that
of a camera is."""
LEAST = 1e-4
"""No wheels are known better: a tenth of a millimetre in a metre."""
FREEDOM = 1.0
"""What is assumed of a noise counts as one observation of it: known to a factor of about two."""


def wheel_sigmas(calibration: Mapping[str, Calibrated]) -> FloatArray:
    """(6,) standard deviations of the errors of ``wheel_slopes``: as scans tell them, or as assumed
    of wheels; the others are unused."""
    found = np.ones(SHARED)
    for k, (name, place) in zip((0, 1, SHARED - 1), NUMBERS, strict=True):
        found[k] = calibration[name].sigma if name in calibration else PRIOR_SIGMAS[place]
    return np.maximum(found, LEAST)


def wheel_slopes(edge: GraphEdge) -> FloatArray:
    """(3, 6) how errors of what told a step move its end in its own frame: turn scale, curvature
    (rad/m), three that are unused, and path scale, as ``models.wheel_gyro`` has them; by the chord
    of an arc."""
    x, y, turn = edge.T_source_target
    chord = rotation(-turn)[:2, :2] @ [x, y]
    forward = np.cos(0.5 * turn) * x + np.sin(0.5 * turn) * y
    arc = forward / np.sinc(0.5 * turn / np.pi)
    by_turn = 0.5 * np.array([-chord[1], chord[0]]) - turn / 12.0 * chord
    found = np.zeros((3, SHARED))
    found[:, :2] = np.outer([*by_turn, 1.0], [turn, arc])
    found[:2, -1] = chord
    return found


def learnt_noise(
    assumed: Sequence[GraphEdge], blind: BoolArray, solver: JointSolver
) -> tuple[GraphEdge, ...]:
    """The first m edges of a solver, those that are blind (m,) with variances as they turn out:
    of the assumed ones, times one factor for each of x, y and yaw (Helmert's variance components;
    Foerstner 1979)."""
    those = np.flatnonzero(blind)
    steps = [assumed[k] for k in those.tolist()]
    off, claimed, explained = solver.fit_of(those)
    turns = rotation(np.array([edge.T_source_target[2] for edge in steps]))
    told = np.array([edge.covariance for edge in steps])
    own = np.diagonal(told, axis1=1, axis2=2)
    now = np.diagonal(turns @ claimed @ np.swapaxes(turns, 1, 2), axis1=1, axis2=2)
    fitted = np.diagonal(turns @ explained @ np.swapaxes(turns, 1, 2), axis1=1, axis2=2)
    squares = np.square(np.einsum("mij,mj->mi", turns, off)) / own
    freedom = (1.0 - fitted / now).sum(axis=0)
    factors = (squares.sum(axis=0) + FREEDOM) / (freedom + FREEDOM)
    widened = np.sqrt(factors)
    found = list(assumed)
    for k, edge in zip(those.tolist(), steps, strict=True):
        covariance = widened[:, None] * edge.covariance * widened
        found[k] = replace(edge, covariance=covariance)
    return tuple(found)
