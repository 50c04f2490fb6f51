"""The whole command line on a simulated drive with a camera: minutes, so marked slow."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typed import typed

TAGS = ("--tags", "apriltag_36h11:0.16")
# The first tag is near enough after 10 s.
DRIVE = ("gallery", "--config", "realsense_d435", "--set", "drive.route.max_duration_s=12")


def _mapped(where: Path, *words: str) -> dict[str, object]:
    done = typed("map", "drive", *words, "--json", cwd=where)
    assert done.returncode == 0, done.stderr
    told: dict[str, object] = json.loads(done.stdout)
    return told


@pytest.mark.slow
def test_a_drive_is_mapped_with_tags_and_without_its_lidar(tmp_path: Path) -> None:
    typed("simulate", *DRIVE, "-o", "drive", cwd=tmp_path)
    by_lidar = _mapped(tmp_path, *TAGS, "-o", "lidar")
    assert isinstance(by_lidar["tags"], list) and by_lidar["tags"]
    assert isinstance(by_lidar["ate_rmse_m"], float) and by_lidar["ate_rmse_m"] < 0.005

    by_images = _mapped(tmp_path, "--places", "-o", "places")
    assert isinstance(by_images["places_seen_again"], int)
    assert isinstance(by_images["ate_rmse_m"], float) and by_images["ate_rmse_m"] < 0.005

    told = _mapped(tmp_path, *TAGS, "--without", "lidar", "-o", "camera")
    assert isinstance(told["ate_rmse_m"], float) and told["ate_rmse_m"] < 0.05
    assert isinstance(told["lidar_ate_rmse_m"], float) and told["lidar_ate_rmse_m"] < 0.05
    assert isinstance(told["tags"], list) and told["tags"]
    written = {path.name for path in (tmp_path / "camera").iterdir()}
    assert {"trajectory.tum", "graph.g2o", "report.html", "ground_truth.tum", "map.pgm"} <= written


@pytest.mark.slow
def test_a_lidar_that_sees_nothing_leaves_the_map_to_the_camera(tmp_path: Path) -> None:
    typed("simulate", *DRIVE, "--set", "sensors.lidar.range_max_m=0.2", "-o", "drive", cwd=tmp_path)
    told = _mapped(tmp_path, "-o", "camera")
    assert "it sees nothing" in str(told["verdict"])
    assert isinstance(told["ate_rmse_m"], float) and told["ate_rmse_m"] < 0.05
