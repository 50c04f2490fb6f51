"""How recordings are read as deep as a user would, and what a sane result is."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.core.types import FloatArray, IntArray, Log, Scan, Trajectory
from slamsim.guard.numbers import MOST_NS
from slamsim.io.open import read_log, read_recording, read_truth
from slamsim.io.text.relations import read_relations
from slamsim.io.text.tum import read_tum
from slamsim.recording import RawStream, Recording
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.mapping.saved_map import read_saved_map
from slamsim.slam.session import map_log, motion_of


def whole_log(path: Path) -> object:
    """The log and every scan in it, its truth as well."""
    log = read_log(path)
    scans = list(log.scans)
    _require_log(log, scans)
    truth = read_truth(path)
    if truth is not None:
        _require_path(truth)
    return [log.epoch, scans, log.odometry, log.imu, log.encoders, log.T_base_laser,
            log.T_base_imu, log.warnings, truth]  # fmt: skip


def judged_quickly(path: Path) -> object:
    """The recording as it is, and what the quick checks say of it."""
    return _judged(path, quick=True)


def judged_thoroughly(path: Path) -> object:
    """The same with all checks."""
    return _judged(path, quick=False)


def mapped(path: Path) -> object:
    """Trajectory and map of the log."""
    log = read_log(path)
    result, _ = map_log(log, SlamConfig())
    motion = motion_of(log, result.calibration)
    config, laser = MappingConfig(), log.T_base_laser
    grid = build_grid(log.scans, result.trajectory, laser, config, motion)
    assert np.isfinite(result.trajectory.poses).all(), "a pose that is not finite"
    _require_increasing(result.trajectory.stamps_ns)
    known = grid.occupancy[~np.isnan(grid.occupancy)]
    assert ((known >= 0.0) & (known <= 1.0)).all(), "an occupancy that is no probability"
    return [result.trajectory, grid]


def _judged(path: Path, *, quick: bool) -> object:
    recording = read_recording(path)
    _require_recording(recording)
    report = check_recording(recording, quick=quick)
    _require_report(report)
    return [recording, report.findings]


def _require_report(report: CheckReport) -> None:
    for finding in report.findings:
        failed = finding.check.startswith("check.")
        assert not failed, f"a check failed: {finding.words}"
        _require_words(f"{finding.subject}: {finding.words} {finding.advice}")
        if finding.estimate is not None:
            assert np.isfinite(finding.estimate.value), f"{finding.check}: {finding.words}"


def _require_words(words: str) -> None:
    assert words.strip(), "an empty sentence"
    assert all(line.isprintable() for line in words.split("\n")), f"unprintable: {words[:200]!r}"


def _require_log(log: Log, scans: list[Scan]) -> None:
    assert len(log.scans) == len(scans) > 0, f"{len(log.scans)} scans said, {len(scans)} there"
    _require_increasing(np.array([scan.stamp_ns for scan in scans]))
    for scan in scans:
        _require_scan(scan)
    if log.odometry is not None:
        _require_increasing(log.odometry.stamps_ns)
        _require_finite(log.odometry.poses, (len(log.odometry), 3))
    if log.imu is not None:
        count = log.imu.stamps_ns.size
        _require_increasing(log.imu.stamps_ns)
        _require_finite(log.imu.angular_velocity_rad_s, (count, 3))
        _require_finite(log.imu.linear_acceleration_m_s2, (count, 3))
    if log.encoders is not None:
        _require_increasing(log.encoders.stamps_ns)
        assert log.encoders.ticks.shape == (log.encoders.stamps_ns.size, 2)
        wheels = (
            log.encoders.ticks_per_revolution,
            log.encoders.wheel_radius_m,
            log.encoders.track_m,
        )
        assert all(0 < number < np.inf for number in wheels), f"wheels of {wheels}"
    for T_base_sensor in (log.T_base_laser, log.T_base_imu):
        if T_base_sensor is not None:
            _require_rigid(T_base_sensor)
    for words in log.warnings:
        _require_words(words)


def _require_scan(scan: Scan) -> None:
    geometry = scan.geometry
    numbers = (geometry.angle_min_rad, geometry.angle_step_rad, geometry.range_max_m)
    assert np.isfinite(numbers).all() and geometry.range_max_m > 0.0, f"a lidar of {numbers}"
    assert geometry.angle_step_rad != 0.0 and geometry.beam_dt_ns >= 0
    assert 0.0 <= geometry.range_min_m < geometry.range_max_m
    _require_words(geometry.frame_id or "-")
    assert scan.ranges_m.shape == (geometry.beam_count,) and scan.ranges_m.dtype == np.float32
    met = scan.ranges_m[np.isfinite(scan.ranges_m)]
    assert ((met > 0.0) & (met <= np.float32(geometry.range_max_m))).all(), "ranges out of bounds"
    assert not np.isneginf(scan.ranges_m).any()
    if scan.intensities is not None:
        assert scan.intensities.shape == scan.ranges_m.shape


def _require_path(path: Trajectory) -> None:
    _require_increasing(path.stamps_ns)
    _require_finite(path.positions_m, (len(path), 3))
    _require_finite(path.quats_xyzw, (len(path), 4))
    assert np.allclose(np.linalg.norm(path.quats_xyzw, axis=1), 1.0)


def _require_recording(recording: Recording) -> None:
    streams: Iterable[RawStream] = (
        *recording.scans, *recording.imus, *recording.odometries, *recording.ticks,
        *recording.joints,
    )  # fmt: skip
    for stream in streams:
        count = len(stream)
        assert count > 0, f"{stream.topic} without messages"
        assert stream.stamps_ns.dtype == np.int64
        assert stream.received_ns is None or stream.received_ns.shape == (count,)
        _require_words(stream.topic)
        for frame in stream.frame_ids:
            _require_words(frame or "-")
    for scans in recording.scans:
        assert len(scans.ranges_m) == len(scans) == scans.layout_of.size
        assert scans.layout_of.min() >= 0 and scans.layout_of.max() < len(scans.layouts)
    for imu in recording.imus:
        assert imu.angular_velocity_rad_s.shape == imu.linear_acceleration_m_s2.shape
        assert imu.angular_velocity_rad_s.shape == (len(imu), 3)
    for moved in recording.odometries:
        assert moved.positions_m.shape == (len(moved), 3)
        assert moved.quats_xyzw.shape == (len(moved), 4)
    for edge in recording.transforms:
        assert edge.positions_m.shape == (edge.stamps_ns.size, 3)
        _require_words(f"{edge.name} {edge.topic}")
    for words in recording.anomalies:
        _require_words(words)
    for unread in recording.unread:
        _require_words(f"{unread.topic} {unread.type_name} {unread.reason}")


def _require_increasing(stamps_ns: IntArray) -> None:
    assert stamps_ns.dtype == np.int64, f"stamps are {stamps_ns.dtype}"
    assert (stamps_ns[1:] > stamps_ns[:-1]).all(), "stamps do not increase"
    assert (np.abs(stamps_ns) <= MOST_NS).all(), "no time at all"


def _require_finite(numbers: FloatArray, shape: tuple[int, ...]) -> None:
    assert numbers.shape == shape, f"{numbers.shape}, not {shape}"
    assert np.isfinite(numbers).all(), "numbers that are not finite"


def _require_rigid(T_base_sensor: FloatArray) -> None:
    _require_finite(T_base_sensor, (4, 4))
    rotation = T_base_sensor[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6), "no rotation"


def saved_map(path: Path) -> object:
    """A map to go on with, as it is saved."""
    saved = read_saved_map(path)
    _require_finite(saved.poses, (len(saved), 3))
    return [saved.keyframes, saved.poses, saved.closures]


def paths(path: Path) -> object:
    """A trajectory in the TUM format."""
    trajectory = read_tum(path)
    assert len(trajectory) > 0
    _require_path(trajectory)
    return trajectory


def relations(path: Path) -> object:
    """Relations between poses."""
    found = read_relations(path)
    assert len(found) == found.from_ns.size == found.to_ns.size > 0
    _require_finite(found.T_from_to, (len(found), 4, 4))
    _require_finite(found.planar, (len(found), 3))
    return found
