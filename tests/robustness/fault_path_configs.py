"""Attempts of configurations, recipes and measurements to reach outside their folder."""

from __future__ import annotations

from fault_paths import Action, Reference, Scene, attempt, ways, written

from slamsim.config.bundled import find_input
from slamsim.config.loading import load_run_config
from slamsim.config.measurements import load_measurements
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.loading import load_scenarios
from slamsim.config.scenarios.robots import UmbmarkConfig
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.scenarios.scripted import robots_under_test
from slamsim.sensors.faults.registry import chosen_fault
from slamsim.sim.drive.route import plan_route
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world


def _run(text: str, scene: Scene) -> Action:
    path = written(scene.inputs / "run.yaml", text)
    return lambda: load_run_config(None, path)


@ways("the world of a run", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "w.yaml", "maze: {rows: 2, columns: 2}\n")
    return _run(f"world: '{way(scene, 'w.yaml')}'\n", scene)


@ways("the preset of a section", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "s.yaml", "noise_m: 0.5\n")
    return _run(f"sensors: {{lidar: {{preset: '{way(scene, 's.yaml')}'}}}}\n", scene)


@ways("the fault of a run", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    text = find_input("configs/faults", "laser_yaw").read_text()
    written(scene.outside / "f.yaml", text)
    path = written(scene.inputs / "run.yaml", f"faults: ['{way(scene, 'f.yaml')}']\n")
    return lambda: [chosen_fault(choice) for choice in load_run_config(None, path).faults]


@attempt("the fault of a run, from the working folder")
def _(scene: Scene) -> Action:
    text = find_input("configs/faults", "laser_yaw").read_text()
    written(scene.outside / "f.yaml", text)
    (scene.root / "cwd" / "f.yaml").symlink_to(scene.outside / "f.yaml")
    path = written(scene.inputs / "run.yaml", "faults: [f.yaml]\n")
    return lambda: [chosen_fault(choice) for choice in load_run_config(None, path).faults]


@ways("the route of a drive", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "r.csv", "x_m,y_m\n1.0,1.0\n3.0,1.0\n")
    path = written(
        scene.inputs / "run.yaml",
        f"world: tiny\ndrive: {{route: {{file: '{way(scene, 'r.csv')}'}}}}\n",
    )

    def act() -> object:
        config = load_run_config(None, path)
        world = build_world(config.world, 0)
        return plan_route(world, build_robot(config.robot), config.drive)

    return act


RECIPE = "name: r\ntitle: r\nduration_s: 4.0\nsplits: {train: 1.0, val: 0.0, test: 0.0}\n"


def _recipe(scene: Scene, text: str) -> Action:
    path = written(scene.inputs / "recipe.yaml", f"{RECIPE}{text}")
    return lambda: load_recipe(path)


@ways("the world of a recipe", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "w.yaml", "maze: {rows: 3, columns: 3}\n")
    return _recipe(scene, f"worlds: [{{world: '{way(scene, 'w.yaml')}'}}]\n")


@ways("the configuration of a recipe", "relative", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "c.yaml", "seed: 3\n")
    return _recipe(scene, f"config: '{way(scene, 'c.yaml')}'\nworlds: [{{world: tiny}}]\n")


@ways("the fault of a recipe", "relative", "link")
def _(scene: Scene, way: Reference) -> Action:
    text = find_input("configs/faults", "laser_yaw").read_text()
    written(scene.outside / "f.yaml", text)
    faults = f"faults: {{none: 0.0, one: 1.0, choice: [{{fault: '{way(scene, 'f.yaml')}'}}]}}\n"
    return _recipe(scene, f"worlds: [{{world: tiny}}]\n{faults}")


@ways("the preset of a recipe", "relative", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "s.yaml", "noise_m: 0.5\n")
    vary = f"vary: {{sensors.lidar: {{choice: ['{way(scene, 's.yaml')}']}}}}\n"
    return _recipe(scene, f"worlds: [{{world: tiny}}]\n{vary}")


@ways("the robot of measurements", "relative", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "r.yaml", "name: other\n")
    figure = "{quantity: umbmark.e_max_m, value: 0.1, sigma: 0.1, source: x}"
    text = f"name: m\nrobot: '{way(scene, 'r.yaml')}'\nfigures: [{figure}]\n"
    path = written(scene.inputs / "m.yaml", text)
    return lambda: load_measurements(path)


@ways("the robot beside that of a scenario", "relative", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "r.yaml", "name: other\n")
    path = written(scene.inputs / "s.yaml", f"beside: ['{way(scene, 'r.yaml')}']\n")

    def act() -> object:
        config = load_scenarios({"umbmark": UmbmarkConfig}, path)
        assert isinstance(config, UmbmarkConfig)
        return robots_under_test(RobotConfig(), config.beside)

    return act
