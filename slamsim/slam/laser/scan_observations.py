"""Pieces of all scans of a window as observations: two points each, when seen, how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.types import FloatArray, IntArray
from slamsim.models.line_bundle import moments_of
from slamsim.slam.laser.scan_sweep import beams_of, share_of_piece
from slamsim.slam.laser.scan_track import LaserTrack
from slamsim.slam.matching.surfaces import BEAMS, MEAN, SCATTER

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
    moments = moments_of(pieces[:, MEAN], pieces[:, SCATTER], pieces[:, BEAMS], track.noise_m)
    points = moments.points_m
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
        variance=moments.variance + SMOOTH_M**2,
        views=views.astype(np.int64),
    )
