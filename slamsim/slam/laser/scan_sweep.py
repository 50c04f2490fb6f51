"""Where each surface piece of a scan was seen from, if its beams fired one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, wrap_angle
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.matching.local_map import move_piece
from slamsim.slam.matching.surfaces import X, Y

BACKWARD_RAD = 0.5
"""Neighbouring pieces lie no farther than this in the wrong order, however noisy they are."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """How the beams of a scan lie: first_rad and step_rad as they are taken, how many there are,
    and how long the sweep from the first to the last lasts as declared."""

    first_rad: float
    step_rad: float
    beams: int
    declared_s: float

    @property
    def middle_rad(self) -> float:
        """Direction of the middle beam."""
        return self.first_rad + 0.5 * self.span_rad

    @property
    def span_rad(self) -> float:
        """Angle from the first beam to the last; negative for a sweep clockwise from above."""
        return self.step_rad * max(self.beams - 1, 1)


def beams_of(pieces: FloatArray, sweep: Sweep) -> FloatArray:
    """(k,) share of the sweep at which the middle of each piece was seen: -0.5 by the first beam,
    0.5 by the last. The pieces are in the order of their beams, which may go round more than once.
    """
    bearing = np.arctan2(pieces[:, Y], pieces[:, X])
    turned = np.sign(sweep.step_rad) * np.diff(bearing, prepend=sweep.first_rad)
    forward = (turned + BACKWARD_RAD) % (2.0 * np.pi) - BACKWARD_RAD
    return np.asarray(np.cumsum(forward) / abs(sweep.span_rad) - 0.5)


def share_of_piece(points: FloatArray, middles: FloatArray, sweep: Sweep) -> FloatArray:
    """(k, 2) the same of points (k, 2, 2) beside the middles (k,) of pieces."""
    bearing = np.arctan2(points[..., 1], points[..., 0])
    middle = middles[:, None] * sweep.span_rad + sweep.middle_rad
    return np.asarray(middles[:, None] + wrap_angle(bearing - middle) / sweep.span_rad)


def steady(velocity: FloatArray) -> FloatArray:
    """(2, 3) motion about the middle of a sweep: velocity (3,) in its frame, no acceleration."""
    return np.stack([velocity, np.zeros(3)])


@kernel
def moved_pieces(
    pieces: FloatArray, shares: FloatArray, motion: FloatArray, shape: tuple[float, float, float]
) -> FloatArray:
    """The pieces as seen from where the laser was when its middle beam fired.

    shares: (k,) of the sweep, as from ``beams_of``. motion: (2, 3) first and half the second
    derivative of the laser's pose, in its frame at the middle. shape: length of the sweep in
    seconds, angle to add over the whole of it, and by how much ranges are too long.
    """
    sweep_s, wider_rad, offset_m = shape
    out = np.empty_like(pieces)
    for k in range(pieces.shape[0]):
        after = shares[k] * sweep_s
        x = after * (motion[0, 0] + after * motion[1, 0])
        y = after * (motion[0, 1] + after * motion[1, 1])
        yaw = after * (motion[0, 2] + after * motion[1, 2]) + shares[k] * wider_rad
        move_piece(pieces[k], (x, y, np.cos(yaw), np.sin(yaw)), out[k])
        shorter = offset_m / max(np.hypot(pieces[k, X], pieces[k, Y]), 1e-6)
        out[k, X] -= shorter * (out[k, X] - x)
        out[k, Y] -= shorter * (out[k, Y] - y)
    return out


def local_motion(poses: FloatArray, elapsed_s: FloatArray) -> FloatArray:
    """(n, 2, 3) first and half the second derivative of each pose (n, 3) in its own frame, n > 4.

    From the polynomial through it and two neighbours on either side; near the ends from the
    parabola through it and the two next.
    """
    motion = _by_neighbours(poses, elapsed_s, reach=1)
    motion[2:-2] = _by_neighbours(poses, elapsed_s, reach=2)[2:-2]
    return motion


def velocity_weights(elapsed_s: FloatArray) -> FloatArray:
    """(n, n) what a small step of each pose adds to each first derivative of ``local_motion``."""
    weights = np.zeros((len(elapsed_s),) * 2)
    for reach, ends in ((1, 0), (2, 2)):
        here = np.arange(ends, len(elapsed_s) - ends)
        others, powers = _around(elapsed_s, reach)
        weights[here] = 0.0
        weights[here[:, None], others[here]] = np.linalg.inv(powers[here])[:, 0]
    weights -= np.diag(weights.sum(axis=1))
    return weights


def _by_neighbours(poses: FloatArray, elapsed_s: FloatArray, reach: int) -> FloatArray:
    """The same from ``reach`` neighbours on either side, of as many others at the ends."""
    others, powers = _around(elapsed_s, reach)
    return np.asarray(np.linalg.solve(powers, between(poses[:, None], poses[others])))[:, :2]


def _around(elapsed_s: FloatArray, reach: int) -> tuple[IntArray, FloatArray]:
    """(n, 2 reach) the neighbours of each pose, and (n, 2 reach, 2 reach) the powers of the time to
    them that the derivatives of a polynomial are multiplied by."""
    here, around = np.arange(len(elapsed_s)), np.arange(-reach, reach + 1)
    middle = np.clip(here, reach, len(elapsed_s) - 1 - reach)
    window = middle[:, None] + around
    others = window[window != here[:, None]].reshape(-1, 2 * reach)
    after = elapsed_s[others] - elapsed_s[:, None]
    return others, after[..., None] ** np.arange(1, 2 * reach + 1)
