"""Clouds for KITTI are freed of the motion by the times that the recording declares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sensing_example import figure_eight

from slamsim.core.types import FloatArray, IntArray
from slamsim.dataset.make.formats import DeskewedScans
from slamsim.io.text.kitti import KittiFolder
from slamsim.recording import RawScans, Recording, ScanLayout

BEAMS, BEAM_NS, STEP_RAD = 181, 500_000, np.deg2rad(1.5)
SWEEP_NS = (BEAMS - 1) * BEAM_NS


def forward(stamps_ns: IntArray) -> RawScans:
    """Beams that fire one after the other from the stamp on."""
    half_rad = 0.5 * (BEAMS - 1) * STEP_RAD
    layout = ScanLayout(-half_rad, half_rad, STEP_RAD, 1e-9 * BEAM_NS, 0.1, 0.1, 30.0)
    drawn = np.random.default_rng(0).uniform(1.0, 9.0, (len(stamps_ns), BEAMS))
    of, ranges_m = np.zeros(len(stamps_ns), dtype=np.int32), drawn.astype(np.float32)
    return RawScans("/scan", ("laser",), stamps_ns, None, (layout,), of, ranges_m)


def backward(scans: RawScans) -> RawScans:
    """The same scans, the beams in the opposite order, stamped as the first of them fires, which
    is the last one that fired."""
    layout = scans.layouts[0]
    turned = replace(
        layout,
        angle_min_rad=layout.angle_max_rad,
        angle_max_rad=layout.angle_min_rad,
        angle_step_rad=-layout.angle_step_rad,
        beam_dt_s=-layout.beam_dt_s,
    )
    ranges_m = np.asarray(scans.ranges_m)[:, ::-1]
    return replace(
        scans, layouts=(turned,), ranges_m=ranges_m, stamps_ns=scans.stamps_ns + SWEEP_NS
    )


def written(scans: RawScans, folder: Path) -> tuple[list[FloatArray], str]:
    """Clouds and poses."""
    drive = figure_eight()
    with KittiFolder(folder) as kitti:
        recording = Recording("a drive", "mcap", (scans,))
        DeskewedScans(kitti).write(recording, scans.stamps_ns, drive)
    clouds = sorted((folder / "sequences" / "00" / "velodyne").iterdir())
    points = [np.fromfile(path, dtype="<f4").reshape(-1, 4) for path in clouds]
    return points, (folder / "poses" / "00.txt").read_text()


def test_scans_whose_last_beam_fires_first_make_the_same_clouds(tmp_path: Path) -> None:
    scans = forward(np.arange(3) * 1_000_000_000)
    clouds, poses = written(scans, tmp_path / "forward")
    turned, same_poses = written(backward(scans), tmp_path / "backward")
    assert same_poses == poses and len(clouds) == 3
    for cloud, other in zip(clouds, turned, strict=True):
        assert len(cloud) == BEAMS
        assert other[::-1] == pytest.approx(cloud, abs=1e-5)
