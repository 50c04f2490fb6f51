"""Every command of slamsim that README and documentation show is run as it is written, in a folder
that holds the files it names; the drives of simulated worlds are cut short."""

from __future__ import annotations

import itertools
import shlex
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from rgbd_room import write_images
from test_documentation import ROOT, commands
from two_lidars import front_and_rear
from typer.testing import CliRunner

from slamsim.cameras.lens import pinhole
from slamsim.cli.main import app
from slamsim.io.bag2.writer import write_recording
from slamsim.recording import RawImu, RawOdometry

RUN_ELSEWHERE = {
    "--relations": "io/test_logs_carmen.py",
    "bench": "bench",
    "calibrate": "perception/test_calibration_mount.py",
    "dataset make diverse": "dataset/test_dataset_images.py",
    "dataset make examples/": "project/test_examples.py",
    "dataset plan labyrinths": "cli/test_piped_output.py",
    "dataset preview diverse": "cli/test_piped_output.py",
    "demo": "cli/test_piped_output.py",
    "identify": "cli/test_piped_output.py",
    "live": "live",
    "replay": "cli/test_piped_output.py",
    "scenario": "cli/test_piped_output.py",
    "sinks=[{type: foxglove": "simulation/test_sinks.py",
    "view": "report/test_view_recording.py",
}
"""Words of a command that takes an hour, does not end by itself, opens a window or needs another
machine, and the tests that run the same with smaller input."""

SHORT = ["--set", "drive.route.max_duration_s=6"]
WORLDS = tuple(path.stem for path in (ROOT / "worlds").glob("*.yaml"))
BASE = "base_footprint"
Maker = Callable[[Path], None]


def typed(*words: str) -> None:
    done = CliRunner().invoke(app, [*words])
    assert done.exit_code == 0, f"{shlex.join(words)}\n{done.output}\n{done.exception}"


def simulated(*words: str) -> Maker:
    """A drive of the smallest world with few beams."""
    few = ["--set", "sensors.lidar=lds_01"]
    return lambda out: typed("simulate", "tiny", "-q", "--out", str(out), *few, *SHORT, *words)


def with_cameras(out: Path) -> None:
    config = ["--config", "realsense_d435"]
    typed("simulate", "gallery", "-q", "--out", str(out), *config, *SHORT)


def one_file(out: Path) -> None:
    simulated()(folder := out.with_suffix(".made"))
    shutil.copy(folder / "log" / "log_0.mcap", out)


def cut_off(out: Path) -> None:
    one_file(out)
    out.write_bytes(out.read_bytes()[:-1000])


def robot_with_two_lidars(out: Path) -> None:
    whole = front_and_rear()
    for kind, topic in (RawOdometry, "/odometry/raw"), (RawImu, "/imu/data"):
        whole = whole.with_streams(kind, [replace(s, topic=topic) for s in whole.of(kind)])
    edges = (
        replace(
            edge,
            parent=edge.parent.replace(BASE, "base_link"),
            child=edge.child.replace(BASE, "base_link"),
        )
        for edge in whole.transforms
    )
    odometry = [replace(each, child_frame_ids=("base_link",)) for each in whole.of(RawOdometry)]
    whole = whole.with_streams(RawOdometry, odometry)
    write_recording(replace(whole, transforms=tuple(edges)), out)


def mapped(*words: str) -> Maker:
    return lambda out: typed("map", *words, "-q", "--out", str(out), *SHORT)


def folder_of_images(out: Path) -> None:
    write_images(out, pinhole(160, 120, 69.0), 6)


def folder_of_tum(out: Path) -> None:
    with_cameras(drive := out.with_suffix(".made"))
    typed("convert", str(drive), str(out), "--to", "tum")


def truth_of_tum(out: Path) -> None:
    folder_of_tum(folder := out.with_suffix(".images"))
    shutil.copy(folder / "groundtruth.txt", out)


def tags_of_the_gallery(out: Path) -> None:
    typed("world", "gallery", "-q", "--out", str(folder := out.with_suffix(".made")))
    shutil.copy(folder / "tags.yaml", out)


def configuration(out: Path) -> None:
    out.write_text(CliRunner().invoke(app, ["config", "tiny"]).stdout)


FILES: dict[str, Maker] = {
    "cut_off.mcap": cut_off,
    "drive": robot_with_two_lidars,
    "groundtruth.txt": truth_of_tum,
    "livingroom": folder_of_images,
    "mine.yaml": configuration,
    "my_data": lambda out: typed("dataset", "make", "tiny", "-n", "2", "-q", "--out", str(out)),
    "my_drive": with_cameras,
    "my_map": mapped("gallery", "--config", "realsense_d435", "--tags", "apriltag_36h11:0.2"),
    "my_recording.mcap": one_file,
    "my_rosbag2": with_cameras,
    "outputs/labyrinth": mapped("tiny", "--set", "sensors.lidar=lds_01"),
    "rgbd_dataset_freiburg1_desk": folder_of_tum,
    "second_drive": simulated("--drive-seed", "1"),
    "tags.yaml": tags_of_the_gallery,
    "third_drive": simulated("--drive-seed", "2"),
}
TOLD_TO_FAIL = ("localise", "--continue", "my_rosbag2/ --without", "fix ")
"""Six seconds of a drive show too little to be found in a map, and a healthy recording has
nothing to fix: exit code 1."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A file of a name, made when it is first asked for."""
    folder = tmp_path_factory.mktemp("files")

    def path_of(name: str) -> Path:
        path = folder / name
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            FILES[name](path)
        return path

    return path_of


def words_of(call: str) -> list[str]:
    return shlex.split(call.partition(" > ")[0], comments=True)[1:]


def elsewhere(words: Sequence[str]) -> str | None:
    """The test that runs this command, where it is not run here."""
    text = " ".join(words)
    for some, test in RUN_ELSEWHERE.items():
        if text.startswith(some) or (some.startswith(("--", "sinks")) and some in text):
            return test
    return None


CALLS = sorted({shlex.join(words_of(call)) for call in commands()} - {"--install-completion"})


def test_what_is_run_elsewhere_is_shown_and_has_a_test() -> None:
    shown = {test for call in CALLS if (test := elsewhere(shlex.split(call)))}
    assert shown == set(RUN_ELSEWHERE.values())
    assert all((ROOT / "tests" / test).exists() for test in shown)


@pytest.mark.slow
@pytest.mark.parametrize("call", [call for call in CALLS if not elsewhere(shlex.split(call))])
def test_a_command_runs_as_it_is_written(
    call: str, made: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = shlex.split(call)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "worlds").symlink_to(ROOT / "worlds")
    for word in words:
        name = word.rpartition("=")[2].rstrip("/")
        if name in FILES and name not in outputs_of(words):
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).symlink_to(made(name))
    if words[0] in ("map", "simulate") and Path(words[1]).stem in WORLDS:
        words += SHORT
    done = CliRunner().invoke(app, words)
    unsure = any(some in call for some in TOLD_TO_FAIL)
    assert done.exit_code in ((0, 1) if unsure else (0,)), f"{done.output}\n{done.exception}"


def outputs_of(words: Sequence[str]) -> set[str]:
    """What the command makes itself."""
    return {b.rstrip("/") for a, b in itertools.pairwise(words) if a in ("-o", "--out")}
