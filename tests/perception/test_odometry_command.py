"""``slamsim odometry``: a folder of images in, a path and its errors out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rgbd_room import FRAMES, K
from scipy.spatial.transform import Rotation
from typed import typed

from slamsim.core.types import FloatArray, Trajectory
from slamsim.evaluate.spatial import compare_in_space
from slamsim.guard.errors import SlamsimError
from slamsim.io.text.tum import read_tum, write_tum


def test_a_folder_of_images_gives_a_path_and_its_errors(
    room_images: tuple[Path, FloatArray], tmp_path: Path
) -> None:
    folder, true_m = room_images
    first = typed("odometry", folder, "--intrinsics", K, "-o", "first", "--json", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    told = json.loads(first.stdout)
    found = read_tum(tmp_path / "first" / "trajectory.tum")
    assert told["frames"] == len(found) == FRAMES and told["lost_frames"] == 0
    assert told["errors"] is None
    turn = Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    truth = Trajectory(
        found.stamps_ns, turn.apply(true_m) + 5.0, np.tile(turn.as_quat(), (FRAMES, 1))
    )
    write_tum(tmp_path / "true.tum", truth)
    words = ("odometry", folder, "--intrinsics", K, "--truth", "true.tum", "-o", "second")
    second = typed(*words, cwd=tmp_path)
    assert second.returncode == 0, second.stderr
    report = json.loads((tmp_path / "second" / "report.json").read_text())
    assert report["errors"]["ate_rmse_m"] < 0.002 and report["errors"]["drift_percent"] < 4.0
    steps = (tmp_path / "second" / "steps.csv").read_text().splitlines()
    assert len(steps) == FRAMES + 1 and steps[2].split(",")[3] == "tracked"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "CameraInfo"),
        (("--intrinsics", "525,525"), "fx,fy,cx,cy"),
        (("--intrinsics", "0,525,1,1"), "singular"),
        (("--intrinsics", K, "--depth-topic", "/depth"), "no depth on /depth"),
    ],
)
def test_what_is_missing_is_told(
    room_images: tuple[Path, FloatArray], tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    done = typed("odometry", room_images[0], *words, "-o", "out", cwd=tmp_path)
    assert done.returncode != 0 and told in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_errors_in_space_do_not_depend_on_the_frame_and_are_those_of_the_path() -> None:
    rng = np.random.default_rng(5)
    stamps_ns = np.arange(50) * 10_000_000
    positions_m = np.cumsum(rng.normal(0.0, 0.05, (50, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.05, (50, 3)), axis=0))
    truth = Trajectory(stamps_ns, positions_m, turns.as_quat())
    other = Rotation.from_rotvec([0.4, -2.0, 1.0])
    moved = Trajectory(stamps_ns, other.apply(positions_m) - 3.0, (other * turns).as_quat())
    assert compare_in_space(moved, truth).ate_max_m < 1e-9
    assert compare_in_space(moved, truth).end_error_m < 1e-9
    longer = Trajectory(stamps_ns, 1.1 * positions_m, turns.as_quat())
    errors = compare_in_space(longer, truth)
    path_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum()
    end_m = 0.1 * np.linalg.norm(positions_m[-1] - positions_m[0])
    assert errors.drift_percent == pytest.approx(100.0 * end_m / path_m)
    spread_m = positions_m - positions_m.mean(axis=0)
    assert errors.ate_rmse_m <= 0.1 * np.sqrt((spread_m**2).sum(axis=1).mean()) + 1e-12
    with pytest.raises(SlamsimError, match="covers too little"):
        compare_in_space(Trajectory(stamps_ns + 10**12, positions_m, turns.as_quat()), truth)
    still = Trajectory(stamps_ns, np.zeros((50, 3)), turns.as_quat())
    with pytest.raises(SlamsimError, match="does not move"):
        compare_in_space(moved, still)
