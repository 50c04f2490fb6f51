"""Runs peers and SLAM on the same log, each in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from typing import cast

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.logs import Children
from slamsim.bench.peers.base import ENTRIES, Peer, PeerEntry, PeerScan
from slamsim.config.slam import SlamConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, Scan, ScanGeometry
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.io.open import read_log, read_truth
from slamsim.process.children import peak_memory_mb
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.frontend.motion import predict_motion
from slamsim.slam.session import run_slam

LOST_M = 100.0
"""A peer this far from the truth, or that gives no finite pose, is lost."""

OURS = "slamsim"


def run_peers(folder: Path, config: SlamConfig, reporter: Reporter) -> Figures:
    """ATE, time per scan and memory of SLAM and of every peer that is installed, on one log.

    Times are of the process that works, all its threads; for peers only what the library does,
    for ours everything. ``ratios``: to ours. A peer that fails is told as lost, with the reason.
    """
    rows: list[Figures] = []
    with Children() as children, reporter.stage("peers") as progress:
        rows.append({"name": OURS, "how": "whole", **children.run(measure_ours, folder, config)})
        rows.append(
            {"name": OURS, "how": "front end", **children.run(measure_front, folder, config)}
        )
        for number, entry in enumerate(ENTRIES):
            progress(number, len(ENTRIES))
            if find_spec(entry.library) is None:
                reporter.warn(f"{entry.name} is not installed (pip install 'slamsim[peers]')")
                continue
            rows.append({"name": entry.name, "how": entry.how, **_alone(entry, folder, children)})
    for row in rows:
        row["ratios"] = _ratios(row, rows[0])
    return {"log": str(folder), "rows": rows, "settings": [asdict(entry) for entry in ENTRIES]}


def measure_ours(folder: Path, config: SlamConfig) -> Figures:
    """The whole of SLAM, from the scans to the final solution."""
    log, truth = read_known(folder)
    watch = _Stopwatch()
    with watch:
        result = run_slam(log, config)
    return _scored(result.trajectory, truth, len(log.scans), watch)


def measure_front(folder: Path, config: SlamConfig) -> Figures:
    """The scan matcher alone: no loop is closed."""
    log, truth = read_known(folder)
    closures = config.back_end.closures.model_copy(update={"enabled": False})
    open_ended = config.back_end.model_copy(update={"closures": closures})
    watch = _Stopwatch()
    with watch:
        result = run_slam(log, config.model_copy(update={"back_end": open_ended}))
    assert result.front_end is not None
    return _scored(result.front_end, truth, len(log.scans), watch)


def measure_peer(entry: PeerEntry, folder: Path) -> Figures:
    """One peer over all scans. Raises SlamsimError if it gets lost."""
    log, truth = read_known(folder)
    peer: Peer | None = None
    stamps_ns: list[int] = []
    poses: list[FloatArray] = []
    watch = _Stopwatch()
    for geometry, stamp_ns, handed in handed_scans(log, entry):
        if peer is None:
            peer = entry.make(geometry, log.T_base_laser)
        with watch:
            pose = peer.step(handed)
        if not np.isfinite(pose).all():
            raise SlamsimError(f"its pose is not finite at scan {len(poses)}")
        stamps_ns.append(stamp_ns)
        poses.append(pose)
    trajectory = PlanarTrajectory(np.array(stamps_ns, dtype=np.int64), np.array(poses))
    figures = _scored(trajectory, truth, len(poses), watch)
    if cast(float, figures["ate_max_m"]) > LOST_M:
        raise SlamsimError(f"it is {figures['ate_max_m']:.0f} m off at worst")
    return figures


def rows_shown(figures: Figures) -> dict[str, str]:
    """A line per peer: error, time and memory, then the same as multiples of ours."""
    rows = cast(list[Figures], figures["rows"])
    return {f"{row['name']}, {row['how']}": _line(row) for row in rows}


def _line(row: Figures) -> str:
    if "lost" in row:
        return f"lost: {row['lost']}"
    number, ratios = cast(Mapping[str, float], row), cast(Mapping[str, float], row["ratios"])
    return (
        f"{1e3 * number['ate_rmse_m']:8.2f} mm ({1e3 * number['ate_max_m']:.1f} max)"
        f"{number['cpu_ms_per_scan']:8.2f} ms{number['peak_memory_mb']:6.0f} MB"
        f"   x{ratios['ate_rmse_m']:.3g}, x{ratios['cpu_ms_per_scan']:.2g}, "
        f"x{ratios['peak_memory_mb']:.2g}"
    )


def _alone(entry: PeerEntry, folder: Path, children: Children) -> Figures:
    try:
        return children.run(measure_peer, entry, folder)
    except SlamsimError as error:
        return {"lost": str(error)}


def _ratios(row: Figures, ours: Figures) -> Figures:
    keys = ("ate_rmse_m", "ate_max_m", "cpu_ms_per_scan", "peak_memory_mb")
    return {key: cast(float, row[key]) / cast(float, ours[key]) for key in keys if key in row}


def read_known(folder: Path) -> tuple[Log, PlanarTrajectory]:
    """A recording and its truth. Raises InputRefused for one that knows none."""
    truth = read_truth(folder)
    if truth is None:
        raise InputRefused(folder, "this recording holds no truth")
    return read_log(folder), truth.planar()


def _scored(
    trajectory: PlanarTrajectory, truth: PlanarTrajectory, scans: int, watch: _Stopwatch
) -> Figures:
    errors = compare(trajectory, truth)
    off_m, off_rad = statistics(errors.translation_m), statistics(errors.rotation_rad)
    return {
        "ate_rmse_m": off_m.rmse,
        "ate_max_m": off_m.max,
        "ate_rot_rmse_deg": float(np.rad2deg(off_rad.rmse)),
        "ms_per_scan": 1e3 * watch.wall_s / scans,
        "cpu_ms_per_scan": 1e3 * watch.cpu_s / scans,
        "peak_memory_mb": peak_memory_mb(),
    }


class _Stopwatch:
    """Wall time and this process's own time, summed over every ``with`` block."""

    def __init__(self) -> None:
        self.wall_s = self.cpu_s = 0.0

    def __enter__(self) -> None:
        self.wall_s -= time.perf_counter()
        self.cpu_s -= time.process_time()

    def __exit__(self, *error: object) -> None:
        self.wall_s += time.perf_counter()
        self.cpu_s += time.process_time()


