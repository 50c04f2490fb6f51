"""How well scans lie on each other when they are placed by nothing but what is recorded.

No size is estimated and no scan is matched: each piece of surface is placed at its own instant by
odometry, wheel counters or gyroscope, transforms and stamps as they stand. What is left between
pieces of one surface, seen from several places, is the error that any user of the recording has.
It judges repairs by another measure than the one from which they come, on windows that are chosen
without regard to where the calibration looked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from slamsim.check.map_quality.tracks import Track, recorded_tracks
from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between
from slamsim.core.jit import kernel
from slamsim.core.quantiles import student_t
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawScans, Recording
from slamsim.recording.choice import lidars
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_sweep import beams_of
from slamsim.slam.laser.scan_windows import period_s
from slamsim.slam.matching.line import LineMatcher
from slamsim.slam.matching.surfaces import HALF_LENGTH, NORMAL_X, NORMAL_Y, X, Y

WINDOW_S, LEAST_WINDOWS, MOST_WINDOWS = 4.0, 8, 24
"""Long enough for a metre and a quarter turn, short enough that wheels drift by millimetres."""

WINDOW_SCANS = 6
LONGEST_NS = 1e10
"""No sweep lasts longer, whatever is declared."""

FARTHEST_M = 0.5
"""Surfaces farther apart than this are as wrong as can be."""

SAME_SIDE = 0.7
"""Cosine between the normals of pieces of one surface, at least."""

SEEN_AGAIN = 0.5
"""Share of the pieces of a scan that another scan of its window shows too: a laser that sees half
of the surroundings sees half of that again after a quarter turn."""

SURE_OF_BETTER, SURE_OF_WORSE = 0.9985, 0.95
"""One-sided, by Student's t. Three sigmas, for a dozen comparisons are made in one repair; of what
is worse less than that, for who doubts leaves a recording as it is."""

TOLERANCE_M, TOLERANCE = 2e-4, 0.02
"""Smaller changes are none: what rounding of stamps and another choice of pieces make, and what the
error of a healthy recording changes by when its mount is moved within the limit of the question."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamEnds:
    """errors_m: (w,) for each stream that can place the scans, how far pieces of surface are apart
    in each window, on the average over pairs of scans; empty where nothing places them. between_m:
    (w,) for each stream but the first, how far apart it and the first put the same piece."""

    errors_m: Mapping[str, FloatArray]
    between_m: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def mean_m(self) -> float | None:
        """Over all windows and streams; None where nothing places the scans."""
        return float(np.mean([*self.errors_m.values()])) if self.errors_m else None


@dataclass(frozen=True, slots=True)
class Change:
    """mean_m: of the error. better, worse: whether scans lie on each other more closely, or less,
    beyond chance and ``TOLERANCE``."""

    mean_m: float = 0.0
    better: bool = False
    worse: bool = False


def change(before: BeamEnds, after: BeamEnds) -> Change:
    """Of all errors by streams that both have, window by window where there are as many.

    That streams agree with each other counts as much as that scans do: where scans contradict two
    streams that agree, neither is to be bent to them.
    """
    pairs = [
        (was[name], now[name])
        for was, now in (
            (before.errors_m, after.errors_m),
            (before.between_m, after.between_m),
        )
        for name in was
        if name in now
    ]
    if not pairs:
        return Change()
    was, now = (np.mean(one, axis=0) for one in zip(*pairs, strict=True))
    mean_m = float(now.mean() - was.mean())
    least_m = max(TOLERANCE_M, TOLERANCE * float(was.mean()))
    unsure = [_sigma_m(now - was)] if was.size == now.size else [_sigma_m(was), _sigma_m(now)]
    sigma_m, freedom = float(np.hypot.reduce(unsure)), max(min(was.size, now.size) - 1, 1)
    by_m = [
        max(least_m, sigma_m * float(student_t(sure, freedom)))
        for sure in (SURE_OF_BETTER, SURE_OF_WORSE)
    ]
    return Change(mean_m, bool(mean_m < -by_m[0]), bool(mean_m > by_m[1]))


def _sigma_m(values: FloatArray) -> float:
    """Of the mean of (n,); all of it where there is but one."""
    if values.size < 2:
        return float(np.abs(values).sum())
    return float(values.std(ddof=1) / np.sqrt(values.size))


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """pieces: (k, 10) in the laser's frame, at_ns: (k,) when each was seen as declared, begins:
    where those of each scan begin, and the end."""

    pieces: FloatArray
    at_ns: IntArray
    begins: IntArray


