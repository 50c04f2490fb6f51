"""A run put together from names, paths, presets and overrides, wherever one stands."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamsim.config import bundled
from slamsim.config.bundled import bundled_folder, bundled_names, find_input
from slamsim.config.loading import load_run_config, load_world_config
from slamsim.config.run import RunConfig
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused, SlamsimError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: Path, text: str) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


# Finding.


def test_a_path_comes_before_a_bundled_name(folder: Path) -> None:
    assert (
        find_input("configs/sensors", "lds_01") == bundled_folder("configs/sensors") / "lds_01.yaml"
    )
    write(folder / "lds_01", "{}")
    assert find_input("configs/sensors", "lds_01") == Path("lds_01")


def test_a_folder_does_not_hide_a_bundled_name(folder: Path) -> None:
    (folder / "lds_01").mkdir()
    assert find_input("configs/sensors", "lds_01").parent == bundled_folder("configs/sensors")
    (folder / "other").mkdir()
    with pytest.raises(InputRefused, match="is a folder, a sensor file is needed"):
        find_input("configs/sensors", "other")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lds_10", "did you mean the bundled 'lds_01'?"),
        ("deep/lds_1.yaml", "did you mean the bundled 'lds_01'?"),
        ("mylidar.yml", "did you mean 'mylidar.yaml'?"),
        ("qqqq", "bundled are lds_01, "),
        ("../lds_01", "no bundled sensor '../lds_01'"),
        ("", "folder"),
        ("x" * 5000, "File name too long"),
        ("nul\0", "no bundled sensor 'nul\\x00'"),
    ],
)
def test_an_unknown_name_is_told_the_nearest(folder: Path, name: str, words: str) -> None:
    write(folder / "mylidar.yaml", "{}")
    with pytest.raises(SlamsimError) as caught:
        find_input("configs/sensors", name)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_wheel_has_its_own_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "bundled" / "worlds" / "only_here.yaml", "{}")
    monkeypatch.setattr(bundled, "_PACKAGE", tmp_path)
    assert bundled_names("worlds") == ("only_here",)
    assert find_input("worlds", "only_here").parent == tmp_path / "bundled" / "worlds"


@pytest.mark.parametrize(
    "kind", ["worlds", "configs/robots", "configs/drives", "configs/sensors", "configs/slam"]
)
def test_every_bundled_file_loads(kind: bundled.Kind) -> None:
    names = bundled_names(kind)
    assert names
    for name in names:
        if kind == "worlds":
            load_run_config(name)
        elif kind == "configs/sensors":
            load_run_config(None, overrides=[f"sensors={name}"])
        else:
            load_run_config(None, overrides=[f"{kind.removeprefix('configs/').rstrip('s')}={name}"])


# Putting together.


def test_nothing_given_is_all_defaults() -> None:
    assert load_run_config(None) == RunConfig()


def test_the_seed_of_the_command_line_wins(folder: Path) -> None:
    config = write(folder / "run.yaml", "seed: 3")
    assert load_run_config(None, config).seed == 3
    assert load_run_config(None, config, ["seed=4"]).seed == 4
    assert load_run_config(None, config, ["seed=4"], seed=5).seed == 5
    with pytest.raises(OverrideRefused, match=r"^--seed -1: must be at least 0"):
        load_run_config(None, seed=-1)


def test_a_preset_and_what_differs(folder: Path) -> None:
    preset = load_run_config(None, overrides=["sensors.lidar=rplidar_a2"]).sensors.lidar
    config = write(folder / "run.yaml", "sensors:\n  lidar: {preset: rplidar_a2, rate_hz: 7}\n")
    lidar = load_run_config(None, config).sensors.lidar
    assert lidar.rate_hz == 7.0
    assert lidar.model_copy(update={"rate_hz": preset.rate_hz}) == preset
    assert preset != RunConfig().sensors.lidar


def test_a_later_preset_replaces_the_earlier_one(folder: Path) -> None:
    other = load_run_config(None, overrides=["sensors.lidar=lds_01"]).sensors.lidar
    config = write(folder / "run.yaml", "sensors:\n  lidar: {preset: rplidar_a2, rate_hz: 7}\n")
    for override in (
        "sensors.lidar=lds_01",
        "sensors.lidar.preset=lds_01",
        "sensors.lidar={preset: lds_01}",
    ):
        assert load_run_config(None, config, [override]).sensors.lidar == other
    tuned = load_run_config(None, config, ["sensors.lidar=lds_01", "sensors.lidar.rate_hz=6"])
    assert tuned.sensors.lidar == other.model_copy(update={"rate_hz": 6.0})


def test_a_sensor_file_may_hold_one_sensor_or_several(folder: Path) -> None:
    write(folder / "one.yaml", "rate_hz: 3\n")
    write(folder / "several.yaml", "lidar: {rate_hz: 4}\nimu: {rate_hz: 5}\n")
    config = load_run_config(None, overrides=["sensors=several.yaml", "sensors.lidar=one.yaml"])
    assert (config.sensors.lidar.rate_hz, config.sensors.imu.rate_hz) == (3.0, 5.0)
    picked = load_run_config(None, overrides=["sensors.imu=several.yaml"])
    assert (picked.sensors.lidar, picked.sensors.imu.rate_hz) == (RunConfig().sensors.lidar, 5.0)


def test_a_fault_in_a_preset_is_told_with_its_own_file_and_line(folder: Path) -> None:
    write(folder / "lidars" / "mine.yaml", "# mine\nlidar:\n  rate_hz: fast\n")
    config = write(folder / "run.yaml", "sensors:\n  lidar: lidars/mine.yaml\n")
    with pytest.raises(InputRefused) as caught:
        load_run_config(None, config)
    path = folder / "lidars" / "mine.yaml"
    assert (
        str(caught.value) == f"{path}, line 3, lidar.rate_hz: must be a number, not the text 'fast'"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sensors: {lidar: {preset: 3}}", "line 1, sensors.lidar.preset: must be the name"),
        ("sensors: {lidar: {preset: null}}", "line 1, sensors.lidar.preset: must be the name"),
        ("sensors: {lidar: utm_31lx}", "did you mean the bundled 'utm_30lx'?"),
        ("mapping: {preset: x}", "line 1, mapping.preset: unknown key 'preset'"),
        ("drive: {preset: touur}", "did you mean the bundled 'tour'?"),
        ("robot: ring.yaml", "ring.yaml, line 1, preset: the presets start from one another"),
        ("world: {}\nmaze: {}", "line 2, maze: unknown key 'maze' here; it belongs under 'world'"),
        ("world: [1]", "line 1, world: must be a mapping"),
    ],
)
def test_faults_of_sections(folder: Path, text: str, words: str) -> None:
    write(folder / "ring.yaml", "preset: ring.yaml\n")
    with pytest.raises(SlamsimError) as caught:
        load_run_config(None, write(folder / "run.yaml", text))
    assert words in str(caught.value)


# Worlds.


def test_a_world_by_path_beats_the_one_of_the_configuration(folder: Path) -> None:
    world = write(folder / "w.yaml", "name: mine\n")
    config = write(folder / "run.yaml", "world: {name: other, clearance_m: 0.7}\nseed: 2\n")
    assert load_run_config(None, config).world.name == "other"
    run = load_run_config(world, config, ["world.maze.rows=5"])
    assert (run.world.name, run.world.clearance_m, run.seed) == ("mine", 0.6, 2)
    assert run.world.maze is not None
    assert run.world.maze.rows == 5
    assert load_world_config(world).name == "mine"


def test_a_fault_in_a_world_is_told_in_the_words_of_its_file(folder: Path) -> None:
    world = write(folder / "w.yaml", "maze:\n  thickness_m: 0.2\nrate_hz: 3\n")
    with pytest.raises(InputRefused) as caught:
        load_run_config(world)
    first, second = str(caught.value).splitlines()
    assert first.endswith(
        "w.yaml, line 2, maze.thickness_m: unknown key 'thickness_m' here; it belongs under 'walls'"
    )
    assert "w.yaml, line 3, rate_hz: unknown key" in second
    assert "of a run configuration" in second


MAP = "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"


@pytest.mark.parametrize("name", ["map.yaml", "map.pgm"])
def test_a_map_is_a_world(folder: Path, name: str) -> None:
    write(folder / "maps" / "map.yaml", MAP)
    write(folder / "maps" / "map.pgm", "")
    image = load_run_config(f"maps/{name}").world.image
    assert image is not None
    assert image.file == str((folder / "maps" / "map.yaml").resolve())


def test_an_image_alone_has_no_size(folder: Path) -> None:
    write(folder / "map.png", "")
    with pytest.raises(InputRefused, match=r"has no size in metres; describe it in map.yaml"):
        load_run_config("map.png")


@pytest.mark.parametrize("suffix", [".stl", ".OBJ", ".ply", ".glb"])
def test_a_mesh_is_a_world(folder: Path, suffix: str) -> None:
    write(folder / f"hall{suffix}", "")
    run = load_run_config(f"hall{suffix}", overrides=["world.mesh.scale=0.001"])
    assert run.world.mesh is not None
    assert run.world.name == "hall"
    assert run.world.mesh.scale == 0.001
    assert run.world.mesh.file == str((folder / f"hall{suffix}").resolve())


def test_file_names_start_where_they_are_written(folder: Path) -> None:
    world = write(folder / "worlds" / "w.yaml", "mesh: {file: hall.stl}\n")
    config = write(folder / "configs" / "run.yaml", "robot: {urdf_file: robots/r.urdf}\n")
    run = load_run_config(world, config)
    assert run.world.mesh is not None
    assert run.world.mesh.file == str((folder / "worlds" / "hall.stl").resolve())
    assert run.robot.urdf_file == str((folder / "configs" / "robots" / "r.urdf").resolve())
    run = load_run_config(world, config, ["world.mesh.file=other.stl"])
    assert run.world.mesh is not None
    assert run.world.mesh.file == str((folder / "other.stl").resolve())
    absolute = load_run_config(None, overrides=["robot.urdf_file=/r.urdf"])
    assert absolute.robot.urdf_file == "/r.urdf"


@pytest.mark.parametrize(
    ("world", "error", "words"),
    [
        ("labyrnith", NotFound, "did you mean the bundled 'labyrinth'?"),
        ("worlds/nothere.yaml", NotFound, "bundled are"),
        (".", InputRefused, "is a folder, a world file is needed"),
        ("/dev/null", InputRefused, "pipe or device"),
        ("empty.yaml", InputRefused, "is empty"),
        ("binary.yaml", InputRefused, "line 1"),
        ("list.yaml", InputRefused, "holds a list"),
    ],
)
def test_bad_worlds(folder: Path, world: str, error: type[SlamsimError], words: str) -> None:
    write(folder / "empty.yaml", "")
    (folder / "binary.yaml").write_bytes(b"\xdf\x00" + bytes(range(256)))
    write(folder / "list.yaml", "- 1\n")
    if "labyrinth" not in bundled_names("worlds") and error is NotFound:
        pytest.skip("no world is bundled yet")
    with pytest.raises(error) as caught:
        load_run_config(world)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
