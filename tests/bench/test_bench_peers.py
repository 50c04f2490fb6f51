"""Peers: each gets the same log in the form that its library wants; none takes others down."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from simulated import SLOW_HOKUYO, ScanList, box, drive, noisy_wheels, sense_scans, true_ranges

from slamsim.bench.peers import run as peers_run
from slamsim.bench.peers.base import ENTRIES, PeerEntry, band_points
from slamsim.bench.peers.run import handed_scans, rows_shown, run_peers
from slamsim.config.slam import SlamConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose, se2_from_se3, se3_from_se2
from slamsim.core.types import Log, PlanarTrajectory, ScanGeometry
from slamsim.guard.errors import SlamsimError

ROOM = np.concatenate([box(-4.0, -3.0, 4.0, 3.0), box(1.0, 0.5, 1.6, 1.4)])
WAY = np.array([[-3.0, -2.0], [1.0, -2.0]])
COARSE = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(1.0), 271, 277_000, 0.1, 30.0)
GUIDED = next(entry for entry in ENTRIES if entry.guided)
SHIPPED = next(entry for entry in ENTRIES if not entry.guided)


def recorded(geometry: ScanGeometry, noise_m: float = 0.0) -> tuple[Log, PlanarTrajectory]:
    """A short drive; the odometry is the truth, the laser sits ahead of the base."""
    truth = drive(WAY, max_s=8.0)
    scans = ScanList(sense_scans(ROOM, truth, geometry, noise_m, 1, 500_000_000))
    log = Log("room", "simulation", scans, truth, None, None, np.eye(4))
    return log, truth


def test_a_guided_peer_gets_the_scan_that_a_still_robot_would_have_seen() -> None:
    log, truth = recorded(COARSE)
    checked = 0
    for _, stamp_ns, scan in handed_scans(log, GUIDED):
        here = truth.at(np.array([stamp_ns]))[0]
        standing = PlanarTrajectory(np.array([0, 1 << 62]), np.stack([here, here]))
        expected = true_ranges(ROOM, standing, 0, replace(COARSE, beam_dt_ns=0))
        # A ray that meets the corner of the box, or that fell between two beams, may differ.
        seen = np.isfinite(scan.ranges_m)
        assert seen.mean() > 0.9
        off_m = np.abs(scan.ranges_m - expected)[seen]
        assert np.quantile(off_m, 0.9) < 0.06
        moved = between(truth.poses[0], here)  # the prediction starts from nowhere
        assert np.allclose(scan.T_odom_base, moved, atol=0.01)
        checked += 1
    assert checked > 5


def test_a_peer_as_shipped_gets_the_beams_as_they_were_measured() -> None:
    log, truth = recorded(COARSE)
    scans = list(log.scans)
    handed = list(handed_scans(log, replace(SHIPPED, instant=0.5)))
    assert len(handed) == len(scans)
    for raw, (_, stamp_ns, scan) in zip(scans, handed, strict=True):
        assert stamp_ns == raw.stamp_ns + raw.geometry.duration_ns // 2
        assert np.allclose(scan.ranges_m, raw.ranges_m)
        assert np.allclose(np.hypot(*scan.points_m.T), raw.ranges_m, atol=1e-5)
        assert scan.fired[0] == 0.0 and scan.fired[-1] == 1.0
        assert np.allclose(scan.T_odom_base, truth.at(np.array([stamp_ns]))[0])


def test_points_in_space_are_those_in_the_plane() -> None:
    points = np.array([[1.0, 2.0], [3.0, -4.0]])
    band = band_points(points, 3, 0.2)
    assert sorted(band[:, 2].tolist()) == pytest.approx([-0.2, -0.2, 0.0, 0.0, 0.2, 0.2])
    assert np.allclose(band.reshape(3, 2, 3)[:, :, :2], points)
    a, b = np.array([1.0, 2.0, 0.4]), np.array([-0.3, 0.1, -1.2])
    assert np.allclose(se2_from_se3(se3_from_se2(a)), a)
    assert np.allclose(se2_from_se3(se3_from_se2(a) @ se3_from_se2(b)), compose(a, b))


def test_one_that_fails_is_told_as_lost_and_one_that_is_missing_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fails = PeerEntry("falls", "as shipped", "json", "nowhere", "Nobody", False, 0.5)
    missing = replace(fails, name="absent", library="no_such_library_here")

    class AtOnce:
        """Work in this very process: the log is in its memory."""

        def __enter__(self) -> AtOnce:
            return self

        def __exit__(self, *error: object) -> None: ...

        def run(self, work, *arguments):  # type: ignore[no-untyped-def]
            try:
                return work(*arguments)
            except ModuleNotFoundError as error:
                raise SlamsimError(str(error)) from error

    made, truth = recorded(SLOW_HOKUYO, 0.01)
    log = replace(made, odometry=noisy_wheels(truth, 1))
    monkeypatch.setattr(peers_run, "Children", AtOnce)
    monkeypatch.setattr(peers_run, "ENTRIES", (fails, missing))
    monkeypatch.setattr(peers_run, "read_known", lambda folder: (log, truth))
    figures = run_peers(Path("room"), SlamConfig(), Reporter(quiet=True))
    rows = figures["rows"]
    assert isinstance(rows, list)
    assert [row["name"] for row in rows] == ["slamsim", "slamsim", "falls"]
    assert "nowhere" in rows[2]["lost"] and rows[2]["ratios"] == {}
    assert rows[0]["ratios"] == dict.fromkeys(rows[0]["ratios"], 1.0)
    assert rows[0]["ate_rmse_m"] < 0.02
    shown = rows_shown(figures)
    assert shown["falls, as shipped"].startswith("lost: ")


@pytest.mark.parametrize("entry", ENTRIES, ids=[f"{e.name} {e.how}" for e in ENTRIES])
def test_each_peer_follows_a_short_drive(entry: PeerEntry) -> None:
    if find_spec(entry.library) is None:
        pytest.skip(f"{entry.name} is not installed; the extra 'peers' has it")
    log, truth = recorded(SLOW_HOKUYO, 0.01)
    peer, poses, stamps_ns = None, [], []
    for geometry, stamp_ns, scan in handed_scans(log, entry):
        peer = peer or entry.make(geometry, log.T_base_laser)
        poses.append(peer.step(scan))
        stamps_ns.append(stamp_ns)
    true = truth.at(np.array(stamps_ns))
    off = between(between(true[0], true[-1]), between(poses[0], poses[-1]))
    assert np.isfinite(poses).all()
    if entry.guided:
        assert np.hypot(off[0], off[1]) < 0.2
