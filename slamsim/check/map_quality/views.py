"""Scans of short windows as surface pieces, each with the instant at which it was seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.config.slam import FrontEndConfig
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawScans
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_motion import ScanMotions
from slamsim.slam.laser.scan_sweep import beams_of
from slamsim.slam.matching.line import LineMatcher
from slamsim.slam.matching.surfaces import NORMAL_X, NORMAL_Y, VARIANCE, X, Y

MOST_WINDOWS = 12
MOST_SCANS = 10
"""Of a window, evenly spread over it: a map is told by how far apart it is seen, not how often."""

MOST_PIECES = 90
"""Of a scan, likewise."""

LEAST_SCANS = 4


@dataclass(frozen=True, slots=True, eq=False)
class WindowView:
    """What was seen in one window.

    pieces: (k, 5) x and y, m, and normal in the frame of the laser when it saw the piece, as from
    above; variance of a point along the normal, m^2. seen_s: (k,) when, by the lidar's clock, after
    the middle of what the fit compared. scan: (k,) which of the scans. scan_s: (m,) the middle
    instants of all scans of the window, T_window_laser: (m, 3) where they are by matching.
    """

    pieces: FloatArray
    seen_s: FloatArray
    scan: IntArray
    scan_s: FloatArray
    T_window_laser: FloatArray


def window_views(
    scans: RawScans, motions: ScanMotions, calibration: Calibration
) -> list[WindowView]:
    """Of some windows, over the whole recording, where all that is there can be believed."""
    usable = [w for w in range(len(motions.windows)) if _usable(calibration, w)]
    reader = BeamReader(scans, motions.angle_step.value)
    matcher = LineMatcher(FrontEndConfig())
    chosen = _spread(np.array(usable, dtype=np.int64), MOST_WINDOWS)
    return [_view(reader, matcher, motions, calibration, int(w)) for w in chosen]


def _usable(calibration: Calibration, window: int) -> bool:
    """Whether gyroscope and wheels, as far as there are any, cover all its steps."""
    model, values = calibration.model, calibration.fit.values
    mine = model.steps.window == window
    by_gyro, by_wheels = model.covered(values)
    return (
        int(mine.sum()) >= LEAST_SCANS
        and (model.gyro is None or bool(by_gyro[mine].all()))
        and (model.wheels is None or bool(by_wheels[mine].all()))
    )


def _spread(places: IntArray, most: int) -> IntArray:
    """At most so many of them, evenly."""
    at = np.linspace(0, places.size - 1, min(most, places.size))
    return np.asarray(places[np.round(at).astype(np.int64)])


def _view(
    reader: BeamReader,
    matcher: LineMatcher,
    motions: ScanMotions,
    calibration: Calibration,
    window: int,
) -> WindowView:
    scans, scan_s = _middles(calibration, window)
    sweep_s = np.copysign(calibration.model.steps.sweep_s, motions.sweep_s.value)
    pieces, seen_s, numbers = [], [], []
    for k in _spread(np.arange(scans.size), MOST_SCANS).tolist():
        found = matcher.pieces(reader.cloud(int(scans[k])))
        shares = beams_of(found, reader.sweep(int(scans[k])))
        kept = _spread(np.arange(len(found)), MOST_PIECES)
        pieces.append(found[kept][:, [X, Y, NORMAL_X, NORMAL_Y, VARIANCE]])
        seen_s.append(scan_s[k] + shares[kept] * sweep_s)
        numbers.append(np.full(kept.size, k, dtype=np.int64))
    mine = motions.windows[window]
    scale = np.array([motions.metres_per_unit, motions.metres_per_unit, 1.0])
    turned = np.array([1.0, -1.0 if _from_below(calibration) else 1.0])
    return WindowView(
        np.concatenate(pieces) * np.append(np.tile(turned, 2), 1.0),
        np.concatenate(seen_s),
        np.concatenate(numbers),
        scan_s,
        mine.T_window_laser[np.isin(mine.scans, scans)] * scale * np.append(turned, turned[1]),
    )


def _middles(calibration: Calibration, window: int) -> tuple[IntArray, FloatArray]:
    """Scans (m,) of a window and when their middle beams fired, s after the middle of the fit."""
    model = calibration.model
    mine = model.steps.window == window
    scans = np.concatenate([model.steps.first[mine], model.steps.second[mine]])
    at_s = np.concatenate([model.first_s[mine], model.second_s[mine]])
    scans, place = np.unique(scans, return_index=True)
    return scans, np.asarray(at_s[place])


def _from_below(calibration: Calibration) -> bool:
    """Whether what the scans show has to be mirrored to be seen from above."""
    return calibration.inputs.upside_down != calibration.alignment.mirror
