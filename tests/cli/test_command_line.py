"""The whole command line on the smallest world, as a user types it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from real_logs import needs_radish, radish
from typed import typed

from slamsim.guard.unpacking import open_lines
from slamsim.io.open import read_log, read_truth
from slamsim.run.naming import is_recording

pytestmark = pytest.mark.usefixtures("drives_here", "undrawn_figures")

REAL_LINES = 1500
SHORT = ("--set", "drive.route.max_duration_s=9", "--set", "sensors.lidar.rate_hz=10")
RUN_FILES = {
    "log",
    "config.yaml",
    "world.yaml",
    "trajectory.tum",
    "odometry.tum",
    "ground_truth.tum",
    "parts",
    "keyframes.csv",
    "graph.g2o",
    "map.pgm",
    "map.yaml",
    "map.png",
    "run.rrd",
    "report.html",
    "report.json",
}


def slamsim(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments), cwd=cwd, capture_output=True, text=True, timeout=240, check=False
    )


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-c", "from slamsim.entry import main; main()", *map(str, arguments)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working directory with one mapped run in it."""
    cwd = tmp_path_factory.mktemp("cwd")
    done = slamsim("map", "tiny", "--json", *SHORT, cwd=cwd)
    assert done.returncode == 0, done.stderr
    (cwd / "stdout.json").write_text(done.stdout)
    return cwd


def test_a_run_leaves_all_its_files_under_the_name_of_its_world(folder: Path) -> None:
    left = {path.name for path in (folder / "outputs" / "tiny").iterdir()}
    assert left >= RUN_FILES
    assert [path.name for path in (folder / "outputs").iterdir()] == ["tiny"]


def test_json_on_stdout_is_the_report_on_disk(folder: Path) -> None:
    printed = json.loads((folder / "stdout.json").read_text())
    stored = json.loads((folder / "outputs" / "tiny" / "report.json").read_text())
    assert printed.pop("folder") == "outputs/tiny"
    assert printed == stored
    assert stored["name"] == "tiny"


def test_the_map_is_better_than_odometry_and_shows_the_walls(folder: Path) -> None:
    report = json.loads((folder / "outputs" / "tiny" / "report.json").read_text())
    assert report["ate_rmse_m"] < min(0.03, report["odometry_ate_rmse_m"])
    assert report["map_wall_precision"] > 0.95
    assert report["map_wall_recall"] > 0.95


def test_the_recording_maps_to_the_same_trajectory_without_its_truth(folder: Path) -> None:
    done = typed("map", "outputs/tiny/log", "--out", "again", "-q", cwd=folder)
    assert done.returncode == 0, done.stderr
    first = (folder / "outputs" / "tiny" / "trajectory.tum").read_bytes()
    assert (folder / "again" / "trajectory.tum").read_bytes() == first


def test_a_folder_without_a_recording_does_not_hide_a_bundled_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("tiny", "mine"):
        (tmp_path / name).mkdir()
    assert not is_recording("tiny")
    assert is_recording("mine")


