"""``slamsim world``: preview, mesh and true map of a world, and its figures."""

from __future__ import annotations

from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.run import folder as run_folder
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.own_files import write_world
from slamsim.world.build import build_world
from slamsim.world.export import stl_bytes, world_facts
from slamsim.world.preview import preview_png


def export_world(config: RunConfig, folder: Path, *, overwrite: bool = False) -> dict[str, object]:
    """Write the world into the folder; returns what a person wants to know of it."""
    world = build_world(config.world, config.seed)
    height_m = float(build_robot(config.robot).T_base_laser[2, 3])
    with partial_folder(folder, overwrite) as partial:
        write_world(partial, config, world)
        write_atomic(partial / "preview.png", preview_png(world))
        write_atomic(partial / "world.stl", stl_bytes(world.mesh))
        run_folder.write_map(partial, world.grid(config.mapping.resolution_m, height_m))
    return world_facts(world)
