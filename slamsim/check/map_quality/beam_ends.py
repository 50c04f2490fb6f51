"""How well scans lie on each other when they are placed by nothing but what is recorded.

No size is estimated and no scan is matched: each piece of surface is placed at its own instant by
odometry, wheel counters or gyroscope, transforms and stamps as they stand. What is left between
pieces of one surface, seen from several places, is the error that any user of the recording has.
It judges repairs by another measure than the one from which they come, on windows that are chosen
without regard to where the calibration looked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from slamsim.check.calibration.model import UNKNOWNS, rolled_poses
from slamsim.check.motion.integrated import (
    IntegratedMotion,
    integrated_gyro,
    integrated_odometry,
    integrated_wheels,
)
from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry, RawScans, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.heading import base_rotation
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_sweep import beams_of
from slamsim.slam.laser.scan_windows import period_s
from slamsim.slam.matching.line import LineMatcher
from slamsim.slam.matching.surfaces import HALF_LENGTH, NORMAL_X, NORMAL_Y, X, Y

WINDOW_S, LEAST_WINDOWS, MOST_WINDOWS = 4.0, 8, 24
"""Long enough for a metre and a quarter turn, short enough that wheels drift by millimetres."""

WINDOW_SCANS = 6
FARTHEST_M = 0.5
"""Surfaces farther apart than this are as wrong as can be."""

SAME_SIDE = 0.7
"""Cosine between the normals of pieces of one surface, at least."""

SEEN_AGAIN = 0.7
"""Share of the pieces of a scan that another scan of its window shows too, mostly."""

SURE = 0.9985
"""One-sided three sigmas, by Student's t: a dozen comparisons are made in one repair."""

TOLERANCE_M, TOLERANCE = 2e-4, 0.02
"""Smaller changes are none: what rounding of stamps and another choice of pieces make, and what the
error of a healthy recording changes by when its mount is moved within the limit of the question."""

LEAST_SAMPLES = 8
_AS_REPORTED = np.array([1.0 if name.endswith("_gain") else 0.0 for name in UNKNOWNS])


@dataclass(frozen=True, slots=True, eq=False)
class BeamEnds:
    """errors_m: (w,) for each stream that can place the scans, how far pieces of surface are apart
    in each window, on the average over pairs of scans; empty where nothing places them."""

    errors_m: Mapping[str, FloatArray]

    @property
    def mean_m(self) -> float | None:
        """Over all windows and streams; None where nothing places the scans."""
        return float(np.mean([*self.errors_m.values()])) if self.errors_m else None


@dataclass(frozen=True, slots=True)
class Change:
    """Mean change of the error, m, and the least that is one."""

    mean_m: float
    least_m: float

    @property
    def better(self) -> bool:
        """Whether scans lie on each other more closely, beyond chance."""
        return self.mean_m < -self.least_m

    @property
    def worse(self) -> bool:
        """The opposite."""
        return self.mean_m > self.least_m


NO_CHANGE = Change(0.0, 0.0)


def change(before: BeamEnds, after: BeamEnds) -> Change:
    """Of the error by the streams that both have, window by window where there are as many."""
    both = [name for name in before.errors_m if name in after.errors_m]
    if not both:
        return NO_CHANGE
    was, now = (np.mean([one.errors_m[name] for name in both], axis=0) for one in (before, after))
    mean_m = float(now.mean() - was.mean())
    least_m = max(TOLERANCE_M, TOLERANCE * float(was.mean()))
    if was.size != now.size:
        return Change(mean_m, max(least_m, _unsure(was), _unsure(now)))
    return Change(mean_m, max(least_m, _unsure(now - was)))


def _unsure(values: FloatArray) -> float:
    """By how much the mean of (n,) may be off; all of it where there are too few."""
    if values.size < 2:
        return float(np.abs(values).sum())
    sigma = float(values.std(ddof=1) / np.sqrt(values.size))
    return float(t.ppf(SURE, values.size - 1)) * sigma


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """pieces: (k, 10) in the laser's frame, at_ns: (k,) when each was seen as declared, begins:
    where those of each scan begin, and the end."""

    pieces: FloatArray
    at_ns: IntArray
    begins: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """stamps_ns (n,) ascending, poses (n, 3) of a frame with yaw unwrapped."""

    stamps_ns: IntArray
    poses: FloatArray

    def at(self, stamps_ns: IntArray) -> FloatArray:
        """(m, 3), constant beyond the ends."""
        origin_ns = self.stamps_ns[0]
        asked_s, known_s = (1e-9 * (ns - origin_ns) for ns in (stamps_ns, self.stamps_ns))
        return np.column_stack([np.interp(asked_s, known_s, one) for one in self.poses.T])


