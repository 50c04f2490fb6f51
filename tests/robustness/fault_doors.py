"""Every kind of input but recordings, read as deep as a user's command would read it.

Each door gives a value that can be compared, and raises AssertionError for one that is not sane.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from slamsim.config.drive import PhysicsConfig
from slamsim.config.loading import load_run_config, load_world_config
from slamsim.config.measurements import load_measurements
from slamsim.config.robot import RobotConfig
from slamsim.core.types import FloatArray
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.guard.pictures import read_gray_image
from slamsim.io.text.relations import read_relations
from slamsim.io.text.tum import read_tum
from slamsim.sensors.faults.registry import load_fault
from slamsim.sensors.scene import Scene
from slamsim.sim.bullet import pybullet
from slamsim.sim.drive.route_file import read_route
from slamsim.sim.engine import running_engine, standing_robot
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.slam.mapping.saved_map import read_saved_map
from slamsim.world.build import build_world
from slamsim.world.model import World

SEED = 7
STEPS = 12
_BRIEF = PhysicsConfig(settle_s=0.05)
_GRID_CELLS = 300


def world(path: Path) -> object:
    """Built; its true grid; what rays meet around its start."""
    return _seen(build_world(load_world_config(str(path)), SEED))


def driven_world(path: Path) -> object:
    """As ``world``, and in the physics engine with a robot that stands in it."""
    built = build_world(load_world_config(str(path)), SEED)
    with running_engine(built, build_robot(RobotConfig()), _BRIEF) as engine:
        for _ in range(STEPS):
            engine.step()
        pose = pybullet.getBasePositionAndOrientation(engine.body, engine.client)
    return _seen(built), _finite(np.array([*pose[0], *pose[1]]), "the robot's pose")


def _seen(built: World) -> object:
    _finite(built.mesh.vertices_m, "the mesh")
    _finite(np.array([*built.bounds_m, *built.start_pose]), "bounds and start")
    _finite(built.visit_points_m, "the places to visit")
    x_min, y_min, x_max, y_max = built.bounds_m
    resolution_m = max(0.05, max(x_max - x_min, y_max - y_min) / _GRID_CELLS)
    grid = built.grid(resolution_m, 0.3).occupancy
    assert np.isin(grid[~np.isnan(grid)], (0.0, 1.0)).all(), "a cell is neither free nor solid"
    return built.mesh, built.bounds_m, built.start_pose, built.visit_points_m, grid, _rays(built)


def _rays(built: World) -> FloatArray:
    scene = Scene(built.mesh, 10.0)
    angles = np.linspace(0.0, 2.0 * math.pi, 90, endpoint=False)
    eye = np.array([built.start_pose[0], built.start_pose[1], 0.3]) - scene.origin_m
    rays = np.zeros((len(angles), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3], rays[:, 4] = eye, np.cos(angles), np.sin(angles)
    ranges_m = scene.cast(rays).ranges_m
    assert not np.isnan(ranges_m).any() and (ranges_m >= 0.0).all(), "a range is no length"
    return np.asarray(ranges_m, np.float64)


def config(path: Path) -> object:
    """A run's: complete, with a robot and a world that can be built from it."""
    loaded = load_run_config(None, str(path))
    build_robot(loaded.robot)
    return loaded.model_dump(mode="json"), _seen(build_world(loaded.world, loaded.seed))


def robot(path: Path) -> object:
    """A description, checked, loaded into the physics engine and stepped."""
    model = build_robot(RobotConfig(urdf_file=str(path)))
    return model.footprint_radius_m, model.height_m, _stood(model)


def _stood(model: RobotModel) -> FloatArray:
    start = np.zeros(3)
    with standing_robot(model, _BRIEF, start, 0.8, lambda _: ()) as engine:
        for _ in range(STEPS):
            engine.step()
        place, turned = pybullet.getBasePositionAndOrientation(engine.body, engine.client)
    return _finite(np.array([*place, *turned]), "the robot's pose")


def recipe(path: Path) -> object:
    return load_recipe(str(path)).model_dump(mode="json")


def measurements(path: Path) -> object:
    return load_measurements(str(path)).model_dump(mode="json")


def fault(path: Path) -> object:
    return load_fault(str(path)).model_dump(mode="json")


def image(path: Path) -> object:
    return read_gray_image(path)


def route(path: Path) -> object:
    found = read_route(path)
    rows = found.points_m if hasattr(found, "points_m") else found.twists
    return _finite(rows, "the route")


def tum(path: Path) -> object:
    found = read_tum(path)
    assert (np.diff(found.stamps_ns) > 0).all(), "the stamps do not increase"
    return found.stamps_ns, _finite(np.hstack([found.positions_m, found.quats_xyzw]), "a pose")


def relations(path: Path) -> object:
    found = read_relations(path)
    return found.from_ns, found.to_ns, _finite(found.T_from_to, "a relation")


def saved_map(path: Path) -> object:
    found = read_saved_map(path)
    return _finite(found.poses, "a pose"), len(found.closures)


def _finite(values: FloatArray, what: str) -> FloatArray:
    assert np.isfinite(values).all(), f"{what} is not finite"
    return values
