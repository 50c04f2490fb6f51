"""The folder of a run needs nothing from elsewhere: what its configuration names is beside it."""

from __future__ import annotations

import shutil
from pathlib import Path

import trimesh
from test_world_import import ROOM, write_map

from slamsim.config.bundled import find_input
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.faults import FaultChoice
from slamsim.config.loading import load_run_config, load_world_config
from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.config.scenarios.loading import load_scenarios
from slamsim.config.scenarios.robots import UmbmarkConfig
from slamsim.scenarios.scripted import robots_under_test
from slamsim.sensors.faults.registry import chosen_fault
from slamsim.sim.drive.route_file import PoseRoute, read_route
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.own_files import CONFIG, WORLD, with_own_files, write_config, write_world
from slamsim.world.build import build_world


def moved(run: Path, sources: Path) -> Path:
    """The run's folder elsewhere, and all that it was made from gone."""
    shutil.rmtree(sources)
    return run.rename(run.with_name("elsewhere"))


def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "sources"
    folder.mkdir()
    trimesh.creation.box((4.0, 4.0, 1.0)).export(folder / "box.stl")
    write_map(folder, ROOM)
    shape = '<visual><geometry><mesh filename="parts/box.stl"/></geometry></visual>'
    (folder / "parts").mkdir()
    shutil.copy(folder / "box.stl", folder / "parts")
    urdf = build_robot(RobotConfig()).urdf.replace("</link>", f"{shape}</link>", 1)
    (folder / "r.urdf").write_text(urdf)
    (folder / "route.yaml").write_text("poses: [{x_m: 1.0, y_m: 1.0}, {x_m: 2.0, y_m: 1.0}]\n")
    (folder / "fault.yaml").write_text(find_input("configs/faults", "laser_yaw").read_text())
    (folder / "robot.yaml").write_text("{name: other, urdf_file: r.urdf}\n")
    return folder


def typed(world: Path, *more: str) -> RunConfig:
    return load_run_config(str(world), None, more, 3)


def test_a_run_in_a_map_with_its_robot_route_and_fault(tmp_path: Path) -> None:
    there, run = sources(tmp_path), tmp_path / "run"
    names = f"robot.urdf_file={there}/r.urdf", f"drive.route.file={there}/route.yaml"
    config = typed(there / "map.yaml", *names)
    faults = (FaultChoice(name=str(there / "fault.yaml"), size=2.0), FaultChoice(name="laser_yaw"))
    config = config.model_copy(update={"faults": faults})
    world = build_world(config.world, 3)
    write_config(run, config)
    write_world(run, config, world)

    here = moved(run, there)
    again = load_run_config(None, str(here / CONFIG))
    assert build_world(again.world, 3).bounds_m == world.bounds_m
    assert build_world(load_world_config(str(here / WORLD)), 3).bounds_m == world.bounds_m
    assert build_robot(again.robot).name == build_robot(RobotConfig()).name
    assert again.drive.route.file is not None
    assert isinstance(read_route(Path(again.drive.route.file)), PoseRoute)
    assert chosen_fault(again.faults[0]).size == 2.0
    assert again.faults[1].name == "laser_yaw"


def test_a_run_in_a_mesh(tmp_path: Path) -> None:
    there, run = sources(tmp_path), tmp_path / "run"
    config = typed(there / "box.stl", "world.clearance_m=0.1")
    write_config(run, config)
    here = moved(run, there)
    mesh = load_run_config(None, str(here / CONFIG)).world.mesh
    assert mesh is not None and Path(mesh.file).is_file()


def test_robots_beside_that_of_a_scenario(tmp_path: Path) -> None:
    there, run = sources(tmp_path), tmp_path / "run"
    overrides = [f"beside=[{there}/robot.yaml, turtlebot2_identified]"]
    whole = load_scenarios({"umbmark": UmbmarkConfig}, None, overrides)
    run.mkdir()
    (run / CONFIG).write_text(dump_commented_yaml(with_own_files(run, whole)))
    here = moved(run, there)
    again = load_scenarios({"umbmark": UmbmarkConfig}, str(here / CONFIG))
    assert isinstance(again, UmbmarkConfig)
    names = [robot.name for robot in robots_under_test(RobotConfig(), again.beside)]
    assert names == ["turtlebot2", "other", "turtlebot2_identified"]
    other = robots_under_test(RobotConfig(), again.beside)[1]
    assert build_robot(other.config).track_m > 0.0


def test_what_names_no_file_leaves_none(tmp_path: Path) -> None:
    config = load_run_config("tiny")
    assert with_own_files(tmp_path, config) == config
    assert list(tmp_path.iterdir()) == []