def handed_scans(log: Log, entry: PeerEntry) -> Iterator[tuple[ScanGeometry, int, PeerScan]]:
    """Each scan as the peer gets it, with the instant that its pose is for."""
    motion = predict_motion(log)
    odometry = motion if entry.guided or log.odometry is None else log.odometry
    for together in log.scans:
        scan = replace(together, beside=())  # peers match the scans of one lidar
        stamp_ns = scan.stamp_ns + round(entry.instant * scan.geometry.duration_ns)
        first, last = min(scan.stamp_ns, stamp_ns), max(scan.end_ns, stamp_ns)
        if first < odometry.stamps_ns[0] or last > odometry.stamps_ns[-1]:
            continue
        points, fired, ranges = _deskewed(scan, motion, log) if entry.guided else _raw(scan, log)
        T_odom_base = odometry.at(np.array([stamp_ns]))[0]
        yield scan.geometry, stamp_ns, PeerScan(points, fired, ranges, T_odom_base)


def _raw(scan: Scan, log: Log) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hits in the base frame as if the robot had stood, when each fired, and the ranges."""
    geometry = scan.geometry
    ranges = scan.ranges_m.astype(np.float64)
    hit = (ranges >= geometry.range_min_m) & (ranges < geometry.range_max_m)
    angles, T = geometry.angles_rad()[hit], log.T_base_laser
    beams = np.column_stack([np.cos(angles), np.sin(angles)]) * ranges[hit, None]
    points = beams @ T[:2, :2].T + T[:2, 3]
    fired = np.linspace(0.0, 1.0, geometry.beam_count)[hit]
    return points, fired, np.where(hit, ranges, np.inf)


def _deskewed(
    scan: Scan, motion: PlanarTrajectory, log: Log
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hits as seen from the base at the first beam, and the scan that would have shown them."""
    cloud = deskew(scan, motion, scan.stamp_ns, log.T_base_laser)
    points = cloud.points_m[cloud.hit]
    T, geometry = log.T_base_laser, scan.geometry
    beams = (points - T[:2, 3]) @ T[:2, :2]
    angles = np.arctan2(beams[:, 1], beams[:, 0]) - geometry.angle_min_rad
    angles = np.mod(angles + 0.5 * abs(geometry.angle_step_rad), 2.0 * np.pi)
    if geometry.angle_step_rad < 0.0:
        angles = 2.0 * np.pi - angles
    beam = (angles / abs(geometry.angle_step_rad)).astype(np.int64)
    ranges = np.full(geometry.beam_count, np.inf)
    seen = beam < geometry.beam_count
    np.minimum.at(ranges, beam[seen], np.hypot(beams[seen, 0], beams[seen, 1]))
    return points, np.zeros(len(points)), ranges
