"""What a user who mistypes is told, and how soon."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.guard.quantities import as_interval, as_lengths, as_number, as_time, with_unit

HEAVY = ("gtsam", "numba", "open3d", "matplotlib", "rerun", "scipy", "rosbags", "pybullet")
LOADED = f"""
import sys
from slamsim.cli.main import app
try:
    app(sys.argv[1:], standalone_mode=False)
except Exception as error:
    print(error)
print([name for name in {HEAVY!r} if name in sys.modules])
"""


@pytest.mark.parametrize(
    "words",
    [
        ["map", "nofile.mcap"],
        ["check", "nofile.mcap"],
        ["fix", "nofile.mcap", "out"],
        ["fault", "nofile.mcap", "out", "--fault", "laser_yaw:2"],
        ["localise", "nofile.mcap", "--in", "."],
        ["view", "nofile.mcap"],
        ["evaluate", "nofile.mcap"],
    ],
)
def test_a_missing_file_is_told_before_heavy_libraries_are_loaded(
    words: list[str], tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.splitlines() == ["nofile.mcap: no such file or folder", "[]"], done.stderr


def said(*words: str) -> str:
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code != 0
    return str(done.exception)


def test_what_config_prints_is_a_world_to_run_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    changed = ("--set", "sensors.lidar.rate_hz=7")
    Path("mine.yaml").write_text(CliRunner().invoke(app, ["config", "tiny", *changed]).stdout)
    again = CliRunner().invoke(app, ["config", "mine.yaml"])
    assert again.exit_code == 0 and again.stdout == Path("mine.yaml").read_text()
    assert "mine.yaml is a run configuration" in said("config", "mine.yaml", "-c", "mine.yaml")


def test_an_unknown_key_is_likened_to_what_is_below_the_same_section_alone() -> None:
    told = said("config", "tiny", "--set", "slam.foo=3")
    assert "the keys here are" in told and "front_end" in told and "floor" not in told
    assert "'front_end'" in said("config", "tiny", "--set", "slam.fron_end=3")


def test_an_output_that_is_there_names_the_option_that_replaces_it(tmp_path: Path) -> None:
    words = ("world", "tiny", "-q", "--out", str(tmp_path / "there"))
    assert CliRunner().invoke(app, words).exit_code == 0
    assert said(*words).endswith("choose another name, or replace it by --overwrite")


def test_a_command_that_helps_can_be_pasted_though_the_path_has_spaces(tmp_path: Path) -> None:
    folder = tmp_path / "my drive"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert f"`slamsim recover '{folder / 'a.mcap'}'` gets back what is whole" in said(
        "map", str(folder)
    )


@pytest.mark.long
def test_a_screenshot_without_a_vulkan_driver_names_the_package(tmp_path: Path) -> None:
    from view_example import example_run

    from slamsim.report.viewer.run import write_recording

    write_recording(tmp_path / "run.rrd", example_run())
    main = "from slamsim.entry import main; main()"
    words = ("view", str(tmp_path / "run.rrd"), "--screenshot", str(tmp_path / "shot.png"))
    done = subprocess.run(
        [sys.executable, "-c", main, *words],
        env={**os.environ, "VK_DRIVER_FILES": "/nowhere", "VK_ICD_FILENAMES": "/nowhere"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1 and not (tmp_path / "shot.png").exists()
    assert "no Vulkan driver" in done.stderr and "apt install mesa-vulkan-drivers" in done.stderr


@pytest.mark.parametrize(
    ("seconds", "told"),
    [
        (0.0, "0 s"),
        (0.00936, "0.0094 s"),
        (9.99, "10 s"),
        (59.7, "1 min"),
        (192.0, "3 min 12 s"),
        (3599.8, "1 h"),
        (46.8 * 60, "46 min 48 s"),
        (5004.0, "1 h 23 min"),
        (3600.0 * 75, "3 days 3 h"),
    ],
)
def test_durations_as_people_say_them(seconds: float, told: str) -> None:
    assert as_time(seconds) == told


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (35617.3, "35,617"),
        (-0.0, "0"),
        (0.0399e-3, "0.0000399"),
        (99999.9, "100,000"),
        (1.0, "1"),
        (float("nan"), "unknown"),
    ],
)
def test_numbers_as_people_read_them(value: float, told: str) -> None:
    assert as_number(value) == told


@given(st.floats(-1e9, 1e9), st.integers(1, 6))
def test_a_number_is_right_to_its_digits(value: float, digits: int) -> None:
    text = as_number(value, digits)
    assert float(text.replace(",", "")) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))
    assert not text.startswith("-0") or value < 0.0


def test_lengths_beside_each_other_have_one_unit() -> None:
    assert as_lengths(0.00017, 0.0462) == ["0.17 mm", "46.2 mm"]
    assert as_lengths(0.00017, 1.234) == ["0.00017 m", "1.23 m"]
    assert with_unit("ate_rmse_m", 0.0003078)[1] == "0.308 mm"
    assert with_unit("ate_rmse_m", 0.5)[1] == "0.5 m" and with_unit("z_m", 0.0)[1] == "0 m"


def test_an_interval_has_as_many_digits_as_it_is_sure_of() -> None:
    assert as_interval(35.1842, 0.0083) == "35.18 ± 0.0083"
    assert as_interval(-0.003, 0.013) == "-0.003 ± 0.013"
    assert as_interval(0.7941, 0.77) == "0.79 ± 0.77"
    assert as_interval(3.1779, 0.0996) == "3.18 ± 0.1"
    assert as_interval(-12.6, 396.0) == "-13 ± 396"
