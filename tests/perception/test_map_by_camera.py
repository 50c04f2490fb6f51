"""``slamsim map`` without a lidar, as it is typed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rgbd_room import FRAMES, K
from typed import typed

from slamsim.config.loading import load_run_config
from slamsim.core.scans import Scan, ScanGeometry
from slamsim.core.types import FloatArray, PlanarTrajectory, Trajectory
from slamsim.guard.errors import OverrideRefused
from slamsim.io.text.tum import read_tum
from slamsim.run import mapping
from slamsim.run.cameras.asked import refuse_wrong_files, require_returns
from slamsim.run.cameras.telling import moved_onto
from slamsim.slam.frontend.scan_order import NothingSeen

pytestmark = pytest.mark.usefixtures("undrawn_figures")


def test_a_folder_of_images_is_mapped(room_images: tuple[Path, FloatArray], tmp_path: Path) -> None:
    folder, true_m = room_images
    done = typed("map", folder, "--intrinsics", K, "-o", "out", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["images"] == FRAMES and told["images_lost"] == 0
    assert "without lidar" in told["verdict"]
    found = read_tum(tmp_path / "out" / "trajectory.tum")
    off_m = np.linalg.norm(found.positions_m - true_m, axis=1)
    assert off_m.max() < 0.005
    assert off_m[-1] < 4.0 * told["sigma_end_m"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"report.html", "report.json", "graph.g2o", "config.yaml"} <= written
    graph = (tmp_path / "out" / "graph.g2o").read_text().splitlines()
    assert sum(line.startswith("VERTEX_SE3:QUAT") for line in graph) == told["keyframes"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "CameraInfo"),
        (("--without", "sonar"), "--without lidar"),
        (("--intrinsics", K, "--set", "slam.landmarks.surveyed=tags.yaml"), "needs scans"),
    ],
)
def test_what_cannot_be_is_told(
    room_images: tuple[Path, FloatArray], tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    done = typed("map", room_images[0], *words, "-o", "out", cwd=tmp_path)
    assert done.returncode != 0 and told in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_world_is_not_mapped_by_camera_alone(tmp_path: Path) -> None:
    for words in (("--without", "lidar"), ("--intrinsics", K)):
        done = typed("map", "labyrinth", *words, "-o", "out", cwd=tmp_path)
        assert done.returncode == 2 and f"{words[0]}: needs a recording" in done.stderr
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--tags", "apriltag_36h11:0.2"), "--tags: needs a camera that sees them"),
        (("--obstacles",), "--obstacles: needs a camera that sees depth"),
        (("--places",), "--places: needs a camera that sees depth"),
        (("--config", "realsense_d435", "--labels", "/x"), "/ground_truth/front/color/instances"),
        (("--config", "realsense_d435", "--tags", "apriltag:1"), "no family of tags"),
        (("--config", "realsense_d435", "--calibration", "none.yaml"), "none.yaml"),
    ],
)
def test_what_a_world_will_not_show_is_refused_before_it_is_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], told: str
) -> None:
    monkeypatch.setattr(mapping, "record", None)
    done = typed("map", "tiny", *words, "-o", "out", cwd=tmp_path)
    assert done.returncode != 0 and told in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_survey_does_not_continue_a_map(tmp_path: Path) -> None:
    words = ["slam.landmarks.tags=apriltag_36h11:0.2"]
    refuse_wrong_files(load_run_config(None, None, words), earlier=())
    survey = tmp_path / "tags.yaml"
    survey.write_text("tags: []\n")
    config = load_run_config(None, None, [*words, f"slam.landmarks.surveyed={survey}"])
    refuse_wrong_files(config)
    with pytest.raises(OverrideRefused, match="keeps its own frame"):
        refuse_wrong_files(config, earlier=())


def test_scans_that_never_return_are_told_before_they_are_tracked() -> None:
    geometry = ScanGeometry(-1.0, 0.5, 5, 0, 0.1, 8.0)
    one = Scan(5, np.array([np.inf, np.nan, 8.0, 0.05, np.inf], np.float32), geometry)
    log: Any = SimpleNamespace(scans=(one, one))
    with pytest.raises(NothingSeen, match="none of the 2 scans"):
        require_returns(log)
    log.scans = (one, replace(one, ranges_m=np.full(5, 3.0, np.float32)))
    require_returns(log)


def test_a_path_of_another_time_is_not_drawn() -> None:
    stamps_ns, poses = np.array([0, 10**9]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    path = Trajectory(stamps_ns, poses, quats)
    later = PlanarTrajectory(stamps_ns + 5 * 10**9, poses)
    assert moved_onto(later, path) is None
    same = moved_onto(PlanarTrajectory(stamps_ns, poses + np.array([3.0, 0.0, 0.0])), path)
    assert same is not None and np.allclose(same, poses[:, :2])