def beam_ends(recording: Recording) -> BeamEnds:
    """Of the lidar with most scans. Nothing places ranges that are evidently in no metres, angles
    in degrees, or a laser of which no fixed transform says where it sits."""
    scans = max(recording.scans, key=len, default=None)
    if scans is None or not len(scans) or not scans.frame_ids:
        return BeamEnds({})
    reader = BeamReader(scans)
    if (reader.metres_per_unit, reader.radians_per_unit) != (1.0, 1.0):
        return BeamEnds({})
    tracks = _tracks(recording, scans.frame_ids[0])
    windows = _windows(scans, reader) if tracks else []
    if not windows:
        return BeamEnds({})
    return BeamEnds(
        {
            name: np.array([_error_m(window, *placing) for window in windows])
            for name, placing in tracks.items()
        }
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
        since_ns = 1e9 * sweep.declared_s * (beams_of(found, sweep) + 0.5)
        pieces.append(found)
        at_ns.append(scans.stamps_ns[scan] + np.rint(since_ns).astype(np.int64))
    begins = np.cumsum([0, *map(len, pieces)])
    return _Window(np.concatenate(pieces), np.concatenate(at_ns), begins)


def _tracks(recording: Recording, laser_frame: str) -> dict[str, tuple[_Track, FloatArray]]:
    """Every stream that tells where the robot is, with T_frame_laser (4, 4) of the frame that it
    tells it of; a gyroscope gives the heading along the path of the first of the others."""
    graph = FrameGraph(recording.transforms)
    odometries = recording.odometries
    base = graph.base(odometries[0].child_frame_ids if odometries else ())
    wheels = {ticks.topic: integrated_wheels(ticks) for ticks in recording.ticks}
    rolled = {name: _rolled(one) for name, one in wheels.items() if one is not None}
    found = {
        **{one.topic: (_recorded(one), (*one.child_frame_ids, base)[0]) for one in odometries},
        **{name: (track, base) for name, track in rolled.items()},
        **{
            f"{edge.topic} {edge.name}": (_recorded(edge), edge.child)
            for edge in recording.transforms
            if not edge.is_static and not edge.parent.endswith("map")
        },
    }
    path = next((one for one in wheels.values() if one is not None), None)
    path = path or next(filter(None, map(integrated_odometry, odometries)), None)
    for imu in recording.imus:
        gyro = integrated_gyro(imu, base_rotation(recording, imu)[2])
        if path is not None and gyro is not None:
            found[imu.topic] = _by_gyro(gyro, path), base
    joined = {
        name: (track, graph.between(frame, laser_frame))
        for name, (track, frame) in found.items()
        if track is not None
    }
    return {name: (track, T) for name, (track, T) in joined.items() if T is not None}


def _recorded(stream: RawOdometry | TransformEdge) -> _Track | None:
    yaw_rad = yaw_from_xyzw(stream.quats_xyzw)
    poses = np.column_stack([stream.positions_m[:, :2], yaw_rad])
    good = np.flatnonzero(is_sound(poses))
    order = good[np.unique(stream.stamps_ns[good], return_index=True)[1]]
    if order.size < LEAST_SAMPLES:
        return None
    poses = poses[order]
    poses[:, 2] = np.unwrap(poses[:, 2])
    return _Track(stream.stamps_ns[order], poses)


def _rolled(wheels: IntegratedMotion) -> _Track:
    return _Track(wheels.stamps_ns, rolled_poses(wheels, _AS_REPORTED))


def _by_gyro(gyro: IntegratedMotion, wheels: IntegratedMotion) -> _Track:
    """The heading of the one along the path of the other."""
    path_m = wheels.at(np.asarray(1e-9 * (gyro.stamps_ns - wheels.origin_ns)))[:, 0]
    totals = np.column_stack([path_m, gyro.totals[:, 0]])
    return _rolled(IntegratedMotion(gyro.topic, gyro.stamps_ns, totals, np.zeros(2)))


def _error_m(window: _Window, track: _Track, T_base_laser: FloatArray) -> float:
    placed = _placed(window.pieces, T_base_laser, track.at(window.at_ns))
    begins = window.begins
    each = [placed[begins[k] : begins[k + 1]] for k in range(begins.size - 1)]
    apart = [
        np.sort(_apart(one, other))[: int(np.ceil(SEEN_AGAIN * len(one)))].mean()
        for k, one in enumerate(each)
        for other in each[k + 1 :]
        if len(one)
    ]
    return float(np.mean(apart)) if apart else FARTHEST_M


def _placed(pieces: FloatArray, T_base_laser: FloatArray, T_map_base: FloatArray) -> FloatArray:
    """(k, 5) x, y, normal and half length of pieces (k, 10) as seen from poses (k, 3)."""
    R = T_base_laser[:2, :2]
    at = pieces[:, [X, Y]] @ R.T + T_base_laser[:2, 3]
    normal = pieces[:, [NORMAL_X, NORMAL_Y]] @ R.T
    cos, sin = np.cos(T_map_base[:, 2]), np.sin(T_map_base[:, 2])
    turned = [(cos * x - sin * y, sin * x + cos * y) for x, y in (at.T, normal.T)]
    return np.column_stack(
        [
            T_map_base[:, 0] + turned[0][0],
            T_map_base[:, 1] + turned[0][1],
            *turned[1],
            pieces[:, HALF_LENGTH],
        ]
    )


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
