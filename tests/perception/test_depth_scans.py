"""Scans of depth images: beams against the walls of a room by plain geometry; maps by them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typed import typed

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import Float32Array, FloatArray
from slamsim.perception.depth_scans import MOST_DEPTH_M, STEP_RAD, DepthBeams, depth_beams

pytestmark = pytest.mark.usefixtures("undrawn_figures")
WIDTH, HEIGHT, FOCAL_PX = 160, 120, 90.0
K = np.array([[FOCAL_PX, 0.0, 79.5], [0.0, FOCAL_PX, 59.5], [0.0, 0.0, 1.0]])
MODEL = CameraModel(WIDTH, HEIGHT, K)
R_BASE_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Looking ahead."""
TOPIC = "/front_camera/depth/image_raw"
DRIVE = ("tiny", "--config", "depth_camera", "--set", "drive.route.max_duration_s=8")


def placed(height_m: float, yaw_deg: float, pitch_deg: float, roll_deg: float) -> FloatArray:
    T = np.eye(4)
    turn = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    T[:3, :3], T[2, 3] = turn @ R_BASE_OPTICAL, height_m
    return T


def room(T_base_camera: FloatArray, half_m: tuple[float, float]) -> Float32Array:
    """(h, w) depth of a floor and four walls without end, the base in the middle."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = np.stack([(u - K[0, 2]) / FOCAL_PX, (v - K[1, 2]) / FOCAL_PX, np.ones(u.shape)], axis=2)
    rays = rays @ T_base_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = np.minimum(half_m[0] / np.abs(rays[..., 0]), half_m[1] / np.abs(rays[..., 1]))
        floor = np.where(rays[..., 2] < 0.0, T_base_camera[2, 3] / -rays[..., 2], np.inf)
    return np.asarray(np.minimum(walls, floor), dtype=np.float32)


def walls_m(angles_rad: FloatArray, half_m: tuple[float, float]) -> FloatArray:
    with np.errstate(divide="ignore"):
        x_m, y_m = half_m[0] / np.abs(np.cos(angles_rad)), half_m[1] / np.abs(np.sin(angles_rad))
    return np.asarray(np.minimum(x_m, y_m), dtype=np.float64)


def angles(beams: DepthBeams) -> FloatArray:
    layout, count = beams.layout, len(beams.pixels)
    steps = np.arange(count, dtype=np.float64)
    found: FloatArray = layout.angle_min_rad + layout.angle_step_rad * steps
    assert found[-1] == pytest.approx(layout.angle_max_rad) and layout.angle_step_rad >= STEP_RAD
    return found


@settings(max_examples=60, deadline=None)
@given(
    height_m=st.floats(0.2, 1.2),
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-15.0, 25.0),
    roll_deg=st.sampled_from([0.0, 5.0, 90.0, 180.0]),
    half_m=st.tuples(st.floats(1.0, 6.0), st.floats(1.0, 6.0)),
)
def test_beams_end_at_walls(
    height_m: float, yaw_deg: float, pitch_deg: float, roll_deg: float, half_m: tuple[float, float]
) -> None:
    T_base_camera = placed(height_m, yaw_deg, pitch_deg, roll_deg)
    beams = depth_beams(MODEL, T_base_camera)
    assert beams is not None
    ranges_m = beams.ranges_m(room(T_base_camera, half_m))
    known, there = ~np.isnan(ranges_m), angles(beams)
    # A beam is the median of what lies half a step to both sides; corners lie between samples.
    aside = there + np.linspace(-1.0, 1.0, 21)[:, None] * beams.layout.angle_step_rad
    nearest_m, farthest_m = walls_m(aside, half_m).min(axis=0), walls_m(aside, half_m).max(axis=0)
    is_far = np.isinf(ranges_m)
    assert (farthest_m[is_far] > MOST_DEPTH_M).all()
    seen = known & ~is_far
    assert (ranges_m[seen] >= nearest_m[seen] - 1e-3).all()
    assert (ranges_m[seen] <= farthest_m[seen] + 1e-3).all()
    if abs(pitch_deg) < 10.0 and height_m > 0.5:  # then no beam ends on the floor nearer than 4 m
        assert known.all()


def test_nothing_is_made_of_floor_or_of_pixels_without_depth() -> None:
    level = placed(0.3, 0.0, 0.0, 0.0)
    beams = depth_beams(MODEL, level)
    assert beams is not None
    assert np.isnan(beams.ranges_m(np.full((HEIGHT, WIDTH), np.nan, np.float32))).all()
    assert np.isnan(beams.ranges_m(np.zeros((HEIGHT, WIDTH), np.float32))).all()
    assert np.isinf(beams.ranges_m(np.full((HEIGHT, WIDTH), 9.0, np.float32))).all()
    leaning = placed(0.3, 0.0, 50.0, 0.0)
    down = depth_beams(MODEL, leaning)
    assert down is not None and "-1" in down.in_words
    ranges_m = down.ranges_m(room(leaning, (9.0, 9.0)))
    assert not np.isfinite(ranges_m).any()


@pytest.mark.parametrize("pitch_deg", [90.0, 80.0, -85.0])
def test_a_camera_that_looks_up_or_down_makes_no_scans(pitch_deg: float) -> None:
    assert depth_beams(MODEL, placed(0.5, 0.0, pitch_deg, 0.0)) is None


def test_a_drive_is_mapped_by_depth_as_by_a_lidar(tmp_path: Path) -> None:
    assert typed("simulate", *DRIVE, "-o", "drive", cwd=tmp_path).returncode == 0
    told = []
    for words in (("--scan-topic", TOPIC), ("--without", "lidar", "--obstacles")):
        done = typed("map", "drive", *words, "-o", "out", "--overwrite", "--json", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        told.append(json.loads(done.stdout))
    assert told[0]["ate_rmse_m"] == told[1]["ate_rmse_m"] < 0.02
    assert told[0]["lidar_own_ate_rmse_m"] < told[0]["lidar_ate_rmse_m"] < 0.02
    assert told[0]["verdict"].startswith("Mapped by depth images, without lidar (as asked).")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"map.pgm", "map.yaml", "run.rrd", "obstacles.pgm", "report.html"} <= written
    for wrong, reason in (
        (("--scan-topic", TOPIC[:-1]), "has no such topic"),
        (("--scan-topic", TOPIC, "--scan-topic", "/scan"), "are mapped alone"),
    ):
        done = typed("map", "drive", *wrong, "-o", "no", cwd=tmp_path)
        assert done.returncode == 2 and reason in done.stderr
        assert not (tmp_path / "no").exists()
