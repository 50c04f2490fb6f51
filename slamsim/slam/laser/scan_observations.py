"""Pieces of all scans of a window as observations: two points each, when seen, how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.laser.scan_sweep import beams_of, share_of_piece
from slamsim.slam.laser.scan_track import LaserTrack
from slamsim.slam.matching.surfaces import BEAMS, SCATTER_XX, SCATTER_XY, SCATTER_YY, X, Y

NOISE_BEAMS = 5.0
"""The noise of a range as known beforehand counts as much as so many beams of a piece."""

SMOOTH_M = 0.001
"""How straight surfaces are at best."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """points: (k, 2, 2) two points that have the mean of each piece and its spread along the
    surface, as the scan has them. shares, angles: (k, 2) when and where in the sweep, from the
    middle beam. variance: (k,) of the mean across the surface. views: (k,) the scan."""

    points: FloatArray
    shares: FloatArray
    angles: FloatArray
    variance: FloatArray
    views: IntArray

    def only(self, some: IntArray) -> Observations:
        """Some of them, in that order."""
        return Observations(
            self.points[some],
            self.shares[some],
            self.angles[some],
            self.variance[some],
            self.views[some],
        )


def observations(track: LaserTrack) -> Observations:
    """All pieces of a window, one observation each."""
    pieces = np.concatenate(track.pieces)
    views = np.repeat(np.arange(len(track.pieces)), [len(one) for one in track.pieces])
    beams = pieces[:, BEAMS]
    xx, xy, yy = pieces[:, SCATTER_XX], pieces[:, SCATTER_XY], pieces[:, SCATTER_YY]
    middle, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    axis = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    half = np.sqrt((middle + root) / beams)[:, None] * np.stack([np.cos(axis), np.sin(axis)], 1)
    across = np.maximum(middle - root, 0.0) + NOISE_BEAMS * track.noise_m**2
    mean = pieces[:, [X, Y]]
    points = np.stack([mean - half, mean + half], axis=1)
    shares = [
        share_of_piece(points[views == k], beams_of(one, sweep), sweep)
        for k, (one, sweep) in enumerate(zip(track.pieces, track.sweeps, strict=True))
    ]
    span = np.array([sweep.step_rad * (sweep.beams - 1) for sweep in track.sweeps])[views]
    share = np.concatenate(shares)
    return Observations(
        points=points,
        shares=share,
        angles=share * span[:, None],
        variance=across / (beams + NOISE_BEAMS - 2.0) / beams + SMOOTH_M**2,
        views=views.astype(np.int64),
    )