def beam_ends(recording: Recording) -> BeamEnds:
    """Of the first lidar. Nothing places ranges that are evidently in no metres, angles
    in degrees, or a laser of which no fixed transform says where it sits."""
    scans = next(iter(lidars(recording)), None)
    if scans is None or not len(scans) or not scans.frame_ids:
        return BeamEnds({})
    reader = BeamReader(scans)
    if (reader.metres_per_unit, reader.radians_per_unit) != (1.0, 1.0):
        return BeamEnds({})
    tracks = recorded_tracks(recording, scans.frame_ids[0])
    windows = _windows(scans, reader) if tracks else []
    if not windows:
        return BeamEnds({})
    placed = {
        name: [_placed(window, track, T) for window in windows]
        for name, (track, T) in tracks.items()
    }
    first = next(iter(placed.values()))
    pairs = [zip(one, first, strict=True) for one in placed.values()]
    between_m = [np.array([_between_m(*pair) for pair in each]) for each in pairs]
    return BeamEnds(
        {
            name: np.array([_error_m(w.begins, one) for w, one in zip(windows, each, strict=True)])
            for name, each in placed.items()
        },
        dict(list(zip(placed, between_m, strict=True))[1:]),
    )


def _windows(scans: RawScans, reader: BeamReader) -> list[_Window]:
    """All over the recording, in the order of the file."""
    count = len(scans)
    length = min(round(WINDOW_S / period_s(scans.stamps_ns)), count // LEAST_WINDOWS)
    if length < 2:
        return []
    matcher = LineMatcher(FrontEndConfig())
    starts = np.linspace(0, count - length, min(count // length, MOST_WINDOWS)).astype(np.int64)
    inside = np.unique(np.linspace(0, length - 1, WINDOW_SCANS).astype(np.int64))
    found = [_window(scans, reader, matcher, start + inside) for start in starts]
    return [window for window in found if len(window.pieces)]


def _window(
    scans: RawScans, reader: BeamReader, matcher: LineMatcher, numbers: IntArray
) -> _Window:
    pieces, at_ns = [], []
    for scan in numbers.tolist():
        found, sweep = matcher.pieces(reader.cloud(scan)), reader.sweep(scan)
        lasts_ns = float(np.clip(1e9 * sweep.declared_s, -LONGEST_NS, LONGEST_NS))
        since_ns = np.rint(lasts_ns * (beams_of(found, sweep) + 0.5))
        pieces.append(found)
        at_ns.append(scans.stamps_ns[scan] + since_ns.astype(np.int64))
    begins = np.cumsum([0, *map(len, pieces)])
    return _Window(np.concatenate(pieces), np.concatenate(at_ns), begins)


def _placed(window: _Window, track: Track, T_base_laser: FloatArray) -> FloatArray | None:
    """(k, 5) x, y, normal and half length of the pieces, in the frame that the base has at the
    first of them; None where all is seen before the track begins, or after its end."""
    if not track.meets(window.at_ns):
        return None
    R, pieces = T_base_laser[:2, :2], window.pieces
    at = pieces[:, [X, Y]] @ R.T + T_base_laser[:2, 3]
    normal = pieces[:, [NORMAL_X, NORMAL_Y]] @ R.T
    poses = track.at(window.at_ns)
    moved = between(poses[:1], poses)
    cos, sin = np.cos(moved[:, 2]), np.sin(moved[:, 2])
    turned = [(cos * x - sin * y, sin * x + cos * y) for x, y in (at.T, normal.T)]
    x, y = moved[:, 0] + turned[0][0], moved[:, 1] + turned[0][1]
    return np.column_stack([x, y, *turned[1], pieces[:, HALF_LENGTH]])


def _error_m(begins: IntArray, placed: FloatArray | None) -> float:
    """Of all pairs of scans of one window; begins: as its own."""
    if placed is None:
        return FARTHEST_M
    each = [placed[begins[k] : begins[k + 1]] for k in range(begins.size - 1)]
    apart = [
        np.sort(_apart(one, other))[: int(np.ceil(SEEN_AGAIN * len(one)))].mean()
        for k, one in enumerate(each)
        for other in each[k + 1 :]
        if len(one)
    ]
    return float(np.mean(apart)) if apart else FARTHEST_M


def _between_m(one: FloatArray | None, other: FloatArray | None) -> float:
    """Mean distance of the same pieces (k, 5), placed by two streams."""
    if one is None or other is None:
        return FARTHEST_M
    apart_m = np.hypot(*(one[:, :2] - other[:, :2]).T)
    return float(np.minimum(apart_m, FARTHEST_M).mean())


@kernel
def _apart(pieces: FloatArray, surfaces: FloatArray) -> FloatArray:
    """(k,) distance of the middle of each of pieces (k, 5) from the nearest of surfaces (m, 5)."""
    found = np.full(len(pieces), FARTHEST_M)
    for i in range(len(pieces)):
        for j in range(len(surfaces)):
            nx, ny = surfaces[j, 2], surfaces[j, 3]
            if pieces[i, 2] * nx + pieces[i, 3] * ny < SAME_SIDE:
                continue
            dx, dy = pieces[i, 0] - surfaces[j, 0], pieces[i, 1] - surfaces[j, 1]
            beyond = max(abs(dy * nx - dx * ny) - surfaces[j, 4], 0.0)
            found[i] = min(found[i], np.hypot(dx * nx + dy * ny, beyond))
    return found
