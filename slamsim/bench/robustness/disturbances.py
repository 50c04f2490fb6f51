"""Disturbances outside the simulator's static world: people, glass, range offset, kidnapping.

People, glass, an offset of the ranges and a kidnapping are put into a log that was simulated
without them, by means of its truth: exactly for people (discs) and ranges; glass is any stretch
of wall that returns no light unless it is met head on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.bench.robustness.conditions import Conditions
from slamsim.core.geometry import between, compose
from slamsim.core.randomness import random_stream
from slamsim.core.types import (
    EncoderStream,
    Float32Array,
    FloatArray,
    IntArray,
    Log,
    PlanarTrajectory,
    Scan,
)
from slamsim.recording.cleaning.scans import StoredScans

PERSON_RADIUS_M = 0.25
"""A body or two legs, at the height of the lidar."""

KEEPS_AWAY_M = 0.6
"""Nearer than this people step aside, and are not seen at all."""

PANE_M = 1.0
GLASS_SEEN_RAD = np.deg2rad(10.0)
"""A pane shines back within so much of its normal (Foster et al. 2013: 5 to 20 degrees)."""

CARRIED_S = (15.0, 25.0)
"""So much of the drive is left out: the robot is set down where it comes that much later."""

CARRIED_M = 2.0
"""A robot that is set down nearer than this to where it was has not been carried."""

Change = Callable[[Scan, FloatArray, FloatArray], Float32Array]
"""From a scan and its rays, origins and unit directions (n, 2) in the map, to its new ranges."""


def disturbed(
    log: Log, truth: PlanarTrajectory, conditions: Conditions
) -> tuple[Log, PlanarTrajectory, tuple[int, ...]]:
    """Log and truth as the conditions have them, and the stamps at which the robot was carried.

    truth: ``T_map_base``.
    """
    seed = conditions.own_seed
    changes: list[Change] = []
    if conditions.glass_share:
        changes.append(_glass(seed, conditions.glass_share))
    if conditions.people:
        changes.append(_people(seed, conditions.people, truth))
    scans = [_seen_through(scan, truth, log.T_base_laser, changes) for scan in log.scans]
    offset_m = np.float32(conditions.offset_m)
    scans = [replace(scan, ranges_m=scan.ranges_m + offset_m) for scan in scans]
    encoders = log.encoders if conditions.ticks else None
    log = replace(log, scans=StoredScans(scans), encoders=encoders)
    span_ns = _carried_span_ns(truth, seed) if conditions.kidnapped else None
    if span_ns is None:
        return log, truth, ()
    return without_span(log, *span_ns), _closed_up(truth, *span_ns), (span_ns[0],)


def without_span(log: Log, start_ns: int, end_ns: int) -> Log:
    """The log as if the robot had been carried: what was recorded from start_ns to before end_ns
    is missing, stamps close up, and wheels and odometry know nothing of it."""
    scans = [s for s in log.scans if s.end_ns < start_ns or s.stamp_ns >= end_ns]
    shift_ns = end_ns - start_ns
    moved = [
        replace(s, stamp_ns=s.stamp_ns - shift_ns) if s.stamp_ns >= end_ns else s for s in scans
    ]
    imu, odometry, encoders = log.imu, log.odometry, log.encoders
    if imu is not None:
        kept = _outside(imu.stamps_ns, start_ns, end_ns)
        stamps_ns = _earlier(imu.stamps_ns, start_ns, end_ns)
        imu = replace(imu.select(kept), stamps_ns=stamps_ns[kept])
    if odometry is not None:
        later = odometry.stamps_ns >= end_ns
        poses = odometry.poses.copy()
        before = poses[odometry.stamps_ns < start_ns]
        if len(before) and later.any():
            poses[later] = compose(before[-1], between(poses[later][0], poses[later]))
        odometry = _closed_up(PlanarTrajectory(odometry.stamps_ns, poses), start_ns, end_ns)
    return replace(
        log,
        scans=StoredScans(moved),
        imu=imu,
        odometry=odometry,
        encoders=None if encoders is None else _ticks_without(encoders, start_ns, end_ns),
    )


def _ticks_without(encoders: EncoderStream, start_ns: int, end_ns: int) -> EncoderStream:
    ticks, later = encoders.ticks.copy(), encoders.stamps_ns >= end_ns
    before = ticks[encoders.stamps_ns < start_ns]
    if len(before) and later.any():
        ticks[later] -= ticks[later][0] - before[-1]
    kept = _outside(encoders.stamps_ns, start_ns, end_ns)
    stamps_ns = _earlier(encoders.stamps_ns, start_ns, end_ns)
    return replace(encoders, stamps_ns=stamps_ns[kept], ticks=ticks[kept])


def _closed_up(track: PlanarTrajectory, start_ns: int, end_ns: int) -> PlanarTrajectory:
    kept = _outside(track.stamps_ns, start_ns, end_ns)
    return PlanarTrajectory(_earlier(track.stamps_ns, start_ns, end_ns)[kept], track.poses[kept])


def _outside(stamps_ns: IntArray, start_ns: int, end_ns: int) -> IntArray:
    return np.flatnonzero((stamps_ns < start_ns) | (stamps_ns >= end_ns))


def _earlier(stamps_ns: IntArray, start_ns: int, end_ns: int) -> IntArray:
    return np.where(stamps_ns >= end_ns, stamps_ns - (end_ns - start_ns), stamps_ns)


def _carried_span_ns(truth: PlanarTrajectory, seed: int) -> tuple[int, int] | None:
    """What of the drive to leave out; None where nothing of it leads elsewhere."""
    rng = random_stream(seed, "bench robustness", "kidnapped")
    first_ns, last_ns = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    for _ in range(20):
        start_ns = first_ns + round(float(rng.uniform(0.3, 0.6)) * (last_ns - first_ns))
        end_ns = start_ns + round(float(rng.uniform(*CARRIED_S)) * 1e9)
        if end_ns + 10e9 > last_ns:
            continue
        moved = between(*truth.at(np.array([start_ns, end_ns])))
        if np.hypot(moved[0], moved[1]) >= CARRIED_M:
            return start_ns, end_ns
    return None


def _seen_through(
    scan: Scan, truth: PlanarTrajectory, T_base_laser: FloatArray, changes: list[Change]
) -> Scan:
    """The scan with its rays changed; as it is where the truth does not cover its beams."""
    stamps_ns = scan.stamp_ns + scan.geometry.offsets_ns()
    if not changes or stamps_ns[0] < truth.stamps_ns[0] or stamps_ns[-1] > truth.stamps_ns[-1]:
        return scan
    poses, angles_rad = truth.at(stamps_ns), scan.geometry.angles_rad()
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x_m, y_m = T_base_laser[:2, 3]
    origins = poses[:, :2] + np.column_stack([cos * x_m - sin * y_m, sin * x_m + cos * y_m])
    mounted = T_base_laser[:2, :2] @ np.stack([np.cos(angles_rad), np.sin(angles_rad)])
    directions = np.column_stack(
        [cos * mounted[0] - sin * mounted[1], sin * mounted[0] + cos * mounted[1]]
    )
    for change in changes:
        scan = replace(scan, ranges_m=change(scan, origins, directions))
    return scan


def _people(seed: int, count: int, truth: PlanarTrajectory) -> Change:
    """Who walk where the robot drives, to and fro, each at a pace of their own."""
    rng = random_stream(seed, "bench robustness", "people")
    steps_m = np.hypot(*np.diff(truth.poses[:, :2], axis=0).T)
    path_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    start_m, pace_m_s = rng.uniform(0.0, 2.0 * path_m[-1], count), rng.uniform(0.5, 1.4, count)

    def change(scan: Scan, origins: FloatArray, directions: FloatArray) -> Float32Array:
        walked_m = (start_m + pace_m_s * scan.stamp_ns * 1e-9) % max(2.0 * path_m[-1], 1e-9)
        along_m = np.minimum(walked_m, 2.0 * path_m[-1] - walked_m)
        centres = np.column_stack([np.interp(along_m, path_m, truth.poses[:, k]) for k in (0, 1)])
        centres = centres[np.hypot(*(centres - origins[0]).T) > KEEPS_AWAY_M]
        away = centres[None] - origins[:, None]
        along = np.einsum("nkx,nx->nk", away, directions)
        across = away[..., 1] * directions[:, :1] - away[..., 0] * directions[:, 1:]
        chord = np.sqrt(np.maximum(PERSON_RADIUS_M**2 - across**2, 0.0))
        met = np.where((np.abs(across) < PERSON_RADIUS_M) & (along > 0.0), along - chord, np.inf)
        nearest = met.min(axis=1, initial=np.inf)
        return np.where(
            nearest < scan.geometry.range_max_m, np.fmin(scan.ranges_m, nearest), scan.ranges_m
        ).astype(np.float32)

    return change


def _glass(seed: int, share: float) -> Change:
    """Squares of the floor whose walls are glass, in a pattern that repeats after 64 of them."""
    rng = random_stream(seed, "bench robustness", "glass")
    pattern = rng.random((64, 64)) < share

    def change(scan: Scan, origins: FloatArray, directions: FloatArray) -> Float32Array:
        ends = (
            origins + np.where(np.isfinite(scan.ranges_m), scan.ranges_m, 0.0)[:, None] * directions
        )
        cells = np.floor(ends / PANE_M).astype(np.int64) % 64
        along = np.gradient(ends, axis=0)
        slant = np.abs(np.sum(along * directions, axis=1)) / np.maximum(np.hypot(*along.T), 1e-9)
        dark = pattern[cells[:, 0], cells[:, 1]] & (slant > np.sin(GLASS_SEEN_RAD))
        return np.where(dark, np.inf, scan.ranges_m).astype(np.float32)

    return change
