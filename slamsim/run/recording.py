"""``slamsim simulate`` writes a recording, its world and the ground truth; ``slamsim world`` a
world alone: preview, mesh, true map, figures."""

from __future__ import annotations

from pathlib import Path

from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.guard.quantities import as_number, as_time
from slamsim.io import LOG
from slamsim.io.open import read_truth
from slamsim.process.children import MEMORY
from slamsim.run import folder as run_folder
from slamsim.run.cameras.world_view import view_png
from slamsim.run.stages import Report, Stages
from slamsim.sensors.faults.registry import chosen_fault, resolved_choice
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.driven import simulate_with_faults
from slamsim.simulation.own_files import write_config, write_world
from slamsim.simulation.simulate import Simulation, simulate
from slamsim.world.build import build_world
from slamsim.world.model import stl_bytes, world_facts
from slamsim.world.preview import preview_png


def export_world(
    config: RunConfig, folder: Path, *, with_view: bool = False, overwrite: bool = False
) -> dict[str, object]:
    """Write the world into the folder; returns what a person wants to know of it."""
    world = build_world(config.world, config.seed)
    height_m = float(build_robot(config.robot).T_base_laser[2, 3])
    with partial_folder(folder, overwrite) as partial:
        write_world(partial, config, world)
        write_atomic(partial / "preview.png", preview_png(world))
        if with_view:
            write_atomic(partial / "view.png", view_png(world, config.world.looks))
        write_atomic(partial / "world.stl", stl_bytes(world.mesh))
        run_folder.write_map(partial, world.grid(config.mapping.resolution_m, height_m))
    return world_facts(world)


def simulate_world(
    config: RunConfig, folder: Path, reporter: Reporter, *, overwrite: bool = False
) -> Report:
    """Raises SlamsimError after a drive that ended early; what was driven is in the folder."""
    stages = Stages(reporter)
    with partial_folder(folder, overwrite) as partial:
        simulation = record(config, partial, stages)
        seconds = stages.so_far()
    require_finished(simulation, folder)
    outcome = simulation.outcome
    return Report(
        {
            "name": config.world.name,
            "duration_s": outcome.duration_s,
            "path_length_m": outcome.path_length_m,
            "seconds": seconds,
            "realtime_factor": {"simulate": outcome.duration_s / seconds["simulate"]},
            "peak_memory_mb": MEMORY.peak_mb(),
        }
    )


def record(config: RunConfig, partial: Path, stages: Stages) -> Simulation:
    """Simulate into an unfinished run's folder, with all that is known of where it came from."""
    faults = [chosen_fault(choice) for choice in config.faults]
    choices = tuple(map(resolved_choice, config.faults))
    write_config(partial, config.model_copy(update={"faults": choices}))
    log = partial / LOG
    with stages.stage("simulate", "× real time") as progress:
        if faults:
            simulation = simulate_with_faults(config, faults, log, progress)
        else:
            simulation = simulate(config, log, progress)
    write_world(partial, config, simulation.world)
    truth = read_truth(partial / LOG)
    if truth is not None:
        run_folder.write_truth(partial, truth)
    return simulation


def require_finished(simulation: Simulation, folder: Path) -> None:
    """Raises SlamsimError if the robot did not get to the end of its route."""
    outcome = simulation.outcome
    if not outcome.finished:
        raise SlamsimError(
            f"the drive ended early, after {as_time(outcome.duration_s)} and "
            f"{as_number(outcome.path_length_m)} m: {outcome.reason}; "
            f"what was driven is in {folder}/"
        )
