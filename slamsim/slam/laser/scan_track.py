"""Scan after scan of a window laid onto the ones before, at constant velocity, without any help."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_sweep import Sweep, beams_of, moved_pieces, steady
from slamsim.slam.matching.base import Match
from slamsim.slam.matching.line import LineMatcher

MIN_PIECES = 5
GOOD_FIT = 0.55
"""A match is believed when this share of the scan lies on the map."""

MAX_SEARCHES = 3
"""Scans of one window that may be searched for; searching is slow, and lost is lost."""

UNKNOWN_M_S, UNKNOWN_RAD_S = 1.0, 2.0
"""How fast the lidar may move when nothing is known of it yet."""

CHANGE_M_S2, CHANGE_RAD_S2 = 3.0, 10.0
"""What the velocity of a robot on wheels may change by: some 0.3 g, and a turn of a second."""
LEAST_M, LEAST_RAD = 0.02, 0.02
"""Of a guess after no time at all: what the match before it is off by, at most."""

SCATTER = 0.3
"""Stamps no farther than this from whole periods, as a share of one, scatter about them."""

BURST, MOST_MISSING = 0.15, 20.0
"""Scans come no closer together, and no farther apart, than so many periods."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserTrack:
    """The scans of a window that could be tracked, and where roughly.

    scans: (n,) indices. elapsed_s: (n,) after the first. poses: (n, 3) of the laser when the
    middle beam fired, in the frame of the first. pieces: n of (k, PIECE_FIELDS), each as seen by
    its own beams. sweeps: how beams and angles of each scan hang together.
    """

    scans: IntArray
    elapsed_s: FloatArray
    poses: FloatArray
    pieces: tuple[FloatArray, ...]
    sweeps: tuple[Sweep, ...]
    noise_m: float


def track_window(
    reader: BeamReader, window: IntArray, stamps: tuple[IntArray, float]
) -> LaserTrack:
    """Follow the scans of a window until one of them fits nowhere.

    stamps: of all scans, in ns, and the usual period between neighbours in seconds. window: (k,) of
    their numbers, stamps (n,).
    """
    elapsed_s = _elapsed_s(window, *stamps)
    matcher = LineMatcher(FrontEndConfig())
    pieces, sweeps, poses = [], [], [np.zeros(3)]
    velocity, searches = np.zeros(3), 0
    for k, scan in enumerate(window.tolist()):
        found = matcher.pieces(reader.cloud(scan))
        if len(found) < MIN_PIECES:
            break
        sweep = reader.sweep(scan)
        lasted = float(elapsed_s[k] - elapsed_s[k - 1]) if k else 0.0
        shares, shape = beams_of(found, sweep), (sweep.declared_s, 0.0, 0.0)
        still = moved_pieces(found, shares, steady(velocity), shape)
        if k:
            guess = compose(poses[-1], velocity * lasted)
            match, searched = _place(matcher, still, guess, _doubt(lasted, known=k > 1))
            searches += searched
            if match is None or searches > MAX_SEARCHES:
                break
            velocity = between(poses[-1], match.T_map_base) / lasted
            poses.append(match.T_map_base)
            still = moved_pieces(found, shares, steady(velocity), shape)
        matcher.insert_pieces(still, poses[-1])
        pieces.append(found)
        sweeps.append(sweep)
    count = len(pieces)
    return LaserTrack(
        window[:count],
        elapsed_s[:count],
        np.array(poses[:count]).reshape(-1, 3),
        tuple(pieces),
        tuple(sweeps),
        matcher.range_noise_m,
    )


def _place(
    matcher: LineMatcher, pieces: FloatArray, guess: FloatArray, doubt: FloatArray
) -> tuple[Match | None, bool]:
    """The match to believe, and whether it had to be searched for."""
    match = matcher.match_pieces(pieces, guess, doubt)
    if match is not None and match.fit >= GOOD_FIT:
        return match, False
    found = matcher.search_pieces(pieces, guess, doubt)
    if found is None or (match is not None and match.fit >= found.fit):
        found = match
    return (found if found is not None and found.fit >= GOOD_FIT else None), True


def _doubt(lasted_s: float, known: bool) -> FloatArray:
    """Covariance of a guess at constant velocity."""
    metres = LEAST_M + (CHANGE_M_S2 * lasted_s**2 if known else UNKNOWN_M_S * lasted_s)
    radians = LEAST_RAD + (CHANGE_RAD_S2 * lasted_s**2 if known else UNKNOWN_RAD_S * lasted_s)
    return np.diag(np.square([metres, metres, radians]))


def _elapsed_s(window: IntArray, stamps_ns: IntArray, period_s: float) -> FloatArray:
    """(n,) after the first scan: whole periods where stamps only scatter about them, what they
    say where scans come at no fixed rate, and the usual time where they come in bursts or go
    backward."""
    if window.size < 2:
        return np.zeros(window.size)
    scans = np.diff(window).astype(np.float64)
    steps = np.diff(stamps_ns[window]) * 1e-9 / period_s
    whole = np.maximum(np.round(steps), 1.0)
    if (steps < BURST * scans).any():
        steps = scans * max(float(steps.sum() / scans.sum()), 1.0)
    elif (np.abs(steps - whole) < SCATTER).all():
        steps = whole
    lasted = np.minimum(steps, MOST_MISSING * scans) * period_s
    return np.concatenate([[0.0], np.cumsum(lasted)])