def test_evaluate_gives_the_scores_of_the_report(folder: Path) -> None:
    done = typed("evaluate", "outputs/tiny", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    scores = json.loads(done.stdout)
    report = json.loads((folder / "outputs" / "tiny" / "report.json").read_text())
    for key in ("ate_rmse_m", "ate_max_m", "odometry_ate_rmse_m"):
        assert scores[key] == pytest.approx(report[key], abs=1e-6)
    assert scores["map_wall_precision"] == pytest.approx(report["map_wall_precision"], abs=0.02)


def test_a_second_run_gets_a_name_of_its_own_and_an_explicit_one_is_refused(folder: Path) -> None:
    done = typed("world", "tiny", "--out", "outputs/tiny", cwd=folder)
    assert done.returncode == 1
    assert "outputs/tiny is there already" in done.stderr
    first, second = (typed("world", "tiny", "--json", cwd=folder) for _ in range(2))
    assert json.loads(first.stdout)["folder"] == "outputs/tiny_world"
    assert json.loads(second.stdout)["folder"] == "outputs/tiny_world_2"


def test_a_world_on_disk_is_the_same_world_again(folder: Path) -> None:
    """What ``slamsim world`` writes is a world file, a map and a mesh that can all be read back."""
    made = typed("world", "tiny", "--seed", "5", "--out", "w", cwd=folder)
    assert made.returncode == 0, made.stderr
    for source in ("w/world.yaml", "w/map.yaml", "w/world.stl"):
        copy = source.replace("/", "_").replace(".", "_")
        done = typed("world", source, "--out", copy, "-q", cwd=folder)
        assert done.returncode == 0, done.stderr
    assert (folder / "w_world_yaml" / "world.stl").read_bytes() == (
        folder / "w" / "world.stl"
    ).read_bytes()


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes_from_anywhere(folder: Path, tmp_path: Path) -> None:
    """In a process of its own, as the run in the folder: once workers ran in the test's process,
    its children use fewer CPU instructions than it does (``process/instructions.py``)."""
    done = slamsim("simulate", "tiny", *SHORT, "--out", "run", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    one, same = (
        {path.name: hashlib.sha256(path.read_bytes()).digest() for path in log.iterdir()}
        for log in (folder / "outputs" / "tiny" / "log", tmp_path / "run" / "log")
    )
    assert len(one) >= 2
    assert one == same


def test_another_seed_gives_other_noise(folder: Path) -> None:
    done = typed("simulate", "tiny", *SHORT, "--seed", "9", "--out", "other", "-q", cwd=folder)
    assert done.returncode == 0, done.stderr
    one, other = (
        next(iter(read_log(path).scans)).ranges_m
        for path in (folder / "outputs" / "tiny" / "log", folder / "other" / "log")
    )
    assert not np.array_equal(one, other)


def test_the_log_and_its_truth_are_apart(folder: Path) -> None:
    path = folder / "outputs" / "tiny" / "log"
    truth = read_truth(path)
    assert truth is not None
    assert read_log(path).odometry is not None


def test_config_prints_what_can_be_used_again(folder: Path) -> None:
    printed = typed("config", "tiny", "--set", "sensors.lidar=rplidar_a2", cwd=folder)
    assert printed.returncode == 0, printed.stderr
    (folder / "mine.yaml").write_text(printed.stdout)
    again = typed("config", "tiny", "--config", "mine.yaml", cwd=folder)
    assert again.stdout == printed.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["map", "labirynth"], 10, "did you mean the bundled 'labyrinth'"),
        (["map", "missing.clf"], 10, "no such file"),
        (["map", "tiny", "--set", "slam.front_end.matcher=kis"], 2, "did you mean 'kiss'"),
        (["map", "tiny", "--set", "sensors.lidar.rat_hz=3"], 2, "did you mean 'rate_hz'"),
        (["map", "foreign.mcap"], 3, "foreign.mcap"),
        (["map", "empty.clf"], 3, "empty"),
        (["evaluate", "outputs/tiny/trajectory.tum"], 1, "--truth or --relations"),
        (["view", "missing"], 10, "no such file or folder"),
        (["bench", "nothing"], 1, "choose from all"),
        (["simulate", "tiny", "--seed", "-1"], 2, "--seed"),
    ],
)
def test_a_mistake_costs_one_sentence(
    folder: Path, arguments: list[str], code: int, words: str
) -> None:
    (folder / "foreign.mcap").write_text("hello")
    (folder / "empty.clf").touch()
    done = typed(*arguments, cwd=folder)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_robot_that_gets_stuck_leaves_what_was_driven(tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(
        "twists:\n- {t_s: 0.0, v_m_s: 0.4, w_rad_s: 0.0}\n- {t_s: 40.0, v_m_s: 0.0, w_rad_s: 0.0}\n"
    )
    done = typed(
        "simulate", "tiny", "--set", "drive.route.file=wall.yaml", "--out", "run", cwd=tmp_path
    )
    assert done.returncode == 1
    assert "the drive ended early" in done.stderr
    assert "stuck" in done.stderr
    assert read_log(tmp_path / "run" / "log").odometry is not None


def test_help_is_there_with_examples_and_quick_to_import(folder: Path) -> None:
    done = typed("map", "--help", cwd=folder)
    assert done.returncode == 0
    assert "slamsim map labyrinth" in done.stdout


@pytest.mark.long
@needs_radish
def test_a_real_log_is_mapped_and_scored(tmp_path: Path) -> None:
    """The beginning of fr079: no IMU, 0.5 degree beams, a laser 4 cm behind the base."""
    whole, relations = radish("fr079")
    log = tmp_path / "begin.clf"
    log.write_text("".join(f"{line}\n" for _, line in islice(open_lines(whole), REAL_LINES)))
    done = typed("map", log, "--relations", relations, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["relations"]["all"]["translation_mean_m"] < 0.258
