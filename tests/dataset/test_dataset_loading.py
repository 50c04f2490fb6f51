"""A recipe that cannot be made is refused in one sentence with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.guard.errors import InputRefused, NotFound

HEAD = "name: mine\ntitle: mine\nworlds: [{world: tiny}]\n"


def refused(folder: Path, text: str) -> str:
    path = folder / "recipe.yaml"
    path.write_text(text)
    with pytest.raises(InputRefused) as caught:
        load_recipe(str(path))
    return str(caught.value).removeprefix(f"{path}, ")


@pytest.mark.parametrize(
    ("text", "where", "reason"),
    [
        # Keys of the recipe, and those that vary.
        ("worldz: 3", "line 4, worldz", "unknown key 'worldz'; did you mean 'worlds'?"),
        (
            "vary:\n  sensors.lidar.rate_hzz: 3",
            "line 5, sensors.lidar.rate_hzz",
            "unknown key 'rate_hzz'; did you mean 'rate_hz'?",
        ),
        (
            "vary: {sensors: {lidar: 3}}",
            "line 4, vary.sensors",
            "there is no distribution 'lidar'; one of constant, choice",
        ),
        (
            "vary:\n  world.maze.rows: 3",
            "line 5, vary.world.maze.rows",
            "cannot vary here: list worlds under 'world'",
        ),
        ("vary:\n  seed: 3", "line 5, vary.seed", "is every sequence's own"),
        ("vary:\n  slam.seed: 3", "line 5, vary.slam.seed", "is not part of a recording"),
        ("vary:\n  robot.urdf_file: x", "line 5, vary.robot.urdf_file", "a variant of its own"),
        # Values that a key does not take, at either end of the distribution.
        (
            "vary:\n  sensors.lidar.rate_hz: {uniform: [0, 10]}",
            "line 5, sensors.lidar.rate_hz",
            "must be greater than 0.01 and at most 1000, not 0.0",
        ),
        (
            "vary:\n  sensors.lidar.beam_count: {integers: [100, 2000]}",
            "line 5, sensors.lidar",
            "2000 beams of 0.25 deg sweep 500 deg",
        ),
        (
            "vary:\n  sensors.lidar.beam_count: {uniform: [100, 200]}",
            "line 5, sensors.lidar.beam_count",
            "must be a whole number, not 100.0",
        ),
        (
            "vary:\n  sensors.encoders.wheel_scale_error: [{uniform: [0, 0.1]}]",
            "line 5, sensors.encoders.wheel_scale_error",
            "must be a list of 2 values, not of 1",
        ),
        (
            "vary:\n  sensors.lidar: {choice: [utm_31lx, lds_01]}",
            "line 5, vary.sensors.lidar",
            "did you mean the bundled 'utm_30lx'?",
        ),
        ("duration_s: {uniform: [0, 3]}", "line 4, duration_s", "more than 0"),
        ("duration_s: null", "line 4, duration_s", "at most 86400 seconds, not None"),
        ("duration_s: .inf", "line 4, duration_s", "not inf"),
        ("licence: my own", "line 4, licence", "LicenseRef-"),
        ("presets: {sensors.lidr: {a: {}}}", "line 4, presets.sensors.lidr", "sensors.lidar"),
        (
            "drives:\n - drive: tour\n   vary: {limits.max_speed_m_s: {uniform: [0.1, 20]}}",
            "line 6, drive.limits.max_speed_m_s",
            "must be greater than 0 and at most 10, not 20.0",
        ),
        ("vary: {robot: turtlebot2, robot.imu.z_m: -1}", "line 4, robot.imu.z_m", "at least 0"),
        # Shares and weights.
        (
            "splits: {train: 0.5, val: 0.1, test: 0.1}",
            "line 4, splits",
            "the shares must be 1 in sum, not 0.7",
        ),
        ("splits: {train: 1.5, val: -0.5, test: 0}", "line 4, splits.train", "at most 1, not 1.5"),
        (
            "splits: {train: 0.33333, val: 0.33333, test: 0.33334}",
            "line 4, splits",
            "at most four decimals",
        ),
        ("drives: [{drive: tour, weight: 0}]", "line 4, drives", "all weights are zero"),
        # Faults.
        (
            "faults: {none: 0.5, one: 0.5, choice: [{fault: lidar_lat}]}",
            "line 4, faults.choice[0].fault",
            "did you mean the bundled 'lidar_late'?",
        ),
        (
            "faults: {none: 0.5, one: 0.5, choice: [{fault: laser_mirrored, size: 3}]}",
            "line 4, faults.choice[0].fault",
            "has no size",
        ),
        (
            "faults: {none: 0.5, one: 0.5, choice: [{fault: lidar_late, size: soon}]}",
            "line 4, faults.choice[0].size",
            "a fault's size is a number",
        ),
        ("faults: {none: 0.5, one: 0.5}", "line 4, faults", "choice names none"),
        # Files.
        ("config: labyrinth_11hz", "line 4, config", "did you mean the bundled 'labyrinth_10hz'?"),
        ("drives: [{drive: tuor}]", "line 4, drives[0].drive", "did you mean the bundled 'tour'?"),
        ("formats: [mcap, mcap]", "line 4, formats", "one is named twice"),
    ],
)
def test_what_cannot_be_made(tmp_path: Path, text: str, where: str, reason: str) -> None:
    told = refused(tmp_path, f"{HEAD}{text}\n")
    assert told.startswith(f"{where}: "), told
    assert reason in told


def test_names_that_are_paths_are_refused(tmp_path: Path) -> None:
    assert "'../x' is not a valid name" in refused(tmp_path, HEAD.replace("mine", "../x", 1))


def test_worlds_that_do_not_fit_are_told_with_what_was_drawn(tmp_path: Path) -> None:
    text = HEAD.replace("tiny}", "tiny, vary: {maze.cell_m: {uniform: [0.9, 2.0]}}}")
    told = refused(tmp_path, text)
    assert told.startswith("line 3, worlds[0]: the world does not fit")
    assert told.endswith("where world.maze.cell_m = 0.9")


def test_a_robot_that_cannot_stand_is_told(tmp_path: Path) -> None:
    text = "vary: {robot: turtlebot2, robot.base.bottom_z_m: {uniform: [0.0, 0.02]}}"
    assert "line 4, " in refused(tmp_path, HEAD + text + "\n")


def test_files_and_presets_may_stand_beside_or_in_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "hall.yaml").write_text("name: hall\nmaze: {rows: 2, columns: 5}\n")
    (tmp_path / "recipe.yaml").write_text(
        "name: mine\ntitle: mine\nconfig: {sensors: {imu: {rate_hz: 50}}}\n"
        "worlds:\n - {world: hall.yaml}\n - {world: {preset: tiny, clearance_m: 0.5}, name: own}\n"
        "drives: [{drive: {limits: {max_speed_m_s: 0.2}}}]\n"
        "vary: {sensors.lidar: {choice: [sparse, lds_01]}}\n"
        "presets: {sensors.lidar: {sparse: {beam_count: 8, angle_step_deg: 45}}}\n"
    )
    recipe = load_recipe(str(tmp_path / "recipe.yaml"))
    (tmp_path / "hall.yaml").unlink()
    specs = [sequence_spec(recipe, index, 40) for index in range(40)]
    assert {spec.drawn["world"] for spec in specs} == {"hall", "own"}
    assert {spec.config.sensors.lidar.beam_count for spec in specs} == {8, 360}
    for spec in specs:
        assert spec.config.sensors.imu.rate_hz == 50
        assert spec.config.drive.limits.max_speed_m_s == 0.2
        hall = spec.drawn["world"] == "hall"
        assert spec.config.world.clearance_m == (0.6 if hall else 0.5)


def test_no_such_recipe() -> None:
    with pytest.raises(NotFound, match="did you mean the bundled 'labyrinths'"):
        load_recipe("labyrinth")
