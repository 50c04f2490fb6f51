"""What real recordings suffer: each function takes a log and returns it damaged. Spans in seconds
since the first scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from simulated import ScanList

from slamsim.core.geometry import between, compose, matrix_from_rpy
from slamsim.core.types import (
    BoolArray,
    FloatArray,
    ImuStream,
    IntArray,
    Log,
    PlanarTrajectory,
    Scan,
)

FOREVER = (-1.0, 1e9)


def begin_ns(log: Log) -> int:
    """Stamp of the first scan."""
    return next(iter(log.scans)).stamp_ns


def _within(log: Log, stamps_ns: IntArray, span_s: tuple[float, float]) -> BoolArray:
    seconds = (stamps_ns - begin_ns(log)) * 1e-9
    return np.asarray((seconds >= span_s[0]) & (seconds < span_s[1]))


def each_scan(
    log: Log, change: Callable[[Scan], Scan | None], span_s: tuple[float, float] = FOREVER
) -> Log:
    """Scans within the span changed, or left out where the change gives None."""
    kept = []
    for scan in log.scans:
        inside = bool(_within(log, np.array([scan.stamp_ns]), span_s)[0])
        changed = change(scan) if inside else scan
        if changed is not None:
            kept.append(changed)
    return replace(log, scans=ScanList(kept))


def each_pose(log: Log, change: Callable[[FloatArray, FloatArray], FloatArray]) -> Log:
    """odometry: change(seconds since the first scan (n,), poses (n, 3)) gives the new poses."""
    assert log.odometry is not None
    seconds = (log.odometry.stamps_ns - begin_ns(log)).astype(np.float64) * 1e-9
    poses = change(seconds, log.odometry.poses.copy())
    return replace(log, odometry=PlanarTrajectory(log.odometry.stamps_ns, poses))


def few_beams(log: Log, count: int, span_s: tuple[float, float]) -> Log:
    """All but ``count`` beams, spread over the scan, are invalid."""

    def change(scan: Scan) -> Scan:
        ranges_m = np.full_like(scan.ranges_m, np.nan)
        kept = np.linspace(0, ranges_m.size - 1, count).astype(np.int64)
        ranges_m[kept] = scan.ranges_m[kept]
        return replace(scan, ranges_m=ranges_m)

    return each_scan(log, change, span_s)


def all_beams(log: Log, range_m: float, span_s: tuple[float, float]) -> Log:
    """Every beam reads the same."""
    return each_scan(
        log, lambda scan: replace(scan, ranges_m=np.full_like(scan.ranges_m, range_m)), span_s
    )


def odometry_jump(log: Log, at_s: float, step: tuple[float, float, float]) -> Log:
    """From an instant on the odometry is somewhere else."""

    def change(seconds: FloatArray, poses: FloatArray) -> FloatArray:
        after = seconds >= at_s
        first = poses[after][0]
        poses[after] = compose(compose(first, np.array(step)), between(first, poses[after]))
        return poses

    return each_pose(log, change)


def odometry_reset(log: Log, at_s: float) -> Log:
    """The driver is started again: odometry begins anew at its origin."""

    def change(seconds: FloatArray, poses: FloatArray) -> FloatArray:
        after = seconds >= at_s
        poses[after] = between(poses[after][0], poses[after])
        return poses

    return each_pose(log, change)


def odometry_frozen(log: Log, span_s: tuple[float, float]) -> Log:
    """The odometry repeats its last pose for a while, then goes on from it."""

    def change(seconds: FloatArray, poses: FloatArray) -> FloatArray:
        stuck = (seconds >= span_s[0]) & (seconds < span_s[1])
        after = seconds >= span_s[1]
        held = poses[stuck][0]
        poses[after] = compose(held, between(poses[after][0], poses[after]))
        poses[stuck] = held
        return poses

    return each_pose(log, change)


def mirrored(log: Log, said: bool) -> Log:
    """The lidar hangs upside down; ``said``: the transform to it says so."""

    def change(scan: Scan) -> Scan:
        geometry = scan.geometry
        turned = replace(
            geometry,
            angle_min_rad=-geometry.angle_min_rad,
            angle_step_rad=-geometry.angle_step_rad,
        )
        return replace(scan, geometry=turned)

    hung = each_scan(log, change)
    return turned_lidar(hung, (np.pi, 0.0, 0.0)) if said else hung


def turned_lidar(log: Log, rpy: tuple[float, float, float]) -> Log:
    """Only the transform to the lidar changes."""
    T_base_laser = log.T_base_laser.copy()
    T_base_laser[:3, :3] = T_base_laser[:3, :3] @ matrix_from_rpy(*rpy)
    return replace(log, T_base_laser=T_base_laser)


def turned_scans(log: Log, yaw_rad: float) -> Log:
    """The lidar is mounted turned about the vertical, and the transform says so."""

    def change(scan: Scan) -> Scan:
        start = scan.geometry.angle_min_rad - yaw_rad
        return replace(scan, geometry=replace(scan.geometry, angle_min_rad=start))

    return turned_lidar(each_scan(log, change), (0.0, 0.0, yaw_rad))


def gap(log: Log, span_s: tuple[float, float], scans: bool = True, motion: bool = True) -> Log:
    """Nothing is recorded for a while."""
    if scans:
        log = each_scan(log, lambda scan: None, span_s)
    if not motion:
        return log
    odometry = log.odometry
    if odometry is not None:
        kept = ~_within(log, odometry.stamps_ns, span_s)
        odometry = PlanarTrajectory(odometry.stamps_ns[kept], odometry.poses[kept])
    imu = log.imu
    if imu is not None:
        kept = ~_within(log, imu.stamps_ns, span_s)
        imu = ImuStream(
            imu.stamps_ns[kept],
            imu.angular_velocity_rad_s[kept],
            imu.linear_acceleration_m_s2[kept],
        )
    return replace(log, odometry=odometry, imu=imu)


def seen_elsewhere(log: Log, span_s: tuple[float, float], earlier_s: float) -> Log:
    """Within the span each scan shows what was seen so much earlier."""
    scans = list(log.scans)
    inside = _within(log, np.array([scan.stamp_ns for scan in scans]), span_s)
    period_s = (scans[-1].stamp_ns - scans[0].stamp_ns) * 1e-9 / (len(scans) - 1)
    back = round(earlier_s / period_s)
    shown = [
        replace(scan, ranges_m=scans[k - back].ranges_m) if inside[k] else scan
        for k, scan in enumerate(scans)
    ]
    return replace(log, scans=ScanList(shown))


def walkers(log: Log, truth: PlanarTrajectory, count: int, seed: int = 0) -> Log:
    """People, discs of 0.25 m radius, cross in front of the lidar again and again."""
    rng = np.random.default_rng(seed)
    around = rng.uniform(0.6, 2.5, count)
    phase, pace = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.3, 1.0, count)

    def change(scan: Scan) -> Scan:
        pose = truth.at(np.array([scan.stamp_ns]))[0]
        seconds = scan.stamp_ns * 1e-9
        bearing = phase + pace * seconds - pose[2]
        centres = around[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        angles = scan.geometry.angles_rad()
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        along = rays @ centres.T
        across = np.abs(rays[:, [0]] * centres[:, 1] - rays[:, [1]] * centres[:, 0])
        chord = np.sqrt(np.maximum(0.25**2 - across**2, 0.0))
        near = np.where((across < 0.25) & (along > 0.3), along - chord, np.inf).min(axis=1)
        return replace(scan, ranges_m=np.minimum(scan.ranges_m, near).astype(np.float32))

    return each_scan(log, change)


def every_other_geometry(log: Log) -> Log:
    """Every second scan has half the beams."""
    number = iter(range(10**9))

    def change(scan: Scan) -> Scan:
        return scan if next(number) % 2 == 0 else thinned(scan, 2)

    return each_scan(log, change)


def thinned(scan: Scan, factor: int) -> Scan:
    """Every ``factor``-th beam of a scan."""
    geometry = scan.geometry
    ranges_m = np.ascontiguousarray(scan.ranges_m[::factor])
    return Scan(
        scan.stamp_ns,
        ranges_m,
        replace(
            geometry,
            angle_step_rad=geometry.angle_step_rad * factor,
            beam_count=ranges_m.size,
            beam_dt_ns=geometry.beam_dt_ns * factor,
        ),
    )


def narrowed(scan: Scan, field_rad: float) -> Scan:
    """The middle of a scan."""
    geometry = scan.geometry
    kept = np.flatnonzero(np.abs(geometry.angles_rad()) <= 0.5 * field_rad)
    start_ns = scan.stamp_ns + int(kept[0]) * geometry.beam_dt_ns
    start_rad = geometry.angle_min_rad + float(kept[0]) * geometry.angle_step_rad
    sector = replace(geometry, angle_min_rad=start_rad, beam_count=int(kept.size))
    return Scan(start_ns, scan.ranges_m[kept], sector)


def short_sighted(scan: Scan, range_m: float) -> Scan:
    """Nothing farther than this returns."""
    near = np.where(scan.ranges_m < range_m, scan.ranges_m, np.inf).astype(np.float32)
    return replace(scan, ranges_m=near, geometry=replace(scan.geometry, range_max_m=range_m))
